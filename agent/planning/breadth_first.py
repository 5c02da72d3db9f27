"""Breadth-first search for the next frontier cell, exactly as in Al-khawaldah and Nuechter 2014, Algorithm 1.

A step to any of the eight neighbors has length 1; a diagonal step needs both cells beside it free. A frontier cell is
free and has an unknown 8-neighbor (step 2 of the algorithm). The search ends with the first frontier cell out of range
of all teammates' targets (steps 4 to 6); without one it takes the first frontier cell (step 7).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from agent.planning.cost_field import STEPS
from protocol.arrays import Cells, Floats
from protocol.grid import FREE, UNKNOWN, Cell, Grid
from protocol.kernels import kernel


def first_by_hops(
    floor: Grid, grid: Grid, start: Cell, taken: Cells, ranges: ArrayLike
) -> tuple[Cell, Cells] | None:
    """Find the first frontier cell of a breadth-first search from `start`, and the way to it.

    `floor` has the cells that the robot may enter, its own cell included. `taken` are the targets of teammates; each
    excludes frontier cells within its entry of `ranges` (cells; scalar or shape (n,)).

    Returns the cell (x, y) and a way with the fewest steps, without the start; None if no frontier cell is reachable.
    """
    around = np.full(len(taken), ranges, np.float64)
    way = np.empty((grid.size, 2), np.int32)
    length = _search(floor, grid, *start, taken, around, way)
    if length < 0:
        return None
    cells = way[:length][::-1].copy()
    return (start if not length else (int(cells[-1, 0]), int(cells[-1, 1]))), cells


@kernel
def is_wide_frontier(grid: Grid, x: int, y: int) -> bool:
    """Return whether cell (x, y) is free and has an unknown 8-neighbor.

    Cells behind the corner of two occupied cells do not count: they are never visible.
    """
    height, width = grid.shape
    if grid[y, x] != FREE:
        return False
    for number in range(8):
        nx, ny = x + STEPS[number, 0], y + STEPS[number, 1]
        if not (0 <= nx < width and 0 <= ny < height) or grid[ny, nx] != UNKNOWN:
            continue
        if number < 4 or grid[y, nx] == FREE or grid[ny, x] == FREE:
            return True
    return False


@kernel
def _search(floor: Grid, grid: Grid, x: int, y: int, taken: Cells, ranges: Floats, way: Cells) -> int:
    """Write the way to the found cell, backwards, and return its length; -1 if no cell is found."""
    height, width = grid.shape
    came = np.full((height, width), -1, np.int8)
    queue = np.empty((height * width, 2), np.int32)
    came[y, x] = 8
    queue[0, 0], queue[0, 1] = x, y
    head, tail = 0, 1
    first = found = -1
    while head < tail and found < 0:
        cx, cy = queue[head]
        if is_wide_frontier(grid, cx, cy):
            first = head if first < 0 else first
            clear = True
            for other in range(len(taken)):
                dx, dy = cx - taken[other, 0], cy - taken[other, 1]
                clear = clear and dx * dx + dy * dy > ranges[other] * ranges[other]
            if clear:
                found = head
        head += 1
        for number in range(8):
            nx, ny = cx + STEPS[number, 0], cy + STEPS[number, 1]
            if not (0 <= nx < width and 0 <= ny < height) or came[ny, nx] >= 0 or floor[ny, nx] != FREE:
                continue
            if number >= 4 and (floor[cy, nx] != FREE or floor[ny, cx] != FREE):
                continue
            came[ny, nx] = number
            queue[tail, 0], queue[tail, 1] = nx, ny
            tail += 1
    found = first if found < 0 else found
    if found < 0:
        return -1
    cx, cy = queue[found]
    length = 0
    while came[cy, cx] != 8:
        way[length, 0], way[length, 1] = cx, cy
        length += 1
        number = came[cy, cx]
        cx, cy = cx - STEPS[number, 0], cy - STEPS[number, 1]
    return length
