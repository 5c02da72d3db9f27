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


def viewpoint_cells(grid: Grid, goal: tuple[int, int], around: RayTable, reach: float) -> Cells:
    """Find all cells from which a beam reaches an unknown 4-neighbor of a goal over free cells, row by row.

    `goal` is a frontier cell of the planning grid, itself among the result; `around` has the beams of the scanner,
    which count up to a length of `reach` cells.
    """
    x0, y0 = max(0, goal[0] - int(reach) - 1), max(0, goal[1] - int(reach) - 1)
    x1, y1 = goal[0] + int(reach) + 2, goal[1] + int(reach) + 2
    part = np.ascontiguousarray(grid[y0:y1, x0:x1])
    found = np.zeros(part.shape, np.bool_)
    found[goal[1] - y0, goal[0] - x0] = True
    _trace_back(part, goal[0] - x0, goal[1] - y0, around.cells, around.start, reach, found)
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
    part: Grid, x: int, y: int, beam_cells: Cells, start: Int32s, reach: float, found: BoolRows
) -> None:
    """Mark the cells from which a beam reaches an unknown neighbor of (x, y), by following each beam backwards."""
    height, width = part.shape
    for side_x, side_y in ((x + 1, y), (x, y + 1), (x - 1, y), (x, y - 1)):
        if side_x < 0 or side_y < 0 or side_x >= width or side_y >= height:
            continue
        if part[side_y, side_x] != UNKNOWN:
            continue
        for beam in range(len(start) - 1):
            for at in range(start[beam], start[beam + 1]):
                dx, dy = beam_cells[at, 0], beam_cells[at, 1]
                from_x, from_y = side_x - dx, side_y - dy
                if dx * dx + dy * dy > reach * reach or from_x < 0 or from_y < 0:
                    break
                if from_x >= width or from_y >= height:
                    break
                if part[from_y, from_x] != FREE or found[from_y, from_x]:
                    continue
                clear = True
                for before in range(at - 1, start[beam] - 1, -1):
                    if part[from_y + beam_cells[before, 1], from_x + beam_cells[before, 0]] != FREE:
                        clear = False
                        break
                found[from_y, from_x] = clear
