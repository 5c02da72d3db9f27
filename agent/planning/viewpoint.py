"""Viewpoints: cells from which a scan observes the unknown cells beside a goal, with a short way on through the tour.

A robot need not drive into a nook to observe it. The directions of beams are known, so the cells from which a beam
reaches the nook over known free cells are known as well. One scan from any of these viewpoints suffices.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from agent.planning.path_planner import PathPlanner
from protocol.arrays import BoolRows, Bools, Cells, Int32Rows, Int32s, Int64s
from protocol.grid import FREE, UNKNOWN, Grid, RayTable
from protocol.kernels import kernel

_BEGUN = 1 / 2
"""Cells by which a way may exceed a whole number of steps without another step: robots round lengths."""

_DIGITS = 6
"""Decimals to which lengths are compared."""

_OUTSIDE = 255
"""State of cells outside the part of the grid that a beam may cross."""


def viewpoint_cells(grid: Grid, goal: tuple[int, int], around: RayTable, reach: float) -> Cells:
    """Find all cells from which a beam reaches an unknown 4-neighbor of a goal over free cells, row by row.

    `goal` is a frontier cell of the planning grid, itself among the result; `around` has the beams of the scanner,
    which count up to a length of `reach` cells.
    """
    height, width = grid.shape
    arrivals = _arrivals(around, min(reach, math.hypot(height, width)))
    middle = arrivals.side // 2
    left, top = goal[0] - middle, goal[1] - middle
    part = np.full((arrivals.side, arrivals.side), _OUTSIDE, np.uint8)
    within = grid[max(0, top) : top + arrivals.side, max(0, left) : left + arrivals.side]
    y0, x0 = max(0, -top), max(0, -left)
    part[y0 : y0 + within.shape[0], x0 : x0 + within.shape[1]] = within
    found = np.zeros(part.shape, np.bool_)
    found[middle, middle] = True
    _trace_back(part, arrivals.flat, arrivals.steps, arrivals.rows, arrivals.start, found)
    y, x = np.nonzero(found)
    return np.column_stack([x + left, y + top]).astype(np.int32)


class _Arrivals(NamedTuple):
    """Where the beams of a scanner may end, by their last step, on a square part of a grid with the goal in the middle.

    The part is so large that beams to a neighbor of the goal do not begin outside.
    """

    side: int
    """Side of the part in cells."""
    flat: Int32s
    """The cells of all beams (`RayTable.cells`), as index differences on the part."""
    steps: tuple[int, int, int, int]
    """The four last steps, as index differences."""
    rows: Int32Rows
    """The place of each arrival in `flat`, and that of the first cell of its beam; grouped by last step."""
    start: Int64s
    """First row of each group, and the number of rows."""


@lru_cache(maxsize=16)
def _arrivals(around: RayTable, reach: float) -> _Arrivals:
    """Return the arrivals of beams of at most `reach` cells."""
    side = 2 * int(reach) + 3
    flat = around.flat(side)
    first = np.repeat(around.start[:-1], np.diff(around.start))
    places = np.arange(len(flat), dtype=np.int32)
    last = np.where(places == first, flat, np.diff(flat, prepend=0))
    rows = np.column_stack([places, first])[(around.cells.astype(np.int64) ** 2).sum(axis=1) <= reach**2]
    steps = 1, side, -1, -side
    groups = [rows[last[rows[:, 0]] == step] for step in steps]
    start = np.cumsum([0, *map(len, groups)])
    return _Arrivals(side, flat, steps, np.concatenate(groups), start)


def best_viewpoint(
    planner: PathPlanner, here: tuple[int, int], views: Iterable[Cells | None], goals: Cells, step: float
) -> tuple[int, int] | None:
    """Choose the viewpoint of the first goal of a tour with the shortest way through it and on through the tour.

    Goals that are visible from this viewpoint as well need no further way. The robot, in cell `here`, scans at the end
    of each step of `step` cells, so the way to the viewpoint counts in whole steps. `views` has the viewpoints of each
    goal, None for a goal that the robot must drive to; the first goal has viewpoints.

    Returns None if the robot is already at a viewpoint, so that a scan had no effect, or no viewpoint is reachable.
    """
    more = iter(views)
    cells = next(more)
    assert cells is not None
    ways = planner.costs_to(*here, cells)
    if not ways.all():
        return None
    cost = np.ceil((ways - _BEGUN) / step) * step
    # The end of the way so far, through each viewpoint.
    places = cells.copy()
    for goal, seen_from in zip(goals[1:], more, strict=False):
        missed = np.ones(len(cost), np.bool_)
        if seen_from is not None:
            missed = ~_are_among(cells, seen_from, planner.grid.shape)
        if missed.any():
            cost[missed] += planner.costs_to(int(goal[0]), int(goal[1]), places[missed])
            places[missed] = goal
        if (places == goal).all():
            break
    best = int(np.lexsort((ways, np.round(cost, _DIGITS)))[0])
    if not np.isfinite(cost[best]):
        return None
    found = int(cells[best, 0]), int(cells[best, 1])
    planner.note_cost(here, found, ways.item(best))
    return found


def _are_among(cells: Cells, others: Cells, shape: tuple[int, ...]) -> Bools:
    """Return for each cell of a grid of this shape whether `others` contains it."""
    marked = np.zeros(shape, np.bool_)
    marked[others[:, 1], others[:, 0]] = True
    among: Bools = marked[cells[:, 1], cells[:, 0]]
    return among


@kernel
def _trace_back(
    part: Grid,
    flat: Int32s,
    steps: tuple[int, int, int, int],
    rows: Int32Rows,
    start: Int64s,
    found: BoolRows,
) -> None:
    """Mark the cells from which a beam reaches an unknown neighbor of the middle cell (`_Arrivals`).

    Each beam is followed backwards, if its last step comes from a free cell.
    """
    cells, marked = part.reshape(-1), found.reshape(-1)
    for side in steps:
        goal = len(cells) // 2 + side
        if cells[goal] != UNKNOWN:
            continue
        for group in range(4):
            if cells[goal - steps[group]] != FREE:
                continue
            for row in range(start[group], start[group + 1]):
                here = goal - flat[rows[row, 0]]
                if cells[here] != FREE or marked[here]:
                    continue
                clear = True
                for before in range(rows[row, 0] - 2, rows[row, 1] - 1, -1):
                    if cells[here + flat[before]] != FREE:
                        clear = False
                        break
                marked[here] = clear
