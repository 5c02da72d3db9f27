"""Contradict false maps by what other robots report.

Two voters at most are kept per cell and state. A cell is a wall if any robot reports a wall, unless two others report
it as free. Maps of exact encodings contradict neither each other nor this robot's own sight, as long as all robots are
honest. So a robot is *doubted*, and its reports do not count any more, if

- this robot sees `MANY` of its cells otherwise; or
- each of at least two others reports `MANY` of its cells otherwise, and fewer robots contradict those two.

All maps of a robot, one per incarnation, count as one voter. A doubt ends only with the votes: if entries turn out not
to be their author's, all logs are decoded and counted again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.settings import Settings
from protocol.arrays import Bools, Int64Rows, Int64s, Uint8, Uint8s, Uint16Rows
from protocol.arrays import Int32s as Places
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

MANY = 40
"""Cells in which two maps must differ before one of them is doubted; the maps of honest robots never differ."""

Voters = Uint16Rows
"""Per cell two robots that report it as free, and two that report a wall: each its number plus 1, or 0 for none."""


class Votes:
    """The reports of all robots about each cell.

    Attributes
    ----------
    received : uint8 array, shape (h, w)
        The state of each cell by the reports that count.
    doubted : dict
        Why each doubted robot is doubted, by its number.
    contested : bool
        Whether reports may have been contradicted since the last call of `judge`; a reader that finds a contradiction
        to its own sight sets it.
    """

    def __init__(self, settings: Settings) -> None:
        self.received: Grid = np.full((settings.height, settings.width), UNKNOWN, np.uint8)
        self._robot, self._robots = settings.robot, settings.robots
        self._voters: NDArray[np.uint16] = np.zeros((self.received.size, 4), np.uint16)
        self.reset()

    def reset(self) -> None:
        """Forget all votes, and all doubts."""
        self.received[:] = UNKNOWN
        self._voters[:] = 0
        self._ignored = np.zeros(self._robots + 1, np.bool_)
        self.doubted: dict[int, str] = {}
        self.contested = False

    def count(self, robot: int, places: Places, states: Uint8s) -> None:
        """Take a robot's reports: the new state of each of some cells, given as indices of the flat grid."""
        if _count(places, states, robot + 1, self._ignored, self._voters, self.received.reshape(-1)):
            self.contested = True

    def judge(self, own: Grid) -> bool:
        """Doubt the robots that this robot's own grid and others contradict; return whether there are new ones."""
        self.contested = False
        differ = np.zeros((self._robots, self._robots), np.int64)
        by_sight = np.zeros(self._robots, np.int64)
        _compare(own.reshape(-1), self._voters, self._ignored, differ, by_sight)
        before = len(self.doubted)
        by_sight[self._robot] = 0
        for robot in np.flatnonzero(by_sight >= MANY).tolist():
            self._doubt(robot, f"this robot sees {by_sight[robot]} of its cells otherwise")
        while (outvoted := self._outvoted(differ >= MANY)) is not None:
            self._doubt(outvoted, "two other robots report many of its cells otherwise")
        if len(self.doubted) > before:
            _resolve_all(self._voters, self._ignored, self.received.reshape(-1))
        return len(self.doubted) > before

    def _outvoted(self, opposed: NDArray[np.bool_]) -> int | None:
        """Return a robot that two or more others contradict, each of which fewer contradict; None if there is none."""
        opposed[list(self.doubted)] = False
        opposed[:, list(self.doubted)] = False
        opponents = opposed.sum(axis=1)
        for robot in np.flatnonzero(opponents >= 2).tolist():
            if robot != self._robot and (opponents[opposed[robot]] < opponents[robot]).all():
                return robot
        return None

    def _doubt(self, robot: int, reason: str) -> None:
        self._ignored[robot + 1] = True
        self.doubted[robot] = reason


@kernel
def _resolve(voters: Voters, place: int, ignored: Bools) -> Uint8:
    """Return the state of a cell by the reports that count."""
    free = walls = 0
    for slot in range(2):
        voter, other = voters[place, slot], voters[place, 2 + slot]
        free += voter > 0 and not ignored[voter]
        walls += other > 0 and not ignored[other]
    if walls and not (walls == 1 and free == 2):
        return OCCUPIED
    return FREE if free else UNKNOWN


@kernel
def _count(
    places: Places, states: Uint8s, voter: int, ignored: Bools, voters: Voters, received: Uint8s
) -> int:
    """Replace a voter's reports of cells, and the received states; return the number of contested cells."""
    contested = 0
    for index in range(len(places)):
        place, state = np.int64(places[index]), states[index]
        for other in (FREE, OCCUPIED):
            slot = 2 * (other - FREE)
            first, second = voters[place, slot], voters[place, slot + 1]
            if other != state:
                if first == voter:
                    voters[place, slot], voters[place, slot + 1] = second, 0
                elif second == voter:
                    voters[place, slot + 1] = 0
            elif voter not in (first, second):
                if first == 0:
                    voters[place, slot] = voter
                elif second == 0 or ignored[second]:
                    voters[place, slot + 1] = voter
                elif ignored[first]:
                    voters[place, slot] = voter
        received[place] = _resolve(voters, place, ignored)
        contested += voters[place, 0] > 0 and voters[place, 2] > 0 and not ignored[voter]
    return contested


@kernel
def _resolve_all(voters: Voters, ignored: Bools, received: Uint8s) -> None:
    """Resolve all cells again."""
    for place in range(len(received)):
        received[place] = _resolve(voters, place, ignored)


@kernel
def _compare(own: Uint8s, voters: Voters, ignored: Bools, differ: Int64Rows, by_sight: Int64s) -> None:
    """Count the cells in which each pair of robots differ, and those in which each robot differs from `own`."""
    for place in range(len(own)):
        known = own[place]
        for slot in range(4):
            voter = voters[place, slot]
            if voter == 0 or ignored[voter]:
                continue
            if known != UNKNOWN and known != FREE + (slot >> 1):
                by_sight[voter - 1] += 1
            for against in range(2, 4):
                other = voters[place, against]
                if slot < 2 and other > 0 and not ignored[other]:
                    differ[voter - 1, other - 1] += 1
                    differ[other - 1, voter - 1] += 1
