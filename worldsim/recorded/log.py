"""The common form of all logs: scans of one laser, with poses in a fixed frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.metric_scans import BeamAngles


class LogError(ValueError):
    """A log cannot be replayed; the message names the file, the place, and what it lacks."""


@dataclass(frozen=True, eq=False)
class RecordedLog:
    """The scans of one robot's log, in the order of time."""

    name: str
    angles: BeamAngles
    poses: NDArray[np.float64]
    """Poses of the laser, shape (scans, 3): x and y in meters, y up; heading in radians, counterclockwise."""
    ranges: NDArray[np.uint16]
    """Ranges in millimeters, shape (scans, beams), by ascending angle (`protocol.range_scans`)."""
    stamps: NDArray[np.float64]
    """Times in seconds, shape (scans,); empty if the log has none."""
    notes: tuple[str, ...] = ()
    """What the user should know about the log."""

    @property
    def scans(self) -> int:
        """Number of scans."""
        return len(self.poses)
