"""Options of the radio: its links, its channel, and the limits of robots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from protocol.bounds import Options, Range

MIN_FRAME = 16
"""Minimum frame size in bytes: the longest packet that cannot be split, a broadcast, and a checksum."""

LOG_DISTANCE = "log-distance"
"""The model of links that walls weaken."""


MAX_STEPS = 10_000
"""Maximum delay of a frame in steps."""

MOST = 1e6
"""Largest value of options without another limit."""

Probability = Annotated[float, Range(0, 1)]


@dataclass(frozen=True)
class ChannelOptions(Options):
    """Loss, delay, duplication, and damage of frames; bursts are those of Gilbert and Elliott."""

    loss: Probability = 0.0
    """Probability that a robot in range loses a frame."""
    burst_loss: Probability = 1.0
    """Probability that a robot in range loses a frame during a burst."""
    burst_every: Annotated[float, Range(0, MOST)] = 0.0
    """Mean steps between bursts of a link; 0: none."""
    burst_steps: Annotated[float, Range(1, MOST)] = 5.0
    """Mean steps of a burst."""
    delay: Annotated[int, Range(0, MAX_STEPS)] = 0
    """Steps until a frame arrives."""
    jitter: Annotated[int, Range(0, MAX_STEPS)] = 0
    """Maximum of further steps, which are drawn for each frame."""
    duplication: Probability = 0.0
    """Probability that a frame arrives twice."""
    bit_errors: Probability = 0.0
    """Probability of each bit to flip; above 0, frames end with a checksum."""
    checksums: bool = False
    """Whether frames end with a checksum in any case."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0 < self.burst_every < 1:
            raise ValueError(f"burst_every = {self.burst_every:g}: must be 0 (no bursts), or 1 step or more")

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
