"""Options of the channel between robots in range: loss, delay, duplication, and damage of frames."""

from __future__ import annotations

from dataclasses import dataclass

from protocol.bounds import check_bounds

MAX_STEPS = 10_000
"""Maximum delay of a frame in steps."""

MOST = 1e6
"""Largest value of options without another limit."""


@dataclass(frozen=True)
class ChannelOptions:
    """Loss, delay, duplication, and damage of frames.

    Attributes
    ----------
    loss : float
        Probability that a frame is lost to a robot in range.
    burst_loss, burst_every, burst_steps : float
        Bursts (Gilbert and Elliott): the probability of loss in a burst, the mean number of steps between bursts of one
        link, 0 for none, and the mean number of steps of a burst.
    delay, jitter : int
        Number of steps after which a frame arrives, and the maximum of further steps that are drawn for each frame.
    duplication : float
        Probability that a frame arrives twice.
    bit_errors : float
        Probability of each bit to be flipped. Frames then end with a checksum.
    checksums : bool
        Whether frames end with a checksum in any case.
    """

    loss: float = 0.0
    burst_loss: float = 1.0
    burst_every: float = 0.0
    burst_steps: float = 5.0
    delay: int = 0
    jitter: int = 0
    duplication: float = 0.0
    bit_errors: float = 0.0
    checksums: bool = False

    def __post_init__(self) -> None:
        for name, least, most in _BOUNDS:
            check_bounds(self, name, least, most)
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


_BOUNDS = (
    ("loss", 0, 1),
    ("burst_loss", 0, 1),
    ("burst_every", 0, MOST),
    ("burst_steps", 1, MOST),
    ("delay", 0, MAX_STEPS),
    ("jitter", 0, MAX_STEPS),
    ("duplication", 0, 1),
    ("bit_errors", 0, 1),
)
