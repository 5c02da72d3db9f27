"""Giving way: where a robot waits until a robot that it meets in a narrow opening has passed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.planning.cost_field import costs
from agent.planning.frontier import Floor
from protocol.grid import FREE, Cell, Grid, Mask
from worldsim.motion import TAKEN_BY_ROBOT, mark_near


class Way(NamedTuple):
    """Where another robot is about to drive.

    `cells`: int32 array of shape (n, 2), its own cell first. `reach`: the center of the robot that gives way must stay
    at least this far from each of them, in cells.
    """

    cells: NDArray[np.int32]
    reach: float

    def blocks(self, cell: Cell) -> bool:
        """Return whether a robot in a cell is in the way."""
        away = np.hypot(self.cells[:, 0] - cell[0], self.cells[:, 1] - cell[1])
        return bool((away < self.reach).any())


@dataclass(frozen=True)
class Others:
    """What a robot sees of others.

    `taken` returns the cells, bool of shape (h, w), that it cannot enter because of robots and people nearby. `ways`
    returns the ways of robots that go first: those with lower numbers, or if its argument is true, all.
    """

    taken: Callable[[], Mask]
    ways: Callable[[bool], list[Way]]


def pocket(floor: Grid, here: Cell, ways: Sequence[Way]) -> Cell | None:
    """Return the nearest cell that a robot can reach on a floor, and in which it blocks none of the ways; None if none.

    `floor`: uint8 of shape (h, w), without the cells that others occupy.
    """
    needed = np.zeros(floor.shape, np.uint8)
    for way in ways:
        for x, y in way.cells.tolist():
            mark_near(needed, (x, y), way.reach, TAKEN_BY_ROBOT)
    field = costs(Floor(floor), *here)
    field[(needed != 0) | (floor != FREE)] = np.inf
    row, column = np.unravel_index(int(np.argmin(field)), field.shape)
    return (int(column), int(row)) if np.isfinite(field[row, column]) else None
