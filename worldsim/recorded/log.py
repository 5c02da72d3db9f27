"""The common form of all logs: scans of one laser, with poses in a fixed frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from protocol.metric_scans import BeamAngles, MetricScan

MAX_BACK_S = 5.0
"""Seconds by which a scan may be older than one before it in the log."""

JUMP_M, JUMP_M_PER_S, UNTIMED_JUMP_M = 1.0, 5.0, 10.0
"""A pose jumps if it moves farther and faster than this; the last is the distance in logs without times."""

SAME_BEAMS = 1e-4
"""Radians by which angles of the same beams may differ."""


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

    @classmethod
    def of(
        cls,
        path: Path,
        name: str,
        scans: Sequence[MetricScan],
        poses: Sequence[tuple[float, ...]],
        stamps: Sequence[float],
        notes: Sequence[str] = (),
    ) -> RecordedLog:
        """Return the log of a file. All scans are read at the angles of the beams that most of them have.

        LogError if these are not the angles of a laser.
        """
        kinds = [(len(each.ranges), round(each.first, 4), round(each.increment, 6)) for each in scans]
        like = scans[kinds.index(Counter(kinds).most_common(1)[0][0])]
        try:
            angles = like.angles
        except ValueError as error:
            raise LogError(f"{path}: {error}") from None
        if others := sum(not each.has_beams_of(like, SAME_BEAMS) for each in scans):
            notes = (
                *notes,
                f"{path}: {others} of {len(scans)} scans do not have {angles}, as most have; their ranges are taken "
                "at the nearest of these angles",
            )
        ranges = np.array([each.at_angles_of(like).millimeters() for each in scans])
        return cls(
            name, angles, np.array(poses, np.float64), ranges, np.array(stamps, np.float64), tuple(notes)
        )

    @property
    def scans(self) -> int:
        """Number of scans."""
        return len(self.poses)

    @property
    def jump(self) -> str:
        """Where the pose moves faster than a robot, as when odometry is reset; empty if it never does."""
        ways = np.hypot(*np.diff(self.poses[:, :2], axis=0).T)
        if not len(self.stamps):
            found = np.flatnonzero(ways > UNTIMED_JUMP_M)
            within = ""
        else:
            times = np.abs(np.diff(self.stamps))
            found = np.flatnonzero((ways > JUMP_M) & (ways > JUMP_M_PER_S * times))
            within = f" within {times[found[0]]:.1f} s" if len(found) else ""
        if not len(found):
            return ""
        first = "by" if len(found) == 1 else f"{len(found)} times, first by"
        return f"the pose jumps {first} {ways[found[0]]:.1f} m{within}, before scan {found[0] + 2}"
