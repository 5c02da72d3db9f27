"""A world that replays logs: each robot senses the scans of its stretch, wherever it wants to drive.

There is no ground truth. The map of this world is the one that an occupancy estimator makes of all scans of the team.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FREE, Grid
from protocol.messages import Move, Sense
from protocol.range_scans import (
    NO_MEASUREMENT,
    UNIT,
    RangeScan,
    cell_offset,
    encode_range_scan,
    nearest_heading,
)
from worldsim.base import BaseWorld
from worldsim.world import WorldSettings

END_OF_LOG = "end of the log"
UNDELIVERED = "end of the log, and not all maps could be delivered"


@dataclass(frozen=True, eq=False)
class Stretch:
    """The scans that one robot replays, in the frame of the map's cells (`protocol.range_scans`)."""

    steps: NDArray[np.int64]
    """The step of each scan, from 1, strictly ascending; the first is 1. Shape (scans,)."""
    places: NDArray[np.int32]
    """Positions in 1 / `UNIT` cell, shape (scans, 2)."""
    headings: NDArray[np.int64]
    """Headings in 1 / `TURN`, shape (scans,)."""
    ranges: NDArray[np.uint16]
    """Ranges in millimeters, shape (scans, beams)."""
    found: Sequence[NDArray[np.int32]]
    """Free cells of the map that the robot knows from each scan on, as indices of the flat grid."""

    def scan(self, number: int) -> RangeScan:
        """Return a scan by its number, from 0."""
        x, y = self.places[number].tolist()
        return RangeScan((x, y), int(self.headings[number]), self.ranges[number])


class RecordedWorld(BaseWorld):
    """The world of a recorded run; `stretches` has one stretch per robot, and `truth` is the map of all of them.

    A robot stays where its last scan was taken until the step of the next one. It has no measurements in between.
    """

    finished = END_OF_LOG
    stalled = UNDELIVERED

    def __init__(self, truth: Grid, settings: WorldSettings, stretches: Sequence[Stretch]) -> None:
        super().__init__(truth, settings)
        self.reachable = truth == FREE
        self._stretches = stretches
        self._seen = np.zeros(truth.size, np.bool_)
        self._places = [each.scan(0).place for each in stretches]

    def share_seen(self, robot: int) -> float:
        """Return the share of the map's free cells that the team knows."""
        return self.seen_cells / self.reachable_cells

    def may_end(self) -> bool:
        """Return whether all robots have replayed their stretch."""
        return all(self.step >= self._stretches[robot].steps[-1] for robot in self.present_robots())

    def is_stalled(self, moves: Mapping[int, Move]) -> bool:
        """Return whether no robot that sends these moves makes progress, but for those that have finished."""
        return bool(moves) and all(move.stalled or move.explored for move in moves.values())

    def restore(self, robot: int) -> None:
        """Put a removed robot back where its last scan was taken."""
        if robot not in self.cells:
            self.cells[robot] = self._last_cells[robot]

    def move_robots(self, moves: Mapping[int, Move]) -> Iterator[tuple[int, Sense]]:
        """Begin the next step; return an iterator over the scans of this step."""
        self.step += 1
        return iter([(robot, self._sense(robot)) for robot in self.active_robots()])

    def _sense(self, robot: int) -> Sense:
        stretch = self._stretches[robot]
        number = int(np.searchsorted(stretch.steps, self.step, "right")) - 1
        scan = stretch.scan(number)
        self._place(robot, scan)
        if stretch.steps[number] == self.step:
            found = stretch.found[number]
            self.seen_cells += int(np.count_nonzero(~self._seen[found]))
            self._seen[found] = True
        else:
            scan = RangeScan(scan.place, scan.heading, np.full_like(scan.ranges, NO_MEASUREMENT))
        (x, y), offset, heading = self.cells[robot], self.offsets[robot], self.headings[robot]
        return Sense(self.step, x, y, heading, b"", b"", "", *offset, encode_range_scan(scan))

    def _place(self, robot: int, scan: RangeScan) -> None:
        """Move a robot to where a scan was taken."""
        before, self._places[robot] = self._places[robot], scan.place
        self.driven[robot] += math.dist(before, scan.place) / UNIT
        self.cells[robot] = scan.x, scan.y
        self.offsets[robot] = cell_offset(scan.place[0]), cell_offset(scan.place[1])
        self.headings[robot] = nearest_heading(scan.heading)
