"""Options of a recorded run: which logs to replay, and how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from protocol.bounds import Range, check_ranges

PER_SCAN, RECORDED = "scan", "recorded"
"""One scan per robot and step; or one second of the log per step."""

PACES = PER_SCAN, RECORDED


@dataclass(frozen=True)
class RecordingOptions:
    """The logs that robots replay instead of exploring a simulated building."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    files: tuple[str, ...] = ()
    """Logs: one for the whole team, which is cut into one stretch per robot that is no listener, or one for each of
    them. Empty: the run is simulated."""
    every: Annotated[int, Range(1, 1_000_000)] = 1
    """1: replay all scans; 5: each fifth."""
    pace: str = PER_SCAN
    """``scan``: one scan per robot and step; ``recorded``: a step is a second of the log."""
    topic: str = ""
    """The topic of the laser, if a bag has several; empty: its only one."""
    resolution: Annotated[float, Range(0.01, 10.0, "m per cell")] = 0.1
    """Side of a cell in meters."""
    listeners: int = 0
    """Number of robots without scans, which only receive maps, as a base station does. They are the last ones."""

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.pace not in PACES:
            raise ValueError(f"pace = {self.pace!r}: must be {' or '.join(PACES)}")
        if self.listeners < 0:
            raise ValueError(f"listeners = {self.listeners}: must not be negative")
