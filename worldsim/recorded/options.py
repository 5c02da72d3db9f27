"""Options of a recorded run: which logs to replay, and how."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from protocol.bounds import Options, Range

PER_SCAN, RECORDED = "scan", "recorded"
"""One scan per robot and step; or one second of the log per step."""

PACES = PER_SCAN, RECORDED


@dataclass(frozen=True)
class RecordingOptions(Options):
    """The logs that robots replay instead of exploring a simulated building."""

    files: tuple[str, ...] = ()
    """Logs, for the whole team or one per robot with scans; relative to the scenario file. The log of a team is cut
    into one stretch per robot that is no listener. Empty: the run is simulated."""
    every: Annotated[int, Range(1, 1_000_000)] = 1
    """1: replay all scans; 5: each fifth."""
    pace: str = PER_SCAN
    """``scan``: one scan per robot and step; ``recorded``: a step is a second of the log."""
    topic: str = ""
    """Topic of the laser, if a bag has several; empty: its only one. Several, separated by commas: one log for each, as
    of the robots of a team in one bag."""
    resolution: Annotated[float, Range(0.01, 10.0, "m per cell")] = 0.1
    """Side of a cell, meters."""
    listeners: int = 0
    """How many of the robots, the last ones, have no scans, and only receive maps, as a base station does."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.pace not in PACES:
            raise ValueError(f"pace = {self.pace!r}: must be {' or '.join(PACES)}")
        if self.listeners < 0:
            raise ValueError(f"listeners = {self.listeners}: must not be negative")
        topics = self.topic.split(",")
        if len(topics) > 1 and len(self.files) not in (0, 1, len(topics)):
            raise ValueError(
                f"topic = {self.topic!r}: has {len(topics)} topics for {len(self.files)} logs; give one bag, or one "
                "per topic"
            )

    @property
    def sources(self) -> list[tuple[str, str]]:
        """File and topic of each log."""
        topics = [each.strip() for each in self.topic.split(",")]
        count = logs_of(self.files, self.topic)
        files = self.files * count if len(self.files) == 1 else self.files
        return list(zip(files, topics * count if len(topics) == 1 else topics, strict=True))


def logs_of(files: Sequence[str], topic: str) -> int:
    """Return how many logs these files, and the topics of their lasers, are."""
    return max(len(files), topic.count(",") + 1) if files else 0
