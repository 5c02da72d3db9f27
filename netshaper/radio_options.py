"""Options of the radio: links between robots, loss, delay, damage, and limits of robots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

MIN_FRAME = 16
"""Minimum frame size in bytes: the longest packet that cannot be split, a broadcast, and a checksum."""

MAX_STEPS = 10_000
"""Maximum delay of a frame in steps."""


LOG_DISTANCE = "log-distance"
"""The model of links that walls weaken."""


@dataclass(frozen=True)
class Partition:
    """Steps in which groups of robots do not receive each other.

    Attributes
    ----------
    first, last : int
        The steps from and to which it holds, both included.
    groups : lists of robots
        Robots receive only those of their own group; robots without a group form one more group.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    first: int
    last: int
    groups: tuple[tuple[int, ...], ...]

    def __post_init__(self) -> None:
        if not 1 <= self.first <= self.last:
            raise ValueError(
                f"first = {self.first}, last = {self.last}: a partition begins at step 1 or later"
            )
        named = [robot for group in self.groups for robot in group]
        if len(set(named)) < len(named) or min(named, default=-1) < 0:
            raise ValueError(f"groups = {[*map(list, self.groups)]}: must name robots, each at most once")

    def group_of(self, robot: int) -> int:
        """Return the number of a robot's group; -1 for a robot in no group."""
        return next((number for number, group in enumerate(self.groups) if robot in group), -1)


@dataclass(frozen=True)
class RadioOptions:
    """Options of the radio; docs/radios.md names the sources of their numbers.

    Attributes
    ----------
    preset : str
        The radio whose figures apply where the scenario gives none (`protocol.presets`).
    frame_bytes : int
        Maximum bytes of packets in a frame; longer frames are split. 0: no limit.
    model : str
        Links within the communication range: ``disc``, all; ``line-of-sight``, links without a wall; ``log-distance``,
        links whose path loss is at most that of an open link as long as the range; or a plug-in
        (`netshaper.radio_models`).
    exponent, db_per_meter, db_per_wall, shadowing_db, shadowing_m : float
        For ``log-distance``: the growth of the loss by the distance's logarithm and by the distance, the loss per wall,
        the standard deviation of the shadowing, and the side of the squares in which it is the same.
    loss : float
        Probability that a frame is lost to a robot in range.
    burst_loss, burst_every, burst_steps : float
        Bursts (Gilbert and Elliott): the probability in a burst, the mean steps between bursts of one link, 0 for
        none, and the mean steps of one.
    delay, jitter : int
        Steps after which a frame arrives, and how many more at most, drawn for each frame.
    duplication : float
        Probability that a frame arrives twice.
    bit_errors : float
        Probability of each bit to be flipped. Frames then end with a checksum.
    checksums : bool
        Whether frames end with a checksum in any case.
    send_bytes, receive_bytes : int
        Bytes per step that a robot can send, and receive; 0: no limit of its own.
    duty_cycle : float
        Share of the time in which a robot may send, over an hour.
    reuse : bool
        Whether each neighborhood (a robot and all in its range) has the bandwidth; else the team has it.
    partition : list of Partition
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    preset: str = ""
    frame_bytes: int = 0
    model: str = "disc"
    exponent: float = 2.0
    db_per_meter: float = 0.0
    db_per_wall: float = 6.9
    shadowing_db: float = 0.0
    shadowing_m: float = 5.0
    loss: float = 0.0
    burst_loss: float = 1.0
    burst_every: float = 0.0
    burst_steps: float = 5.0
    delay: int = 0
    jitter: int = 0
    duplication: float = 0.0
    bit_errors: float = 0.0
    checksums: bool = False
    send_bytes: int = 0
    receive_bytes: int = 0
    duty_cycle: float = 1.0
    reuse: bool = False
    partition: tuple[Partition, ...] = ()

    def __post_init__(self) -> None:
        for name, least, most in _BOUNDS:
            value = getattr(self, name)
            if not least <= value <= most:
                raise ValueError(f"{name} = {value:g}: must be {least:g} to {most:g}")
        if 0 < self.frame_bytes < MIN_FRAME:
            raise ValueError(
                f"frame_bytes = {self.frame_bytes}: must be 0 (no limit), or {MIN_FRAME} or more"
            )
        if 0 < self.burst_every < 1:
            raise ValueError(f"burst_every = {self.burst_every:g}: must be 0 (no bursts), or 1 step or more")
        for name in ("send_bytes", "receive_bytes"):
            if 0 < getattr(self, name) < MIN_FRAME:
                raise ValueError(
                    f"{name} = {getattr(self, name)}: must be 0 (no limit), or {MIN_FRAME} or more"
                )
        if self.duty_cycle <= 0:
            raise ValueError("duty_cycle = 0: must be above 0, as 0.01 for 1 %; 1: no limit")

    @property
    def sums(self) -> bool:
        """Whether frames end with a checksum."""
        return self.checksums or self.bit_errors > 0

    @property
    def lossless(self) -> bool:
        """Whether every robot in range receives a frame at once, whole and once."""
        return not (
            self.loss or self.burst_every or self.delay or self.jitter or self.duplication or self.sums
        )

    @property
    def perfect(self) -> bool:
        """Whether the channel is lossless and the shared budget is the only limit."""
        limited = self.send_bytes or self.receive_bytes or self.duty_cycle < 1 or self.reuse
        return self.lossless and not limited


_MOST = 1e6
_BOUNDS = (
    ("frame_bytes", 0, 65535),
    ("exponent", 0.1, 10),
    ("db_per_meter", 0, 1000),
    ("db_per_wall", 0, 1000),
    ("shadowing_db", 0, 100),
    ("shadowing_m", 0.01, _MOST),
    ("loss", 0, 1),
    ("burst_loss", 0, 1),
    ("burst_every", 0, _MOST),
    ("burst_steps", 1, _MOST),
    ("delay", 0, MAX_STEPS),
    ("jitter", 0, MAX_STEPS),
    ("duplication", 0, 1),
    ("bit_errors", 0, 1),
    ("send_bytes", 0, 2**31 - 1),
    ("receive_bytes", 0, 2**31 - 1),
    ("duty_cycle", 0, 1),
)
