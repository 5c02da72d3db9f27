"""Escape from local minima of a potential field: when a robot plans a path instead of following forces, and how long.

A robot that does not leave a circle within `STEPS` steps is in a local minimum. It then drives to its closest frontier,
and follows forces again when no frontier is left near the place where that frontier was.
"""

from __future__ import annotations

import math

import numpy as np

from agent.planning.path_planner import PathPlanner
from protocol.arrays import Cells

STEPS = 10
"""Steps without a change of place after which a robot is in a local minimum."""

NEAR_M = 0.5
"""A robot has observed a frontier when none is left within this distance, in meters."""


class Escape:
    """The state of one robot.

    `moved_cells` is the distance in cells that counts as a change of place, `near_cells` is `NEAR_M` in cells.
    """

    def __init__(self, moved_cells: float, near_cells: float) -> None:
        self._moved_cells, self._near_cells = moved_cells, near_cells
        self._place: tuple[float, float] = (math.inf, math.inf)
        """The center of the circle that the robot has not left since `_since`."""
        self._since = 0
        self._frontier: Cells | None = None
        """The frontier cell (x, y) to which the robot escapes; None while it follows forces."""

    def is_needed(self, at: tuple[float, float], step: int, planner: PathPlanner, frontier: Cells) -> bool:
        """Return whether a robot at `at`, in cells, drives to its closest frontier cell; call it once per step.

        `frontier` are all reachable frontier cells of the planner's grid, at least one.
        """
        if math.dist(at, self._place) > self._moved_cells:
            self._place, self._since = at, step
        if self._frontier is not None:
            if np.hypot(*(frontier - self._frontier).T).min() > self._near_cells:
                self._frontier, self._since = None, step
        elif step - self._since >= STEPS:
            costs = planner.costs(int(at[0] + 0.5), int(at[1] + 0.5))
            self._frontier = frontier[np.argmin(costs[frontier[:, 1], frontier[:, 0]])]
        return self._frontier is not None
