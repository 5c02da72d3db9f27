"""Exact shortest ways on the planning grid (thesis, section 4.4.1, Algorithm 7).

A way is 8-connected over free cells. A step to a 4-neighbor has length 1, a diagonal step sqrt 2; it needs both cells
beside it free. The result equals that of value iteration. The search is Dijkstra's with buckets of width 1 (Dial 1969):
no step is shorter, so the cells of a bucket cannot improve each other, and need no order.

Two measures make it fast. Of several equally long ways to a cell one suffices, the one with its diagonal steps first.
So the search continues from a cell only in the direction of the last step, and sideways where an obstacle has just
ended (canonical ordering, Harabor and Grastien 2011). And lengths are integers, with 2^42 per cell: their sums do not
depend on the order of addition, so every exact method gives the same bits.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent.planning.frontier import frontier_at, is_enclosed
from protocol.grid import FREE, Grid
from protocol.kernels import kernel

Field = NDArray[np.float64]

DIAGONAL = math.sqrt(2.0)

SHIFT = 42
"""Bits of a length behind the binary point."""

ONE = 1 << SHIFT
ROOT = round(DIAGONAL * ONE)
"""Lengths of a straight and of a diagonal step, as integers."""

UNIT = 1.0 / ONE
"""Factor from an integer length to cells."""

FAR = 1 << 62
"""Length of a cell that the search has not reached."""

_STEPS = np.array([(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)], np.int64)
"""Neighbours (dx, dy). Step 4 + i is the diagonal between steps i and i + 1."""


class Floor:
    """The cells that a robot may enter, as a flat array with a blocked rim.

    Parameters
    ----------
    grid : uint8 array, shape (h, w)
        A robot may enter its free cells.

    Attributes
    ----------
    free : bool array, shape ((h + 2) * stride,)
        Whether each cell is free, row by row, rim included.
    stride : int
        Index difference of a cell and the one below: w + 2.
    """

    def __init__(self, grid: Grid) -> None:
        self.height: int = grid.shape[0]
        self.width: int = grid.shape[1]
        self.stride: int = self.width + 2
        self.free: NDArray[np.bool_] = _laid_out(grid)

    def at(self, x: int, y: int) -> int:
        """Return the index of cell (x, y) in `free`."""
        return (y + 1) * self.stride + x + 1


@kernel("boolean[::1](Array(uint8, 2, 'C', readonly=True))")
def _laid_out(grid: Grid) -> NDArray[np.bool_]:
    height, width = grid.shape
    free = np.zeros((height + 2) * (width + 2), np.bool_)
    for y in range(height):
        begin = (y + 1) * (width + 2) + 1
        row, cells = free[begin : begin + width], grid[y]
        for x in range(width):
            row[x] = cells[x] == FREE
    return free


@lru_cache(maxsize=1)
def workspace(cells: int) -> tuple[NDArray[np.int64], NDArray[np.uint8], NDArray[np.int32]]:
    """Return the working memory that all searches on floors of one size share.

    It has a length per cell, the step by which the search reached the cell, and a list of the reached cells. Fresh
    memory pages take nearly as long as a search, so each search resets the cells that it has reached (`tidy`): the
    next one finds all lengths `FAR`. Kernels hold the interpreter's lock, so no two searches run at the same time.
    """
    return np.full(cells, FAR, np.int64), np.zeros(cells, np.uint8), np.empty(cells, np.int32)


def way_between(floor: Floor, start: tuple[int, int], end: tuple[int, int]) -> NDArray[np.int32] | None:
    """Return the cells of a shortest way between two cells, without the start; None if there is none.

    The way equals that of `way` on a whole field, but the search ends at `end`.
    """
    cells: NDArray[np.int32]
    found, cells = _lead(
        floor.free, floor.stride, floor.at(*start), floor.at(*end), *workspace(len(floor.free))
    )
    return cells if found else None


def costs(grid: Grid, x: int, y: int) -> Field:
    """Return the length of the shortest way from cell (x, y) to every cell.

    Returns
    -------
    float64 array, shape (h, w)
        In cells; infinite without a way.
    """
    return costs_on(Floor(grid), x, y)


def costs_on(floor: Floor, x: int, y: int) -> Field:
    """Return what `costs` returns, for a given `Floor`."""
    field = np.empty((floor.height, floor.width))
    _spread(floor.free, x, y, *workspace(len(floor.free)), field)
    return field


def costs_to(floor: Floor, x: int, y: int, cells: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the length of the shortest way from cell (x, y) to each of `cells`; the search ends at the last of them.

    Suited to cells near each other; for cells all over the floor `agent.planning.jump_point_search` is faster.

    Parameters
    ----------
    cells : int32 array, shape (n, 2)
        Cells (x, y).

    Returns
    -------
    float64 array, shape (n,)
        The values of `costs` at these cells.
    """
    found = np.empty(len(cells))
    _spread_to(floor.free, floor.stride, floor.at(x, y), cells, *workspace(len(floor.free)), found)
    return found


def nearest_first(
    floor: Floor, grid: Grid, x: int, y: int, taken: NDArray[np.int32], ranges: ArrayLike
) -> tuple[Field, tuple[int, int] | None]:
    """Find the frontier cell nearest to (x, y) that is out of range of every `taken` cell.

    Without one, the nearest of all frontier cells. The search ends with the bucket of this cell. Of equally near cells
    the first counts, row by row.

    Parameters
    ----------
    floor : Floor
        The cells that the robot may enter.
    grid : uint8 array, shape (h, w)
        The planning grid; a frontier cell is free and has an unknown 4-neighbor.
    taken : int32 array, shape (n, 2)
        Targets of teammates, cells (x, y).
    ranges : float or float array, shape (n,)
        Distance in cells within which each of them excludes frontier cells.

    Returns
    -------
    field : float64 array, shape (h, w)
        The values of `costs` for cells no farther than the found one; infinite or too large beyond.
    cell : (x, y), optional
        None if no frontier cell is reachable.
    """
    field = np.empty(grid.shape)
    work = workspace(len(floor.free))
    around = np.broadcast_to(np.asarray(ranges, np.float64), len(taken)).copy()
    cell = _spread_to_frontier(floor.free, grid, x, y, taken, around, *work, field)
    return field, None if cell < 0 else (cell % grid.shape[1], cell // grid.shape[1])


def way(grid: Grid, field: Field, x: int, y: int) -> NDArray[np.int32]:
    """Return the cells of a shortest way from the origin of `field` to (x, y), in driving order, by steepest descent.

    `field` must be finite at (x, y). Of equal neighbors the first counts, straight steps before diagonal ones.

    Returns
    -------
    int32 array, shape (n, 2)
        Cells (x, y) without the start; empty if (x, y) is the start.
    """
    return weighted_way(grid, _NO_WEIGHTS, field, x, y)


def weighted_way(grid: Grid, weights: NDArray[np.float64], field: Field, x: int, y: int) -> NDArray[np.int32]:
    """Return what `way` returns, for a field and weights (shape (h, w)) of `agent.planning.occupancy`."""
    out = np.empty((grid.size, 2), np.int32)
    length = _descend(grid, weights, field, x, y, out)
    return out[:length][::-1].copy()


_NO_WEIGHTS = np.empty((0, 0))

_Lengths = NDArray[np.int64]
_Buckets = NDArray[np.int32]
_Fill = NDArray[np.int64]


@kernel(
    "int32[:,::1](int64[::1], uint8[::1], int32[::1], int64[::1], int64)",
)
def begin(
    length: _Lengths, came: NDArray[np.uint8], touched: NDArray[np.int32], fill: _Fill, start: int
) -> _Buckets:
    """Begin a search: put the start into the first of four empty buckets, and return them.

    `fill` has the number of cells in each bucket, and last the number of cells that the search has reached.
    """
    buckets = np.empty((4, 1024), np.int32)
    length[start], came[start], buckets[0, 0], touched[0] = 0, 0, start, start
    fill[:] = 0
    fill[0] = fill[4] = 1
    return buckets


@kernel("void(int64[::1], uint8[::1], int32[::1], int64[::1])")
def tidy(length: _Lengths, came: NDArray[np.uint8], touched: NDArray[np.int32], fill: _Fill) -> None:
    """Reset the reached cells of the workspace."""
    for at in range(fill[4]):
        length[touched[at]] = FAR
        came[touched[at]] = 0


@kernel(
    "int32[:,::1](boolean[::1], int64[::1], uint8[::1], int32[::1], int32[:,::1], int64[::1], int64[::1],"
    " int64, int64)"
)
def settle(
    free: NDArray[np.bool_],
    length: _Lengths,
    came: NDArray[np.uint8],
    touched: NDArray[np.int32],
    buckets: _Buckets,
    fill: _Fill,
    offset: NDArray[np.int64],
    level: int,
    start: int,
) -> _Buckets:
    """Settle the cells of one bucket, and put their neighbors into the next two; the bucket stays filled.

    `came` has the step by which each cell was reached, 8 after it is settled. Returns the buckets, enlarged if
    necessary.
    """
    ring = level & 3
    for ahead in range(1, 3):
        # A cell has at most eight successors.
        to = (level + ahead) & 3
        if fill[to] + 8 * fill[ring] > buckets.shape[1]:
            larger = np.empty((4, 2 * (fill[to] + 8 * fill[ring])), np.int32)
            larger[:, : buckets.shape[1]] = buckets
            buckets = larger
    wanted = np.empty(8, np.int64)
    for at in range(fill[ring]):
        cell = buckets[ring, at]
        base = length[cell]
        if came[cell] == 8 or base >> SHIFT != level:
            continue  # a duplicate, or reached on a shorter way since
        direction = came[cell]
        came[cell] = 8
        if cell == start:
            for number in range(8):
                wanted[number] = number
            count = 8
        elif direction < 4:
            wanted[0] = direction
            count = 1
            behind = cell - offset[direction]
            for turn in (1, 3):
                side = (direction + turn) & 3
                if not free[behind + offset[side]] and free[cell + offset[side]]:
                    wanted[count] = side
                    wanted[count + 1] = 4 + direction if turn == 1 else 4 + side
                    count += 2
        else:
            wanted[0] = direction
            wanted[1] = direction - 4
            wanted[2] = (direction - 3) & 3
            count = 3
        for index in range(count):
            number = wanted[index]
            to_cell = cell + offset[number]
            if not free[to_cell]:
                continue
            new = base + ONE
            if number >= 4:
                if not free[cell + offset[number - 4]] or not free[cell + offset[(number - 3) & 3]]:
                    continue
                new = base + ROOT
            if new < length[to_cell]:
                if length[to_cell] == FAR:
                    touched[fill[4]] = to_cell
                    fill[4] += 1
                length[to_cell] = new
                came[to_cell] = number
                to = (new >> SHIFT) & 3
                buckets[to, fill[to]] = to_cell
                fill[to] += 1
    return buckets


@kernel("int64[::1](int64)")
def offsets(stride: int) -> NDArray[np.int64]:
    """Return the index difference of each step on a flat floor."""
    offset = np.empty(8, np.int64)
    for number in range(8):
        offset[number] = _STEPS[number, 1] * stride + _STEPS[number, 0]
    return offset


@kernel("void(int64[::1], float64[:,::1])")
def _unpad(length: _Lengths, field: Field) -> None:
    height, width = field.shape
    for row in range(height):
        begin = (row + 1) * (width + 2) + 1
        source = length[begin : begin + width]
        for column in range(width):
            field[row, column] = source[column] * UNIT if source[column] != FAR else np.inf


@kernel("void(boolean[::1], int64, int64, int64[::1], uint8[::1], int32[::1], float64[:,::1])")
def _spread(
    free: NDArray[np.bool_],
    x: int,
    y: int,
    length: _Lengths,
    came: NDArray[np.uint8],
    touched: NDArray[np.int32],
    field: Field,
) -> None:
    stride = field.shape[1] + 2
    start = (y + 1) * stride + x + 1
    fill = np.empty(5, np.int64)
    buckets = begin(length, came, touched, fill, start)
    offset = offsets(stride)
    level = 0
    while fill[:4].any():
        buckets = settle(free, length, came, touched, buckets, fill, offset, level, start)
        fill[level & 3] = 0
        level += 1
    _unpad(length, field)
    tidy(length, came, touched, fill)


@kernel("void(boolean[::1], int64, int64, int32[:,::1], int64[::1], uint8[::1], int32[::1], float64[::1])")
def _spread_to(
    free: NDArray[np.bool_],
    stride: int,
    start: int,
    cells: NDArray[np.int32],
    length: _Lengths,
    came: NDArray[np.uint8],
    touched: NDArray[np.int32],
    found: NDArray[np.float64],
) -> None:
    fill = np.empty(5, np.int64)
    buckets = begin(length, came, touched, fill, start)
    offset = offsets(stride)
    level = 0
    for index in range(len(cells)):
        cell = (cells[index, 1] + 1) * stride + cells[index, 0] + 1
        while came[cell] != 8 and fill[:4].any():
            buckets = settle(free, length, came, touched, buckets, fill, offset, level, start)
            fill[level & 3] = 0
            level += 1
        found[index] = length[cell] * UNIT if length[cell] != FAR else np.inf
    tidy(length, came, touched, fill)


@kernel(
    "int64(boolean[::1], uint8[:,::1], int64, int64, int32[:,::1], float64[::1],"
    " int64[::1], uint8[::1], int32[::1], float64[:,::1])"
)
def _spread_to_frontier(
    free: NDArray[np.bool_],
    grid: Grid,
    x: int,
    y: int,
    taken: NDArray[np.int32],
    ranges: NDArray[np.float64],
    length: _Lengths,
    came: NDArray[np.uint8],
    touched: NDArray[np.int32],
    field: Field,
) -> int:
    stride = field.shape[1] + 2
    start = (y + 1) * stride + x + 1
    fill = np.empty(5, np.int64)
    buckets = begin(length, came, touched, fill, start)
    offset = offsets(stride)
    level = 0
    first = -1
    found = -1
    while fill[:4].any() and found < 0:
        buckets = settle(free, length, came, touched, buckets, fill, offset, level, start)
        nearest = -1
        for at in range(fill[level & 3]):
            cell = buckets[level & 3, at]
            if length[cell] >> SHIFT != level or is_enclosed(free, cell, stride):
                continue
            cx, cy = cell % stride - 1, cell // stride - 1
            if not frontier_at(grid, cx, cy):
                continue
            if nearest < 0 or (length[cell], cell) < (length[nearest], nearest):
                nearest = cell
            clear = True
            for other in range(len(taken)):
                dx, dy = cx - taken[other, 0], cy - taken[other, 1]
                clear = clear and dx * dx + dy * dy > ranges[other] * ranges[other]
            if clear and (found < 0 or (length[cell], cell) < (length[found], found)):
                found = cell
        if first < 0:
            first = nearest
        fill[level & 3] = 0
        level += 1
    _unpad(length, field)
    tidy(length, came, touched, fill)
    if found < 0:
        found = first
    return -1 if found < 0 else (found // stride - 1) * field.shape[1] + found % stride - 1


@kernel("int32[:,::1](boolean[::1], int64[::1], int64[::1], int64)")
def way_back(
    free: NDArray[np.bool_], length: _Lengths, offset: NDArray[np.int64], end: int
) -> NDArray[np.int32]:
    """Return the cells (x, y) of the way to a settled cell, in driving order.

    It computes the same sums as `_descend`, so it chooses the same one of several shortest ways.
    """
    stride = offset[1]
    count = (length[end] >> SHIFT) + 1  # no step is shorter than a cell
    cells = np.empty((count, 2), np.int32)
    first = count
    at = end
    while length[at] > 0:
        first -= 1
        cells[first, 0] = at % stride - 1
        cells[first, 1] = at // stride - 1
        best = np.inf
        next_one = at
        for number in range(8):
            before = at + offset[number]
            if length[before] == FAR:
                continue
            step = 1.0
            if number >= 4:
                if not free[at + offset[number - 4]] or not free[at + offset[(number - 3) & 3]]:
                    continue
                step = DIAGONAL
            if length[before] * UNIT + step < best:
                best = length[before] * UNIT + step
                next_one = before
        at = next_one
    return cells[first:].copy()


@kernel(
    "Tuple((boolean, int32[:,::1]))(boolean[::1], int64, int64, int64, int64[::1], uint8[::1], int32[::1])"
)
def _lead(
    free: NDArray[np.bool_],
    stride: int,
    start: int,
    end: int,
    length: _Lengths,
    came: NDArray[np.uint8],
    touched: NDArray[np.int32],
) -> tuple[bool, NDArray[np.int32]]:
    fill = np.empty(5, np.int64)
    buckets = begin(length, came, touched, fill, start)
    offset = offsets(stride)
    level = 0
    while fill[:4].any() and came[end] != 8:
        buckets = settle(free, length, came, touched, buckets, fill, offset, level, start)
        fill[level & 3] = 0
        level += 1
    found = length[end] != FAR
    cells = way_back(free, length, offset, end) if found else np.empty((0, 2), np.int32)
    tidy(length, came, touched, fill)
    return found, cells


@kernel("int64(uint8[:,::1], float64[:,::1], float64[:,::1], int64, int64, int32[:,::1])")
def _descend(
    grid: Grid, weights: NDArray[np.float64], field: Field, x: int, y: int, out: NDArray[np.int32]
) -> int:
    height, width = grid.shape
    length = 0
    while field[y, x] > 0.0:
        out[length, 0] = x
        out[length, 1] = y
        length += 1
        weight = weights[y, x] if weights.size else 1.0
        best = np.inf
        best_x = x
        best_y = y
        for number in range(8):
            nx = x + _STEPS[number, 0]
            ny = y + _STEPS[number, 1]
            if nx < 0 or ny < 0 or nx >= width or ny >= height:
                continue
            step = weight
            if number >= 4:
                # On a way only the start may be a cell that is not free on this grid.
                if grid[y, nx] != FREE or grid[ny, x] != FREE:
                    continue
                step = weight * DIAGONAL
            if field[ny, nx] + step < best:
                best = field[ny, nx] + step
                best_x = nx
                best_y = ny
        x = best_x
        y = best_y
    return length
