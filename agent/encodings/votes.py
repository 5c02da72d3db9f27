"""Votes of robots about each cell, by which false maps are noticed.

A cell is a wall if any robot reports a wall, unless two others report it as free. Maps of exact encodings contradict
neither each other nor this robot's own sight, as long as all robots are honest. So a robot is *doubted*, and its
reports do not count any more, if

- this robot sees `MANY` of its cells in another state; or
- at least two others report `MANY` of its cells in another state, and each of these is contradicted by fewer robots.

Maps of noisy lasers, and copies within a tolerance, differ although all robots are honest: then no robot is doubted.
With noisy lasers, this robot's own grid is one report among equals (`Votes.unite`): its own pose may be the wrong one.

All maps of a robot, one per incarnation, count as one voter. Doubts last until all votes are counted again, after
entries turned out not to be their author's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.settings import Settings
from protocol.arrays import Int32s, Int64Rows, Int64s, Uint8, Uint8s
from protocol.boxes import Boxes
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

MANY = 40
"""Cells in which two maps must differ before one of them is doubted; the maps of honest robots never differ."""

VOTERS = 63
"""Robots with a bit of their own; in larger teams, robots share bits, count as one voter, and are never doubted."""


class Votes:
    """The reports of all robots about each cell."""

    def __init__(self, settings: Settings) -> None:
        self.received: Grid = np.full((settings.height, settings.width), UNKNOWN, np.uint8)
        """The state of each cell by the reports that count, shape (h, w)."""
        self._robot, self._robots = settings.robot, settings.robots
        self._judges = settings.robots <= VOTERS and not settings.shares_tiles
        self.reset()

    def reset(self) -> None:
        """Forget all votes, and all doubts."""
        self.received[:] = UNKNOWN
        self._voters = np.zeros((self.received.size, 2), np.int64)  # memory only where robots report
        """The robots that report each cell as free, and those that report a wall, as bits."""
        self._believed = (1 << VOTERS) - 1
        self.doubted: dict[int, str] = {}
        """Why each doubted robot is doubted, by its number."""
        self.contested = False
        """Whether robots have contradicted each other since the last call of `judge`."""

    def count(self, robot: int, places: Int32s, states: Uint8s, *, revises: bool = True) -> None:
        """Take a robot's reports: the states of cells, given as indices of the flat grid.

        They replace its earlier ones of these cells; without `revises`, the earlier ones stand.
        """
        votes = self._voters, self.received.reshape(-1)
        if _count(places, states, robot % VOTERS, revises, self._believed, *votes):
            self.contested = True

    def judge(self, own: Grid) -> bool:
        """Doubt the robots that this robot's own grid and others contradict; return whether there are new ones."""
        self.contested = False
        if not self._judges:
            return False
        differ = np.zeros((self._robots, self._robots), np.int64)
        by_sight = np.zeros(self._robots, np.int64)
        _compare(own.reshape(-1), self._voters, self._believed, differ, by_sight)
        by_sight[self._robot] = 0
        before = len(self.doubted)
        for robot in np.flatnonzero(by_sight >= MANY).tolist():
            self._doubt(robot, f"this robot sees {by_sight[robot]} of its cells otherwise")
        while (outvoted := self._outvoted(differ >= MANY)) is not None:
            self._doubt(outvoted, f"two others report {MANY} or more of its cells otherwise")
        if len(self.doubted) > before:
            _resolve_all(self._voters, self._believed, self.received.reshape(-1))
        return len(self.doubted) > before

    def unite(self, own: Grid, boxes: Boxes, united: Grid) -> None:
        """Write to `united`, inside the boxes, the states by all reports, this robot's being those of its own grid.

        All grids have shape (h, w). Where the own grid is unknown, the robot's log counts.
        """
        _unite_with(own, self._robot % VOTERS, self._voters, self._believed, boxes, united)

    def reported(self) -> Grid:
        """Return the map of all reports that count, shape (h, w): a cell is a wall if any robot reports one."""
        grid = np.empty_like(self.received)
        _unite(self._voters, self._believed, grid.reshape(-1))
        return grid

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
        self._believed &= ~(1 << robot)
        self.doubted[robot] = reason


@kernel
def _resolve(free: int, walls: int) -> Uint8:
    """Return the state of a cell that these robots report as free, and those as a wall."""
    if not walls:
        return FREE if free else UNKNOWN
    one_wall, several_free = walls & (walls - 1) == 0, free & (free - 1) != 0
    return FREE if one_wall and several_free else OCCUPIED


@kernel
def _count(
    places: Int32s,
    states: Uint8s,
    robot: int,
    revises: bool,
    believed: int,
    voters: Int64Rows,
    received: Uint8s,
) -> int:
    """Take a robot's reports, and update the received states; return the number of contested cells."""
    contested = 0
    for index in range(len(places)):
        votes, state = voters[places[index]], states[index]
        if not revises and votes[OCCUPIED - state] >> robot & 1:
            continue
        votes[0] &= ~(1 << robot)
        votes[1] &= ~(1 << robot)
        if state != UNKNOWN:
            votes[state - FREE] |= 1 << robot
        free, walls = votes[0] & believed, votes[1] & believed
        contested += free != 0 and walls != 0
        received[places[index]] = _resolve(free, walls)
    return contested


@kernel
def _resolve_all(voters: Int64Rows, believed: int, received: Uint8s) -> None:
    """Resolve all cells again."""
    for place in range(len(received)):
        received[place] = _resolve(voters[place, 0] & believed, voters[place, 1] & believed)


@kernel
def _unite(voters: Int64Rows, believed: int, reported: Uint8s) -> None:
    """Write the state of each cell by all reports; walls take precedence."""
    for place in range(len(reported)):
        free, walls = voters[place, 0] & believed, voters[place, 1] & believed
        reported[place] = OCCUPIED if walls else FREE if free else UNKNOWN


@kernel
def _unite_with(own: Grid, robot: int, voters: Int64Rows, believed: int, boxes: Boxes, united: Grid) -> None:
    """Write the state of each cell in the boxes, the robot's vote being that of `own` where it is known."""
    width = own.shape[1]
    for box in boxes:
        for y in range(box[1], box[3]):
            for x in range(box[0], box[2]):
                votes, state = voters[y * width + x], own[y, x]
                free, walls = votes[0] & believed, votes[1] & believed
                if state != UNKNOWN:
                    free = free & ~(1 << robot) | (state == FREE) << robot
                    walls = walls & ~(1 << robot) | (state == OCCUPIED) << robot
                united[y, x] = _resolve(free, walls)


@kernel
def _compare(own: Uint8s, voters: Int64Rows, believed: int, differ: Int64Rows, by_sight: Int64s) -> None:
    """Count the cells in which each pair of robots differ, and those in which each robot differs from `own`."""
    for place in range(len(own)):
        free, walls = voters[place, 0] & believed, voters[place, 1] & believed
        wrong = walls if own[place] == FREE else free if own[place] == OCCUPIED else 0
        for robot in range(len(by_sight) if wrong else 0):
            by_sight[robot] += wrong >> robot & 1
        for robot in range(len(by_sight) if free and walls else 0):
            for other in range(len(by_sight) if free >> robot & 1 else 0):
                differ[robot, other] += walls >> other & 1
                differ[other, robot] += walls >> other & 1
