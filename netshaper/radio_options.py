"""Options of the radio: its links, its channel, and the limits of robots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from netshaper.channel_options import MOST, ChannelOptions
from protocol.bounds import Options, Range

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
class PathLossOptions(Options):
    """Options of links that distance and walls weaken (model ``log-distance``)."""

    exponent: Annotated[float, Range(0.1, 10)] = 2.0
    """Log-distance: path loss exponent; the loss grows by ten times this number of dB per decade of distance."""
    db_per_meter: Annotated[float, Range(0, 1000)] = 0.0
    """Log-distance: loss per meter, dB."""
    db_per_wall: Annotated[float, Range(0, 1000)] = 6.9
    """Log-distance: loss per wall, dB."""
    shadowing_db: Annotated[float, Range(0, 100)] = 0.0
    """Log-distance: standard deviation of shadowing, dB."""
    shadowing_m: Annotated[float, Range(0.01, MOST)] = 5.0
    """Log-distance: side of the squares with constant shadowing, meters."""


@dataclass(frozen=True)
class RadioOptions(PathLossOptions, ChannelOptions):
    """Options of the radio; docs/radios.md names the sources of their numbers."""

    preset: str = ""
    """Radio by name, for values that the scenario does not give (`protocol.presets`)."""
    frame_bytes: Annotated[int, Range(0, 65535)] = 0
    """Bytes of packets per frame; longer frames are split; 0: no limit."""
    model: str = "disc"
    """Links within the communication range: ``disc``, all; ``line-of-sight``, those without a wall; ``log-distance``,
    those whose path loss is at most that of an open link as long as the range; or a plug-in. See
    `netshaper.radio_models`."""
    send_bytes: Annotated[int, Range(0, 2**31 - 1)] = 0
    """Bytes per step that a robot can send; 0: no limit of its own."""
    receive_bytes: Annotated[int, Range(0, 2**31 - 1)] = 0
    """Bytes per step that a robot can receive; 0: no limit of its own."""
    duty_cycle: Annotated[float, Range(0, 1)] = 1.0
    """Share of each hour in which a robot may send; 1: no limit."""
    reuse: bool = False
    """Spatial reuse: each neighborhood, a robot and all in its range, has the bandwidth, instead of the team."""
    partition: tuple[Partition, ...] = ()
    """Steps in which groups of robots are out of each other's range."""

    def __post_init__(self) -> None:
        super().__post_init__()
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
