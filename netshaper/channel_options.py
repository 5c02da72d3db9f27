"""Options of the channel between robots in range: loss, delay, duplication, and damage of frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from protocol.bounds import Options, Range

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
