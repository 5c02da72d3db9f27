"""Targets that a robot could not reach, and avoids for a while.

The robot's own navigation may fail where the planner sees a way: beside narrow gaps, glass, or steps. So the unknown
cells around such a target do not count as unknown for some steps: no frontier is left there, and the strategy chooses
another target. Known free cells stay free, so that ways through them remain. With each failure near the same place, the
time doubles; after `MOST_TIMES`, the robot gives the place up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid

MOST_TIMES = 3
"""Failures at one place after which a robot does not try again."""

MARGIN_CELLS = 1.5
"""Cells beyond the robot's radius in which no obstacle is drawn, since the robot stands there."""


@dataclass
class _Place:
    """A target, its failures, and the steps for which it is still avoided."""

    cell: Cell
    times: int = 0
    left: int = 0


class AvoidedTargets:
    """Targets of one robot, avoided within `reach` cells; `radius` is that of the robot, in cells."""

    def __init__(self, reach: float, radius: float) -> None:
        self._near = radius + MARGIN_CELLS
        self._reach = max(reach, self._near + 1)
        self._places: list[_Place] = []

    @property
    def waits(self) -> bool:
        """Whether the robot will try one of them again."""
        return any(place.left > 0 and place.times < MOST_TIMES for place in self._places)

    def add(self, target: Cell, steps: int) -> None:
        """Avoid a target for `steps` steps, or longer if it has failed before."""
        place = next((each for each in self._places if math.dist(each.cell, target) <= self._reach), None)
        if place is None:
            place = _Place(target)
            self._places.append(place)
        place.left = steps << place.times
        place.times += 1

    def draw(self, grid: Grid, here: Cell) -> None:
        """Draw the unknown cells around the avoided places as walls, and those beside the robot as free.

        `grid` has the shape (h, w); the robot stands at `here`.
        """
        rows, columns = np.ogrid[: grid.shape[0], : grid.shape[1]]
        for place in self._places:
            if place.left > 0 or place.times >= MOST_TIMES:
                x, y = place.cell
                unknown = (np.hypot(columns - x, rows - y) <= self._reach) & (grid == UNKNOWN)
                beside = np.hypot(columns - here[0], rows - here[1]) <= self._near
                grid[unknown & ~beside] = OCCUPIED
                grid[unknown & beside] = FREE

    def pass_step(self) -> None:
        """Count a step of the time for which places are avoided."""
        for place in self._places:
            place.left -= place.left > 0
