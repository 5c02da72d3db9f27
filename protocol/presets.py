"""Radio presets: frames, throughput, link budget, and legal limits (docs/radios.md), of simulated and of real radios.

All figures follow from sources. The standard or the datasheet gives a frame's time on the air; frames sent back to back
give the rate. Path loss follows from the multi-wall model of COST 231: free space, and a loss per wall.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from protocol.plugins import Plugins

EXPONENT = 2.0
"""Path loss exponent of free space, which the multi-wall model takes between walls."""

MARGIN_DB = 16.4
"""Fade margin exceeded in one place of twenty: 1.64 standard deviations of 10 dB (ITU-R P.1238, office)."""

LORA_HEAD = 13
"""Bytes of a LoRaWAN frame besides the payload: MHDR, FHDR without options, FPort, MIC."""


@dataclass(frozen=True)
class Limit:
    """Legal limits of a radio in the European Union."""

    duty_cycle: float
    """Share of each hour in which a radio may send; 1: no limit."""
    source: str
    """The harmonized standard."""


UNKNOWN = Limit(1.0, "unknown")
"""The limit of radios that state none."""

EU_868 = Limit(0.01, "ETSI EN 300 220-2, 868.0 to 868.6 MHz")
"""Band M: at most 25 mW e.r.p., the band of LoRaWAN's default channels."""

EU_2400 = Limit(1.0, "ETSI EN 300 328, 2.4 GHz")
"""Radios that listen before they send, and radios below 10 dBm, have no duty cycle."""


@dataclass(frozen=True)
class Link:
    """The link budget of a radio, which determines its range; antennas have no gain."""

    power_dbm: float
    """Transmit power."""
    sensitivity_dbm: float
    """The least power that a receiver needs."""
    megahertz: int
    """Frequency."""

    @property
    def db_per_wall(self) -> float:
        """Loss per wall in dB."""
        return wall_loss_db(self.megahertz)

    def range_m(self, walls: int = 0) -> int:
        """Return the range in meters behind so many walls, which 19 of 20 places reach."""
        budget = self.power_dbm - self.sensitivity_dbm - MARGIN_DB - walls * self.db_per_wall
        return round(10 ** ((budget - free_space_db(self.megahertz)) / (10 * EXPONENT)))


@dataclass(frozen=True)
class Preset:
    """A radio."""

    description: str
    """Radio standard and parameters."""
    bits_per_s: int
    """Bit rate on the air."""
    frame_bytes: int
    """Maximum payload of a frame."""
    frame_s: float
    """Airtime of a full frame in seconds, including the gap to the next frame."""
    range_m: int
    """Range in meters; of a radio with a link, that without walls."""
    spreading: int = 0
    """Spreading factor of LoRa; 0 for other radios."""
    link: Link | None = None
    """The link budget; None: the range is that of a disc."""
    limit: Limit = UNKNOWN
    """The legal limit."""

    def airtime_s(self, size: int) -> float:
        """Return the airtime in seconds of a frame of `size` bytes of payload."""
        if self.spreading:
            return lora_airtime(self.spreading, size + LORA_HEAD)
        return self.frame_s - (self.frame_bytes - size) * 8 / self.bits_per_s

    @property
    def bandwidth(self) -> int:
        """Bytes of payload per second."""
        return int(self.frame_bytes / self.frame_s)


def free_space_db(megahertz: float) -> float:
    """Return the path loss in dB over the first meter of free space (ITU-R P.525)."""
    return 20 * math.log10(megahertz) - 27.6


def wall_loss_db(megahertz: float) -> float:
    """Return the loss in dB of a wall of 10 cm of concrete, at normal incidence, in tenths.

    ITU-R P.2040-3: permittivity and conductivity of concrete, loss within a dielectric; and the reflections of both
    faces. At 1.8 GHz it is close to the 6.9 dB that COST 231 measured for heavy walls.
    """
    permittivity, conductivity = 5.24, 0.0462 * math.pow(megahertz / 1000, 0.7822)
    index = math.sqrt(permittivity)
    reflected = ((index - 1) / (index + 1)) ** 2
    return round(0.1 * 1636 * conductivity / index - 20 * math.log10(1 - reflected), 1)


def lora_airtime(spreading: int, size: int) -> float:
    """Return the airtime in seconds of a LoRa frame of `size` bytes: 125 kHz, coding rate 4/5, explicit header, CRC.

    Semtech SX1276 datasheet, 4.1.1.7; with low data rate optimization if a symbol is longer than 16 ms.
    """
    symbol = 2**spreading / 125e3
    slow = 2 if symbol > 0.016 else 0
    blocks = math.ceil((8 * size - 4 * spreading + 28 + 16) / (4 * (spreading - slow)))
    return float((8 + 4.25 + 8 + max(5 * blocks, 0)) * symbol)


def _lora(spreading: int, payload: int, sensitivity_dbm: float) -> Preset:
    link = Link(14, sensitivity_dbm, 868)
    return Preset(
        f"LoRa, spreading factor {spreading}, 125 kHz, 868 MHz, 14 dBm",
        round(spreading * 125e3 / 2**spreading * 4 / 5),
        payload,
        lora_airtime(spreading, payload + LORA_HEAD),
        link.range_m(),
        spreading,
        link,
        EU_868,
    )


def _wideband(
    description: str, bits_per_s: int, payload: int, frame_s: float, power_dbm: float, sensitivity_dbm: float
) -> Preset:
    link = Link(power_dbm, sensitivity_dbm, 2400)
    return Preset(description, bits_per_s, payload, frame_s, link.range_m(), link=link, limit=EU_2400)


ZIGBEE_FRAME_S = (6 + 127) * 32e-6 + 3.5 * 320e-6 + 128e-6 + 192e-6 + 640e-6
"""IEEE 802.15.4, 2.4 GHz: synchronization and a full PSDU at 32 us per byte, mean back-off, carrier
sense, turnaround, long spacing."""

BLE_FRAME_S = (261 + 10) * 8e-6 + 2 * 150e-6
"""Bluetooth LE 1M: a full data PDU, the empty PDU in reply, and two interframe spaces."""

WIFI_FRAME_S = 192e-6 + (24 + 8 + 1500 + 4) * 8e-6 + 50e-6 + 15.5 * 20e-6
"""IEEE 802.11 at 1 Mbit/s, the broadcast rate: long preamble, headers, payload and checksum, DIFS, mean back-off."""

PRESETS = {
    "lora-sf7": _lora(7, 222, -123),
    "lora-sf8": _lora(8, 222, -126),
    "lora-sf9": _lora(9, 115, -129),
    "lora-sf10": _lora(10, 51, -132),
    "lora-sf11": _lora(11, 51, -133),
    "lora-sf12": _lora(12, 51, -136),
    "zigbee": _wideband(
        "Zigbee on IEEE 802.15.4, 2.4 GHz, 0 dBm", 250_000, 127 - 11 - 8 - 8, ZIGBEE_FRAME_S, 0, -97
    ),
    "ble": _wideband("Bluetooth LE, 1M, 0 dBm", 1_000_000, 251 - 4 - 3, BLE_FRAME_S, 0, -96),
    "wifi": _wideband(
        "IEEE 802.11, broadcast at 1 Mbit/s, 2.4 GHz, 15 dBm", 1_000_000, 1500, WIFI_FRAME_S, 15, -93
    ),
}  # fmt: skip
"""Payloads of LoRa are those of LoRaWAN in Europe (RP002, EU863-870, with repeaters), sensitivities the SX1276's."""

PLUGINS: Plugins[Preset] = Plugins(
    "radio preset",
    "murmur.radio_presets",
    Preset,
    PRESETS,
    Preset("unknown", 1, 1, 1.0, 1),
    are_classes=False,
)


def preset(name: str) -> Preset:
    """Return the radio with this name, of this or an installed package, or given as ``package.module:NAME``.

    ValueError: the name is unknown (the message lists similar names), or the radio cannot be imported.
    """
    return PLUGINS.find(name)
