"""Radio presets: payload of a frame, throughput, and indoor range (docs/radios.md), of simulated and of real radios.

All figures follow from sources. The standard or the datasheet gives a frame's time on the air; frames sent back to back
give the rate. The range follows from the site-general model of ITU-R P.1238 in an office.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from protocol.plugins import Plugins

OFFICE_900, OFFICE_2400 = 33.0, 30.0
"""ITU-R P.1238: distance power loss coefficient N in an office, at 0.9 and at 2.4 GHz."""

MARGIN_DB = 16.4
"""Fade margin exceeded in one place of twenty: 1.64 standard deviations of 10 dB (P.1238, office)."""

LORA_HEAD = 13
"""Bytes of a LoRaWAN frame besides the payload: MHDR, FHDR without options, FPort, MIC."""


@dataclass(frozen=True)
class Preset:
    """A radio.

    Attributes
    ----------
    description : str
        Radio standard and parameters.
    bits_per_s : int
        Bit rate on the air.
    frame_bytes : int
        Maximum payload of a frame.
    frame_s : float
        Airtime of a full frame in seconds, including the gap to the next frame.
    range_m : int
        Typical indoor range.
    spreading : int
        Spreading factor of LoRa; 0 for other radios.
    """

    description: str
    bits_per_s: int
    frame_bytes: int
    frame_s: float
    range_m: int
    spreading: int = 0

    def airtime_s(self, size: int) -> float:
        """Return the airtime in seconds of a frame of `size` bytes of payload."""
        if self.spreading:
            return lora_airtime(self.spreading, size + LORA_HEAD)
        return self.frame_s - (self.frame_bytes - size) * 8 / self.bits_per_s

    @property
    def bandwidth(self) -> int:
        """Bytes of payload per second."""
        return int(self.frame_bytes / self.frame_s)


def lora_airtime(spreading: int, size: int) -> float:
    """Return the airtime in seconds of a LoRa frame of `size` bytes: 125 kHz, coding rate 4/5, explicit header, CRC.

    Semtech SX1276 datasheet, 4.1.1.7; with low data rate optimization if a symbol is longer than 16 ms.
    """
    symbol = 2**spreading / 125e3
    slow = 2 if symbol > 0.016 else 0
    blocks = math.ceil((8 * size - 4 * spreading + 28 + 16) / (4 * (spreading - slow)))
    return float((8 + 4.25 + 8 + max(5 * blocks, 0)) * symbol)


def indoor_range_m(power_dbm: float, sensitivity_dbm: float, megahertz: float, coefficient: float) -> int:
    """Return the range in meters with 95 % coverage of an office floor (ITU-R P.1238, site-general, one floor)."""
    loss = power_dbm - sensitivity_dbm - MARGIN_DB
    return round(10 ** ((loss - (20 * math.log10(megahertz) - 28)) / coefficient))


def _lora(spreading: int, payload: int, sensitivity_dbm: float) -> Preset:
    return Preset(
        f"LoRa, spreading factor {spreading}, 125 kHz, 868 MHz, 14 dBm",
        round(spreading * 125e3 / 2**spreading * 4 / 5),
        payload,
        lora_airtime(spreading, payload + LORA_HEAD),
        indoor_range_m(14, sensitivity_dbm, 868, OFFICE_900),
        spreading,
    )


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
    "zigbee": Preset(
        "Zigbee on IEEE 802.15.4, 2.4 GHz, 0 dBm", 250_000, 127 - 11 - 8 - 8, ZIGBEE_FRAME_S,
        indoor_range_m(0, -97, 2400, OFFICE_2400),
    ),
    "ble": Preset(
        "Bluetooth LE, 1M, 0 dBm", 1_000_000, 251 - 4 - 3, BLE_FRAME_S, indoor_range_m(0, -96, 2400, OFFICE_2400)
    ),
    "wifi": Preset(
        "IEEE 802.11, broadcast at 1 Mbit/s, 2.4 GHz, 15 dBm", 1_000_000, 1500, WIFI_FRAME_S,
        indoor_range_m(15, -93, 2400, OFFICE_2400),
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
