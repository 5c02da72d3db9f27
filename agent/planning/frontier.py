"""The floor that a robot may enter, and the frontier: reachable free cells with an unknown 4-neighbor (Eq. 4.2)."""

from __future__ import annotations

import numpy as np

from protocol.arrays import BoolRows, Bools, Cells, Int32Rows
from protocol.grid import FREE, UNKNOWN, Grid, ReadOnlyGrid
from protocol.kernels import kernel


class Floor:
    """The cells that a robot may enter, the free cells of a grid, as a flat array with a blocked rim."""

    def __init__(self, grid: Grid) -> None:
        self.height: int = grid.shape[0]
        self.width: int = grid.shape[1]
        self.stride: int = self.width + 2
        """Index difference of a cell and the one below."""
        self.free: Bools = _laid_out(grid)
        """Whether each cell is free, row by row, rim included: shape ((h + 2) * stride,)."""

    def at(self, x: int, y: int) -> int:
        """Return the index of cell (x, y) in `free`."""
        return (y + 1) * self.stride + x + 1


def frontier_cells(grid: Grid, reached: BoolRows) -> Cells:
    """Return all frontier cells among the `reached` ones, shape (h, w), row by row."""
    unknown = np.pad(grid == UNKNOWN, 1)
    beside = unknown[1:-1, 2:] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[:-2, 1:-1]
    y, x = np.nonzero(reached & (grid == FREE) & beside)
    return np.column_stack([x, y]).astype(np.int32)


class Regions:
    """The frontiers of the regions of one grid and its floor, each collected on first use."""

    def __init__(self) -> None:
        self._known: list[tuple[Int32Rows, Cells]] = []
        """The runs of rows of each region, and its frontier."""

    def frontier(self, floor: Floor, grid: Grid, x: int, y: int) -> Cells:
        """Return all frontier cells of `grid` that are reachable from cell (x, y), row by row; not to be modified.

        A diagonal step needs both cells beside it free, so the 4-connected cells of the floor are reachable. A flood
        fill takes a fraction of the time of a cost field.
        """
        at = floor.at(x, y)
        for runs, cells in self._known:
            if ((runs[:, 0] <= at) & (at <= runs[:, 1])).any():
                return cells
        runs = _flood(floor.free, floor.stride, at)
        cells = _collect(grid, floor.stride, runs, at)
        if floor.free[at]:  # else the runs may join regions
            self._known.append((runs, cells))
        return cells


@kernel
def is_frontier(grid: Grid, x: int, y: int) -> bool:
    """Return whether cell (x, y) is free and has an unknown 4-neighbor."""
    height, width = grid.shape
    return grid[y, x] == FREE and (
        (x + 1 < width and grid[y, x + 1] == UNKNOWN)
        or (y + 1 < height and grid[y + 1, x] == UNKNOWN)
        or (x > 0 and grid[y, x - 1] == UNKNOWN)
        or (y > 0 and grid[y - 1, x] == UNKNOWN)
    )


@kernel
def are_frontier(grid: Grid, cells: Cells) -> Bools:
    """Return for each cell whether it is a frontier cell."""
    are = np.empty(len(cells), np.bool_)
    for number in range(len(cells)):
        are[number] = is_frontier(grid, cells[number, 0], cells[number, 1])
    return are


@kernel
def is_enclosed(free: Bools, cell: int, stride: int) -> bool:
    """Return whether all 4-neighbors of a cell are free on a flat floor, so that it is no frontier cell."""
    left, right, above, below = cell - 1, cell + 1, cell - stride, cell + stride
    return bool(
        free[np.uint64(left)] and free[np.uint64(right)] and free[np.uint64(above)] and free[np.uint64(below)]
    )


@kernel
def _laid_out(grid: ReadOnlyGrid) -> Bools:
    height, width = grid.shape
    free = np.zeros((height + 2) * (width + 2), np.bool_)
    for y in range(height):
        begin = (y + 1) * (width + 2) + 1
        row, cells = free[begin : begin + width], grid[y]
        for x in range(width):
            row[x] = cells[x] == FREE
    return free


@kernel
def _flood(free: Bools, stride: int, start: int) -> Int32Rows:
    """Fill the 4-connected cells around a cell, in runs of rows; return the first and last cell of each run."""
    reached = np.zeros(len(free), np.bool_)
    waiting = np.empty(1024, np.int32)
    runs = np.empty((1024, 2), np.int32)
    filled = 0
    waiting[0], count = start, 1
    while count:
        count -= 1
        first = last = waiting[count]
        if reached[first]:
            continue
        while free[first - 1]:
            first -= 1
        while free[last + 1]:
            last += 1
        reached[first : last + 1] = True
        if filled == len(runs):
            more_runs = np.empty((2 * filled, 2), np.int32)
            more_runs[:filled] = runs
            runs = more_runs
        runs[filled, 0], runs[filled, 1] = first, last
        filled += 1
        if count + 2 * (last - first + 1) > len(waiting):
            longer = np.empty(2 * (count + 2 * (last - first + 1)), np.int32)
            longer[:count] = waiting[:count]
            waiting = longer
        for side in (-stride, stride):
            within = False
            for cell in range(first + side, last + side + 1):
                if not within and free[cell] and not reached[cell]:
                    waiting[count] = cell
                    count += 1
                within = free[cell]
    return runs[:filled].copy()


@kernel
def _collect(grid: Grid, stride: int, runs: Int32Rows, start: int) -> Cells:
    """Return the frontier cells of the runs around `start`, row by row.

    All cells of a run are free, except perhaps `start`. So inside other runs only cells above and below may be unknown.
    """
    height = grid.shape[0]
    found = np.empty((runs[:, 1] - runs[:, 0] + 1).sum(), np.int32)
    count = 0
    for index in range(len(runs)):
        first, last = runs[index]
        y = first // stride - 1
        begin = (y + 1) * stride + 1
        above, below = grid[max(y - 1, 0)], grid[min(y + 1, height - 1)]
        has_start = first <= start <= last
        for cell in range(first, last + 1):
            x = np.uint64(cell - begin)
            at_end = cell == first or cell == last  # noqa: PLR1714  faster than to look it up in a tuple
            is_candidate = above[x] == UNKNOWN or below[x] == UNKNOWN or at_end or has_start
            if is_candidate and is_frontier(grid, cell - begin, y):
                found[count] = cell
                count += 1
    # Few of the cells are frontier cells, so sorting them is faster than sorting the runs.
    ordered = np.sort(found[:count])
    out = np.empty((count, 2), np.int32)
    for index in range(count):
        out[index, 0] = ordered[index] % stride - 1
        out[index, 1] = ordered[index] // stride - 1
    return out
