"""Viewpoints: cells from which a scan observes the unknown cells beside a goal, with a short way on through the tour.

A robot need not drive into a nook to observe it. The directions of beams are known, so the cells from which a beam
reaches the nook over known free cells are known as well. One scan from any of these viewpoints suffices.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from functools import lru_cache

import numpy as np

from agent.planning.path_planner import PathPlanner
from protocol.arrays import NO_CELLS, Bools, Cells, Floats, Int32Rows, Int32s, Int64s
from protocol.grid import FREE, UNKNOWN, Cell, Grid, RayTable
from protocol.kernels import kernel

_BEGUN = 1 / 2
"""Cells by which a way may exceed a whole number of steps without another step: robots round lengths."""

_PARTS = 1e6
"""Parts of a cell to which lengths are rounded before they are compared."""

_OUTSIDE = 255
"""State of cells outside the part of the grid that a beam may cross."""


def viewpoint_cells(
    grid: Grid, goal: Cell, around: RayTable, reach: float, among: Cells | None = None
) -> Cells:
    """Find all cells from which a beam reaches an unknown 4-neighbor of a goal over free cells, row by row.

    `goal` is a frontier cell of the planning grid, itself among the result; `around` has the beams of the scanner,
    which count up to a length of `reach` cells. With `among`, find only those of these cells, int32 of shape (n, 2).
    """
    arrivals = _arrivals(around, min(reach, math.hypot(*grid.shape)))
    candidates = NO_CELLS if among is None else among
    found: Cells = _trace_back(grid, goal, arrivals, among is None, candidates)
    return found


def tour_viewpoints(
    grid: Grid, goals: Cells, are_small: Bools, around: RayTable, reach: float
) -> Iterator[Cells | None]:
    """Yield the viewpoints of each goal of a tour for `best_viewpoint`; None for goals that are not small.

    Of later goals, yield only the viewpoints that the first goal has as well. The first goal must be small.
    """
    first: Cells | None = None
    for (x, y), is_small in zip(goals.tolist(), are_small.tolist(), strict=True):
        cells = viewpoint_cells(grid, (x, y), around, reach, first) if is_small else None
        first = cells if first is None else first
        yield cells


_Arrivals = tuple[int, Int32s, tuple[int, int, int, int], Int32Rows, Int64s]
"""Where the beams of a scanner may end, by their last step, on a square part of a grid with the goal in the middle.

The part is so large that beams to a neighbor of the goal do not begin outside. The tuple has

- its side in cells,
- the cells of all beams (`RayTable.cells`), as index differences on the part,
- the four last steps, as index differences,
- the place of each arrival among the cells, and that of the first cell of its beam, grouped by last step,
- the first row of each group, and the number of rows.
"""


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
    return side, flat, steps, np.concatenate(groups), np.cumsum([0, *map(len, groups)])


def best_viewpoint(
    planner: PathPlanner, here: Cell, views: Iterable[Cells | None], goals: Cells, step: float
) -> Cell | None:
    """Choose the viewpoint of the first goal of a tour with the shortest way through it and on through the tour.

    Goals that are visible from this viewpoint as well need no further way. The robot, in cell `here`, scans at the end
    of each step of `step` cells, so the way to the viewpoint counts in whole steps. `views` has the viewpoints of each
    goal, row by row, None for a goal that the robot must drive to. The first goal has viewpoints; those of later goals
    are among them.

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
        x, y = goal.tolist()
        if seen_from is None or not len(seen_from):
            cost += planner.costs_to(x, y, places)
            break
        missed = ~_are_selected(cells, seen_from)
        if missed.any():
            cost[missed] += planner.costs_to(x, y, places[missed])
            places[missed] = goal
        if (places == goal).all():
            break
    best = _cheapest(cost, ways)
    if not math.isfinite(cost[best]):
        return None
    found = int(cells[best, 0]), int(cells[best, 1])
    planner.note_cost(here, found, ways.item(best))
    return found


@kernel
def _cheapest(cost: Floats, ways: Floats) -> int:
    """Return the index of the least cost, rounded (`_PARTS`); of equal ones that of the shortest way, the first one."""
    best, least = 0, np.rint(cost[0] * _PARTS)
    for at in range(1, len(cost)):
        rounded = np.rint(cost[at] * _PARTS)
        if rounded < least or (rounded == least and ways[at] < ways[best]):
            best, least = at, rounded
    return best


@kernel
def _are_selected(cells: Cells, selection: Cells) -> Bools:
    """Return for each cell whether `selection`, some of these cells in the same order, contains it."""
    selected = np.zeros(len(cells), np.bool_)
    count = 0
    for at in range(len(cells)):
        in_column = count < len(selection) and cells[at, 0] == selection[count, 0]
        if in_column and cells[at, 1] == selection[count, 1]:
            selected[at] = True
            count += 1
    return selected


@kernel
def _trace_back(grid: Grid, center: Cell, arrivals: _Arrivals, tests_all: bool, candidates: Cells) -> Cells:
    """Return the cells from which a beam reaches an unknown neighbor of the goal `center`, row by row.

    Each beam is followed backwards, if its last step comes from a free cell. Unless `tests_all`, only the candidates
    are tested.
    """
    side, flat, steps, rows, start = arrivals
    height, width = grid.shape
    left, top = center[0] - side // 2, center[1] - side // 2
    cells = np.full(side * side, _OUTSIDE, np.uint8)
    for y in range(max(0, top), min(height, top + side)):
        first, end = max(0, left), min(width, left + side)
        at = (y - top) * side - left
        cells[at + first : at + end] = grid[y, first:end]
    middle = len(cells) // 2
    open_cells = np.zeros(len(cells), np.bool_)  # free cells that are to be tested, and not found yet
    for at in range(len(cells) if tests_all else 0):
        open_cells[at] = cells[at] == FREE
    for each in range(len(candidates)):
        x, y = candidates[each, 0] - left, candidates[each, 1] - top
        if 0 <= x < side and 0 <= y < side:
            open_cells[y * side + x] = cells[y * side + x] == FREE
    if not open_cells.any():
        return np.empty((0, 2), np.int32)
    found = np.zeros(len(cells), np.bool_)
    found[middle] = open_cells[middle]
    for step in steps:
        goal = middle + step
        if cells[goal] != UNKNOWN:
            continue
        for group in range(4):
            if cells[goal - steps[group]] != FREE:
                continue
            # Unsigned indices cannot count from the end of an array, which saves a comparison each.
            for row in range(np.uint64(start[group]), np.uint64(start[group + 1])):
                here = goal - np.int64(flat[np.uint64(rows[row, 0])])
                if not open_cells[np.uint64(here)]:
                    continue
                clear = True
                for before in range(rows[row, 0] - 2, rows[row, 1] - 1, -1):
                    if cells[np.uint64(here + flat[np.uint64(before)])] != FREE:
                        clear = False
                        break
                if clear:
                    open_cells[np.uint64(here)], found[np.uint64(here)] = False, True
    out = np.empty((found.sum(), 2), np.int32)
    count = 0
    for at in range(len(cells)):
        if found[at]:
            out[count, 0], out[count, 1] = at % side + left, at // side + top
            count += 1
    return out
