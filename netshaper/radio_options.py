"""Options of the radio: its links, its channel, and the limits of robots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from netshaper.channel_options import MOST, ChannelOptions
from protocol.bounds import Range, check_ranges

MIN_FRAME = 16
"""Minimum frame size in bytes: the longest packet that cannot be split, a broadcast, and a checksum."""

LOG_DISTANCE = "log-distance"
"""The model of links that walls weaken."""


@dataclass(frozen=True)
class Partition:
    """The steps from `first` to `last`, both included, in which groups of robots do not receive each other."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    first: int
    last: int
    groups: tuple[tuple[int, ...], ...]
    """Robots receive only those of their own group; robots without a group form one more group."""

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
class PathLossOptions:
    """Options of links that distance and walls weaken (model ``log-distance``)."""

    exponent: Annotated[float, Range(0.1, 10)] = 2.0
    """Growth of the loss by the logarithm of the distance: ``10 exponent`` dB per decade."""
    db_per_meter: Annotated[float, Range(0, 1000)] = 0.0
    """Growth of the loss by the distance."""
    db_per_wall: Annotated[float, Range(0, 1000)] = 6.9
    shadowing_db: Annotated[float, Range(0, 100)] = 0.0
    """Standard deviation of the shadowing."""
    shadowing_m: Annotated[float, Range(0.01, MOST)] = 5.0
    """Side of the squares in which the shadowing is the same."""

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True)
class RadioOptions(PathLossOptions, ChannelOptions):
    """Options of the radio; docs/radios.md names the sources of their numbers."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    preset: str = ""
    """The radio whose figures apply where the scenario gives none (`protocol.presets`)."""
    frame_bytes: Annotated[int, Range(0, 65535)] = 0
    """Maximum bytes of packets in a frame; longer frames are split. 0: no limit."""
    model: str = "disc"
    """Links within the communication range: ``disc``, all; ``line-of-sight``, links without a wall; ``log-distance``,
    links whose path loss is at most that of an open link as long as the range; or a plug-in (`netshaper.radio_models`).
    """
    send_bytes: Annotated[int, Range(0, 2**31 - 1)] = 0
    """Bytes per step that a robot can send; 0: no limit of its own."""
    receive_bytes: Annotated[int, Range(0, 2**31 - 1)] = 0
    """Bytes per step that a robot can receive; 0: no limit of its own."""
    duty_cycle: Annotated[float, Range(0, 1)] = 1.0
    """Share of the time in which a robot may send, over an hour."""
    reuse: bool = False
    """Whether each neighborhood (a robot and all in its range) has the bandwidth; else the team has it."""
    partition: tuple[Partition, ...] = ()

    def __post_init__(self) -> None:
        ChannelOptions.__post_init__(self)
        for name in ("frame_bytes", "send_bytes", "receive_bytes"):
            if 0 < getattr(self, name) < MIN_FRAME:
                raise ValueError(
                    f"{name} = {getattr(self, name)}: must be 0 (no limit), or {MIN_FRAME} or more"
                )
        if self.duty_cycle <= 0:
            raise ValueError("duty_cycle = 0: must be above 0, as 0.01 for 1 %; 1: no limit")

    @property
    def perfect(self) -> bool:
        """Whether the channel is lossless and the shared budget is the only limit."""
        limited = self.send_bytes or self.receive_bytes or self.duty_cycle < 1 or self.reuse
        return self.lossless and not limited
