"""Look again before the end: a wall of a noisy map may be a person who has moved on.

A robot that has nothing left to explore, or to which teammates leave no target, looks for frontier segments that walls
cut off. *Doubtful* walls are small ones, and cells that were free for some steps before. If doubtful walls alone close
a way to such a segment, the robot drives along it up to the first of them. Otherwise, it drives as close as it can to
the longest segment. There it waits, and sees whether the wall is still there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from agent.planning.candidates import components
from agent.planning.frontier import frontier_cells
from agent.planning.path_planner import PathPlanner
from agent.settings import Settings
from protocol.arrays import NO_CELLS, Cells
from protocol.grid import FREE, OCCUPIED, Cell, Grid, Mask

PATIENCE = 20
"""Steps for which a robot looks, besides the time that it needs to drive there: people move on, and fade from maps."""

BUSY = 10
"""Consecutive steps with something left to explore after which the robot may look again as long as before."""

LASTING = 3
"""Steps for which a cell must have been free so that a wall in it is doubtful; beside walls, noise flickers."""

SMALL_M2 = 0.5
"""Walls up to this area, in square meters, are doubtful: one or two people."""

SEGMENT_M = 0.5
"""Shorter frontier segments, in meters, do not count: noise leaves them behind walls."""

BEYOND = 2
"""A frontier is cut off if it is farther than this many cells, and the robot's radius, from all reachable cells."""


class SecondLook:
    """What one robot remembers of its planning grid, uint8 of shape (h, w), and where it looks again."""

    def __init__(self, settings: Settings) -> None:
        self._radius, self._speed = settings.body.radius_cells, settings.body.speed
        self._small = SMALL_M2 / settings.resolution**2
        self._segment = SEGMENT_M / settings.resolution
        self._free_steps: NDArray[np.uint8] = np.zeros((settings.height, settings.width), np.uint8)
        """Steps for which each cell has been free, `LASTING` at most."""
        self._steps_left = math.inf
        """Steps for which the robot still looks again; infinite before it has begun."""
        self._busy_steps = 0

    def note(self, grid: Grid, *, is_idle: bool) -> None:
        """Note the planning grid of a step, and whether the strategy has no target for the robot."""
        self._free_steps += (grid == FREE) & (self._free_steps < LASTING)
        self._busy_steps = 0 if is_idle else self._busy_steps + 1
        if self._busy_steps >= BUSY:
            self._steps_left = math.inf

    def way(self, grid: Grid, here: Cell) -> Cells | None:
        """Return the cells of a way to where the robot looks again, without the start.

        None if nothing is cut off, or if the robot has looked for long enough: it has called this once per step.
        """
        if self._steps_left <= 0:
            return None
        way = self._way(grid, here)
        if way is not None:
            self._steps_left = min(self._steps_left, PATIENCE + len(way) / self._speed) - 1
        return way

    def _way(self, grid: Grid, here: Cell) -> Cells | None:
        from scipy import ndimage  # noqa: PLC0415  slow to import, and needed only near the end of a run

        planner = PathPlanner(grid, radius_cells=self._radius)
        reachable = np.isfinite(planner.costs(*here))
        away, (rows, columns) = ndimage.distance_transform_edt(~reachable, return_indices=True)
        cut_off = frontier_cells(grid, away > self._radius + BEYOND)
        if not len(cut_off):
            return None
        cut_off, sizes = components(cut_off)
        sizes = np.repeat(sizes, sizes)
        cut_off, sizes = cut_off[sizes >= self._segment], sizes[sizes >= self._segment]
        if not len(cut_off):
            return None
        way = self._way_to_doubtful_wall(grid, here, cut_off, planner)
        if way is not None:
            return way
        longest = cut_off[sizes == sizes.max()]
        x, y = longest[int(np.argmin(away[longest[:, 1], longest[:, 0]]))].tolist()
        way = planner.path(here, (int(columns[y, x]), int(rows[y, x])))
        return NO_CELLS if way is None else way

    def _way_to_doubtful_wall(
        self, grid: Grid, here: Cell, frontier: Cells, planner: PathPlanner
    ) -> Cells | None:
        """Return the open part of the way to a frontier cell that doubtful walls close; None if there is none."""
        without = np.where(self._doubtful(grid), np.uint8(FREE), grid)
        behind = PathPlanner(without, radius_cells=self._radius)
        costs = behind.costs_to(*here, frontier)
        x, y = frontier[int(np.argmin(costs))].tolist()
        way = behind.path(here, (x, y)) if np.isfinite(costs).any() else None
        if way is None:
            return None
        closed = planner.floor[way[:, 1], way[:, 0]] != FREE
        return way[: int(np.argmax(closed))] if closed.any() else way

    def _doubtful(self, grid: Grid) -> Mask:
        """Return the doubtful walls, shape (h, w)."""
        from scipy import ndimage  # noqa: PLC0415  slow to import, and needed only near the end of a run

        walls = grid == OCCUPIED
        labels, _ = ndimage.label(walls, np.ones((3, 3)))
        small = np.bincount(labels.ravel())[labels] <= self._small
        doubtful: Mask = walls & (small | (self._free_steps >= LASTING))
        return doubtful
