"""Cost of reaching cells: exact shortest ways on the planning grid (thesis, section 4.4.1, Algorithm 7).

A way is 8-connected over free cells, 1 to a 4-neighbour and sqrt 2 to a diagonal one; a diagonal step needs
both cells beside it free. Value iteration would give the same. Here cells are settled in buckets of width 1:
no step is shorter, so cells of one bucket cannot improve each other and need no order among them.

Two things make it fast. Among the equally long ways to a cell one is enough, the one that goes diagonally
first; so a cell passes on only in the direction in which it was reached, and sideways where an obstacle has
just ended (canonical ordering). And lengths are whole numbers, 2^42 to a cell: sums of them do not depend on
their order, so every exact method gives the same bits.
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
ONE = 1 << SHIFT
UNIT = 1.0 / ONE
ROOT = round(DIAGONAL * ONE)
FAR = 1 << 62
_STEPS = np.array([(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)], np.int64)
"""Neighbours (dx, dy). Step 4 + i is the diagonal between steps i and i + 1."""


class Floor:
    """Where a robot may drive, laid out for the search: flat, with a barred rim.

    Parameters
    ----------
    grid : uint8 array, shape (h, w)
        Free cells can be entered, all others not.

    Attributes
    ----------
    free : bool array, shape ((h + 2) * stride,)
        Row by row, the rim included.
    stride : int
        From a cell to the one below: w + 2.
    """

    def __init__(self, grid: Grid) -> None:
        self.height: int = grid.shape[0]
        self.width: int = grid.shape[1]
        self.stride: int = self.width + 2
        self.free: NDArray[np.bool_] = _laid_out(grid)

    def at(self, x: int, y: int) -> int:
        """Where cell (x, y) lies in `free`."""
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
    """Memory that all searches on floors of one size share.

    A length a cell, how it was reached, and a list of the cells that were. Fresh pages of memory take nearly as
    long as a search, so each tidies up behind itself (`tidy`), and only where it has been: the next finds all
    lengths `FAR`. Kernels hold the interpreter's lock, so no two are ever at work in here.
    """
    return np.full(cells, FAR, np.int64), np.zeros(cells, np.uint8), np.empty(cells, np.int32)


def way_between(floor: Floor, start: tuple[int, int], end: tuple[int, int]) -> NDArray[np.int32] | None:
    """Cells of a shortest way between two cells, by a search that ends there; None where none leads.

    The same way as `way` finds in a whole field, at the price of the cells that are no farther than its end.
    """
    cells: NDArray[np.int32]
    found, cells = _lead(
        floor.free, floor.stride, floor.at(*start), floor.at(*end), *workspace(len(floor.free))
    )
    return cells if found else None


def costs(grid: Grid, x: int, y: int) -> Field:
    """Length of the shortest way from cell (x, y) to every cell.

    Returns
    -------
    float64 array, shape (h, w)
        In cells; infinite where no way leads.
    """
    return costs_on(Floor(grid), x, y)


def costs_on(floor: Floor, x: int, y: int) -> Field:
    """As `costs`, on a floor laid out before."""
    field = np.empty((floor.height, floor.width))
    _spread(floor.free, x, y, *workspace(len(floor.free)), field)
    return field


def costs_to(floor: Floor, x: int, y: int, cells: NDArray[np.int32]) -> NDArray[np.float64]:
    """Length of the shortest way from cell (x, y) to each of some cells, by a search that ends with the last.

    For cells that are near each other, as many as there may be: those that are spread all over the floor are found
    sooner by `agent.planning.jump_point_search`.

    Parameters
    ----------
    cells : int32 array, shape (n, 2)
        Cells (x, y).

    Returns
    -------
    float64 array, shape (n,)
        As `costs` has it there.
    """
    found = np.empty(len(cells))
    _spread_to(floor.free, floor.stride, floor.at(x, y), cells, *workspace(len(floor.free)), found)
    return found


def nearest_first(
    floor: Floor, grid: Grid, x: int, y: int, taken: NDArray[np.int32], ranges: ArrayLike
) -> tuple[Field, tuple[int, int] | None]:
    """Find the frontier cell nearest to (x, y) which lies out of range of every `taken` cell.

    Where there is none such, the nearest of all counts. The search ends with the bucket in which the cell
    lies; of equally near ones the first counts, row by row.

    Parameters
    ----------
    floor : Floor
        Where the robot may drive.
    grid : uint8 array, shape (h, w)
        What is known: a frontier cell is a free one with an unknown 4-neighbour.
    taken : int32 array, shape (n, 2)
        Cells (x, y).
    ranges : float, or one for each of taken
        How far around each nothing is taken up, in cells.

    Returns
    -------
    field : float64 array, shape (h, w)
        As `costs` for all cells that are no farther than the one found; infinite or too large beyond.
    cell : (x, y), optional
        None if no frontier cell can be reached.
    """
    field = np.empty(grid.shape)
    work = workspace(len(floor.free))
    around = np.broadcast_to(np.asarray(ranges, np.float64), len(taken)).copy()
    cell = _spread_to_frontier(floor.free, grid, x, y, taken, around, *work, field)
    return field, None if cell < 0 else (cell % grid.shape[1], cell // grid.shape[1])


def way(grid: Grid, field: Field, x: int, y: int) -> NDArray[np.int32]:
    """Cells of a shortest way from where `field` is 0 to (x, y), which it reaches, in the order of driving.

    Steepest descent; of equal neighbours the first counts, straight ones before diagonal ones.

    Returns
    -------
    int32 array, shape (n, 2)
        Cells (x, y) without the start; empty if (x, y) is the start.
    """
    return weighted_way(grid, _NO_WEIGHTS, field, x, y)


def weighted_way(grid: Grid, weights: NDArray[np.float64], field: Field, x: int, y: int) -> NDArray[np.int32]:
    """As `way`, on a field of `agent.planning.occupancy.weighted_costs`; `weights` has shape (h, w)."""
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
    """Put the start into the first of four empty buckets.

    `fill` says how many cells are in each, and behind that how many the search has touched in all.
    """
    buckets = np.empty((4, 1024), np.int32)
    length[start], came[start], buckets[0, 0], touched[0] = 0, 0, start, start
    fill[:] = 0
    fill[0] = fill[4] = 1
    return buckets


@kernel("void(int64[::1], uint8[::1], int32[::1], int64[::1])")
def tidy(length: _Lengths, came: NDArray[np.uint8], touched: NDArray[np.int32], fill: _Fill) -> None:
    """Leave the workspace as it was found."""
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
    """Settle the cells of one bucket and put their neighbours into the next two; the bucket is left filled.

    `came` has the step by which each cell was reached, 8 once it is settled. Returns the buckets, larger if
    they had to grow.
    """
    ring = level & 3
    for ahead in range(1, 3):
        # A cell passes on to eight others at most.
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
            continue  # it comes twice, or was reached on a shorter way
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
    """How far on in a flat floor each step leads, for other kernels."""
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
    """Cells (x, y) of the way to a cell that a search has settled, in the order of driving; for other kernels.

    As `_descend`, in lengths instead of a field, with the same sums: the choice among ways is the same.
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
                # The start may be a cell that is not free on this grid, but nothing else on a way is.
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
