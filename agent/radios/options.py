"""Options of a radio without a relay, and the pacing and transport that follow from them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from agent.radios.pacing import ALWAYS, DutyCycle, Pacer
from agent.radios.peer_medium import FRAME_OVERHEAD, WORTHWHILE, Timing
from agent.radios.serial_modem import BAUD_RATES, SerialModem, check_port
from agent.radios.transport import Transport
from agent.radios.udp import GROUP, MAX_DATAGRAM, PORT, UdpRadio
from protocol.bounds import Range, check_bounds, check_ranges
from protocol.nanoseconds import SECOND
from protocol.presets import preset
from protocol.token_bucket import TokenBucket

MIN_PACKETS = 16
"""Minimum bytes of packets in a frame: the longest packet that cannot be split, a broadcast, and a checksum."""

MIN_FRAME = FRAME_OVERHEAD + MIN_PACKETS
"""Minimum bytes of the longest frame."""

MAX_FRAME = 4096
"""Maximum bytes of a frame over a serial port."""

MAX_RATE = 1 << 30
"""Maximum bytes per second."""

Duration = Annotated[float, Range(0, 7 * 24 * 3600, "(a week)")]
"""An option in seconds."""

MIN_HELLO_S, HELLOS = 8.0, 4
"""Minimum of the default `hello_s`, in seconds, and the default `neighbor_timeout_s` as a multiple of `hello_s`."""

BACKOFF_FRAMES = 4
"""Airtimes of a full frame for which a frame waits at most."""


@dataclass(frozen=True)
class LinkOptions:
    """Options of a robot's radio.

    Attributes
    ----------
    medium : str
        ``udp`` or ``serial``.
    preset : str
        The radio whose frames, rate and airtime apply (`protocol.presets`). Default: ``wifi`` for UDP; a serial modem
        without a preset needs `bytes_per_s` and `frame_bytes`.
    bytes_per_s : int
        Bytes that this robot may send per second, all overhead of frames included. 0: as the preset.
    frame_bytes : int
        Bytes of the longest frame. 0: as the preset.
    duty_cycle : float
        Share of each hour in which this robot may send; 0.01 is 1 %.
    neighbor_timeout_s, hello_s : float
        Time after its last frame for which a teammate counts as in range, and silence after which this robot sends a
        frame without packets; at most a week. 0: derived from the rate and the duty cycle. All robots of a team should
        have the same values.
    interval_s : float
        Least time between two frames of this robot; packets wait for each other, and share the overhead of a frame.
    interface, address, udp_port : str, str, int
        For ``udp``: the only interface that is used, and the multicast group or broadcast address.
    serial_port, baud : str, int
        For ``serial``.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    medium: Literal["udp", "serial"]
    preset: str = ""
    bytes_per_s: int = 0
    frame_bytes: int = 0
    duty_cycle: Annotated[float, Range(1 / ALWAYS, 1, "(no limit)")] = 1.0
    neighbor_timeout_s: Duration = 0.0
    hello_s: Duration = 0.0
    interval_s: Duration = 3.0
    interface: str = ""
    address: str = GROUP
    udp_port: Annotated[int, Range(1, 65535)] = PORT
    serial_port: str = ""
    baud: int = 57600

    def __post_init__(self) -> None:
        if self.medium not in ("udp", "serial"):
            raise ValueError(f"medium = {self.medium!r}: must be 'udp' or 'serial'")
        if self.preset:
            preset(self.preset)
        if self.medium == "udp" and not self.interface:
            raise ValueError("interface is missing: name the one that frames go through, as 'wlan0'")
        if self.medium == "serial" and not self.serial_port:
            raise ValueError("serial_port is missing: name the modem's device, as '/dev/ttyUSB0'")
        if self.medium == "serial" and not self.preset and not (self.bytes_per_s and self.frame_bytes):
            raise ValueError("a serial modem needs a preset, or bytes_per_s and frame_bytes")
        if self.baud not in BAUD_RATES:
            raise ValueError(f"baud = {self.baud}: must be one of {', '.join(map(str, BAUD_RATES))}")
        check_ranges(self)
        if not 0 <= self.bytes_per_s <= MAX_RATE:
            raise ValueError(
                f"bytes_per_s = {self.bytes_per_s}: must be 1 to {MAX_RATE}, or 0 for the preset's"
            )
        if self.frame_bytes:
            check_bounds(self, "frame_bytes", MIN_FRAME, self._most)
        self.timing()
        self.pacer(seed=0, robot=0, now=0)

    @property
    def _preset(self) -> str:
        return self.preset or ("wifi" if self.medium == "udp" else "")

    @property
    def _most(self) -> int:
        """Bytes of the longest frame that the medium takes."""
        return MAX_DATAGRAM if self.medium == "udp" else MAX_FRAME

    @property
    def longest(self) -> int:
        """Bytes of the longest frame."""
        return self.frame_bytes or min(preset(self._preset).frame_bytes, self._most)

    @property
    def packet_bytes(self) -> int:
        """Bytes of packets that the longest frame holds: the robot's setting `frame_bytes`."""
        return self.longest - FRAME_OVERHEAD

    @property
    def rate(self) -> int:
        """Bytes that this robot may send per second."""
        return self.bytes_per_s or preset(self._preset).bandwidth

    def airtime(self, size: int) -> int:
        """Return the airtime in nanoseconds of a frame of `size` bytes."""
        if not self._preset:
            return size * SECOND // self.rate
        return round(preset(self._preset).airtime_s(size) * SECOND)

    def transit_steps(self, step_s: float) -> int:
        """Return the steps of `step_s` seconds within which a frame arrives, its back-off included; at least 1."""
        longest = (BACKOFF_FRAMES + 1) * self.airtime(self.longest)
        return max(1, math.ceil(longest / (step_s * SECOND)))

    def timing(self) -> Timing:
        """Return the durations in nanoseconds; ValueError if they do not fit each other."""
        hello_s = self.hello_s or max(MIN_HELLO_S, self.interval_s, self._saving_s())
        timeout_s = self.neighbor_timeout_s or HELLOS * hello_s
        return Timing(round(timeout_s * SECOND), round(hello_s * SECOND), round(self.interval_s * SECOND))

    def pacer(self, seed: int, robot: int, now: int) -> Pacer:
        """Return the pacing of a robot that starts at `now`; ValueError if the duty cycle has no room for a frame."""
        airtime = self.airtime(self.longest)
        backoff = BACKOFF_FRAMES * airtime
        return Pacer(
            TokenBucket(self.rate, max(self.longest, self.rate), now),
            DutyCycle(round(self.duty_cycle * ALWAYS), airtime, backoff + airtime, now),
            self.airtime,
            self.longest,
            backoff,
            seed,
            robot,
        )

    def _saving_s(self) -> float:
        """Return the seconds in which a robot earns a frame that is worthwhile."""
        size = min(self.longest, WORTHWHILE)
        on_air_s = self.airtime(size) / SECOND
        return max(size / self.rate, on_air_s / self.duty_cycle if self.duty_cycle < 1 else 0.0)

    def check_transport(self) -> None:
        """Raise TransportError if the interface or the port cannot be used; a serial port is not opened."""
        if self.medium == "udp":
            self.open_transport().close()
        else:
            check_port(Path(self.serial_port))

    def open_transport(self) -> Transport:
        """Open the interface or the port; TransportError if that fails."""
        if self.medium == "udp":
            return UdpRadio(self.interface, self.address, self.udp_port, self.longest)
        return SerialModem(Path(self.serial_port), self.baud, self.longest)
