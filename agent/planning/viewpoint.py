"""Viewpoints: cells from which a scan observes the unknown cells beside a goal, with a short way on through the tour.

A robot need not drive into a nook to observe it. The directions of beams are known, so the cells from which a beam
reaches the nook over known free cells are known as well. One scan from any of these viewpoints suffices.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from agent.planning.path_planner import PathPlanner
from protocol.arrays import BoolRows, Bools, Cells, Int32s
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
    x0, y0 = max(0, goal[0] - int(reach) - 1), max(0, goal[1] - int(reach) - 1)
    x1, y1 = goal[0] + int(reach) + 2, goal[1] + int(reach) + 2
    part = np.pad(grid[y0:y1, x0:x1], 1, constant_values=_OUTSIDE)
    x0, y0 = x0 - 1, y0 - 1
    found = np.zeros(part.shape, np.bool_)
    found[goal[1] - y0, goal[0] - x0] = True
    flat = around.flat(part.shape[1])
    _trace_back(part, goal[0] - x0, goal[1] - y0, around.cells, flat, around.start, reach, found)
    y, x = np.nonzero(found)
    return np.stack([x + x0, y + y0], axis=1).astype(np.int32)


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
        missed = np.ones(len(cost), np.bool_) if seen_from is None else ~_are_among(cells, seen_from)
        if missed.any():
            cost[missed] += planner.costs_to(int(goal[0]), int(goal[1]), places[missed])
            places[missed] = goal
        if (places == goal).all():
            break
    best = int(np.lexsort((ways, np.round(cost, _DIGITS)))[0])
    return (int(cells[best, 0]), int(cells[best, 1])) if np.isfinite(cost[best]) else None


def _are_among(cells: Cells, others: Cells) -> Bools:
    """Return for each cell whether `others` contains it."""
    width = 1 + max(int(cells[:, 0].max()), int(others[:, 0].max()))
    return np.isin(cells @ (1, width), others @ (1, width))


@kernel
def _trace_back(
    part: Grid, x: int, y: int, beam_cells: Cells, flat: Int32s, start: Int32s, reach: float, found: BoolRows
) -> None:
    """Mark the cells from which a beam reaches an unknown neighbor of (x, y), by following each beam backwards.

    `part` has a rim of `_OUTSIDE`; `flat` has the offsets `beam_cells` as index differences on it.
    """
    stride = part.shape[1]
    cells, marked = part.reshape(-1), found.reshape(-1)
    ends = np.empty(len(start) - 1, np.int64)
    for beam in range(len(ends)):
        ends[beam] = start[beam]
        for at in range(start[beam], start[beam + 1]):
            dx, dy = beam_cells[at, 0], beam_cells[at, 1]
            if dx * dx + dy * dy > reach * reach:
                break
            ends[beam] = at + 1
    goal = y * stride + x
    for side in (goal + 1, goal + stride, goal - 1, goal - stride):
        if cells[side] != UNKNOWN:
            continue
        for beam in range(len(ends)):
            for at in range(start[beam], ends[beam]):
                here = side - flat[at]
                if cells[here] == _OUTSIDE:
                    break
                if cells[here] != FREE or marked[here]:
                    continue
                clear = True
                for before in range(at - 1, start[beam] - 1, -1):
                    if cells[here + flat[before]] != FREE:
                        clear = False
                        break
                marked[here] = clear
