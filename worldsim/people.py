"""People who walk about in the building: lasers see them, and neither they nor robots walk into each other.

A person walks along a shortest way to a random cell, stays there for a while, and walks on. A person whom a robot
blocks waits, then walks around all robots, or to another cell if there is no way around them. People pass each other
without contact. They are no part of the true map.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import NO_CELLS, BoolRows, Cells, FloatRows
from protocol.grid import FREE, Cell, Grid, Mask, enlarge
from protocol.kernels import kernel
from protocol.keyed_random import keyed_random
from worldsim.motion import TAKEN_BY_PERSON, TAKEN_BY_ROBOT, drive, mark_near
from worldsim.regions import largest_part

WAIT = 2
"""Steps for which a person waits for a robot to move out of the way."""

LONGEST_STAY = 10
"""Most steps that a person stays at the end of a way."""

RobotDisc = tuple[Cell, float]
"""Cell of a robot's center, and its radius in cells."""


@dataclass(frozen=True)
class PeopleSettings:
    """People in units of the world."""

    number: int
    speed: float
    """Cells per step."""
    radius_cells: float
    """Radius of the disc that a person covers, in cells."""


@dataclass
class _Person:
    cell: Cell
    way: Cells = field(default_factory=lambda: NO_CELLS)
    """The cells ahead."""
    stay: int = 0
    """Steps to stay at the end of the way, or left to stay there."""
    blocked: int = 0
    """Steps for which a robot has blocked the way."""
    carry: float = 0.0
    """Unused distance, too short for the next cell."""


class People:
    """All people; draws are keyed by the run's seed, person, and step.

    `truth` (uint8) is the true map, and `reachable` (bool) the cells in which people may be; both have shape (h, w).
    Raises ValueError if there are fewer free cells that are not too close to `robots` than people.
    """

    def __init__(
        self, truth: Grid, reachable: Mask, robots: Iterable[RobotDisc], settings: PeopleSettings, seed: int
    ) -> None:
        self.radius_cells, self._speed, self._seed = settings.radius_cells, settings.speed, seed
        floor = largest_part((enlarge(truth, settings.radius_cells) == FREE) & reachable)
        self._floor: Grid = np.where(floor, np.uint8(FREE), np.uint8(0))
        rows, columns = np.nonzero(self._floor == FREE)
        self._goals = np.stack([columns, rows], axis=1)
        """Cells that people walk to: those of the largest connected part of the floor."""
        starts = self._goals[~self._near(robots)[rows, columns]]
        if len(starts) < settings.number:
            raise ValueError(
                f"{settings.number} people do not fit: there are {len(starts)} free cells for them"
            )
        picked = keyed_random(seed, "people", 0, 0).permutation(len(starts))[: settings.number]
        self._people = [_Person((x, y)) for x, y in starts[picked].tolist()]

    @property
    def cells(self) -> list[Cell]:
        """The cell of each person."""
        return [person.cell for person in self._people]

    @property
    def discs(self) -> FloatRows:
        """Center (x, y) and radius of each person in cells, shape (n, 3); cell (0, 0) has its low corner at (0, 0)."""
        return np.array([(x + 0.5, y + 0.5, self.radius_cells) for x, y in self.cells]).reshape(-1, 3)

    def mark(self, taken: NDArray[np.uint8], radius_cells: float) -> list[NDArray[np.uint8]]:
        """Mark the cells that a robot of this radius must not enter; return the changed parts of `taken`, views."""
        reach = radius_cells + self.radius_cells
        return [mark_near(taken, cell, reach, TAKEN_BY_PERSON) for cell in self.cells]

    def advance(self, step: int, robots: Iterable[RobotDisc]) -> None:
        """Move all people in a step; they do not walk into `robots`."""
        taken = self._near(robots)
        for number, person in enumerate(self._people):
            self._advance(number, person, step, taken)

    def _near(self, robots: Iterable[RobotDisc]) -> Mask:
        """Return the cells that people do not enter because of robots, shape (h, w)."""
        near = np.zeros(self._floor.shape, np.uint8)
        for cell, radius_cells in robots:
            mark_near(near, cell, self.radius_cells + radius_cells, TAKEN_BY_ROBOT)
        return near.view(np.bool_)

    def _advance(self, number: int, person: _Person, step: int, taken: Mask) -> None:
        if not len(person.way) and person.stay:
            person.stay -= 1
            return
        if person.blocked > WAIT:
            floor = np.where(taken, np.uint8(0), self._floor)
            person.way, person.blocked = shortest_way(floor, person.cell, person.way[-1].tolist()), 0
        if not len(person.way):
            random = keyed_random(self._seed, "people", 1 + number, step)
            goal = self._goals[random.integers(len(self._goals))].tolist()
            person.stay = int(random.integers(LONGEST_STAY + 1))
            person.way = shortest_way(self._floor, person.cell, goal)
        ahead = [(x, y) for x, y in person.way[: int(self._speed) + 2].tolist()]
        motion = drive(self._floor, taken, person.cell, ahead, self._speed + person.carry)
        person.carry = motion.carry
        person.blocked = person.blocked + 1 if motion.blocked else 0
        person.way = person.way[len(motion.cells) :]
        person.cell = motion.cells[-1] if motion.cells else person.cell


def shortest_way(floor: Grid, start: Cell, end: Cell) -> Cells:
    """Return the cells of a way of fewest steps to any of eight neighbors, without the start, shape (n, 2).

    Only free cells of `floor`, uint8 of shape (h, w), are entered, and corners are not cut. Empty without a way.
    """
    return _shortest_way(floor == FREE, *start, *end)


@kernel
def _passes(floor: BoolRows, x: int, y: int, to_x: int, to_y: int) -> bool:
    """Return whether a step to a neighbor stays on the floor; past a corner only if all four cells there are free."""
    height, width = floor.shape
    if not (0 <= to_x < width and 0 <= to_y < height):
        return False
    return bool(floor[to_y, to_x] and floor[y, to_x] and floor[to_y, x])


@kernel
def _shortest_way(floor: BoolRows, x: int, y: int, to_x: int, to_y: int) -> Cells:
    """Breadth-first search from the end; the way prefers steps along an axis, so that it does not zigzag."""
    width = floor.shape[1]
    steps = np.full(floor.shape, -1, np.int32)
    queue = np.empty(floor.size, np.int32)
    steps[to_y, to_x], queue[0] = 0, to_y * width + to_x
    head, tail = 0, 1
    while head < tail and steps[y, x] < 0:
        row, column = queue[head] // width, queue[head] % width
        head += 1
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                if (
                    not _passes(floor, column, row, column + dx, row + dy)
                    or steps[row + dy, column + dx] >= 0
                ):
                    continue
                steps[row + dy, column + dx] = steps[row, column] + 1
                queue[tail] = (row + dy) * width + column + dx
                tail += 1
    way = np.empty((max(0, steps[y, x]), 2), np.int32)
    for at in range(len(way)):
        best_x, best_y, most = x, y, 3
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                away = abs(dx) + abs(dy)
                if (
                    away < most
                    and _passes(floor, x, y, x + dx, y + dy)
                    and steps[y + dy, x + dx] == steps[y, x] - 1
                ):
                    best_x, best_y, most = x + dx, y + dy, away
        x, y = best_x, best_y
        way[at, 0], way[at, 1] = x, y
    return way
