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

import numpy as np
from numpy.typing import NDArray

from agent.planning.frontier import frontier_at
from protocol.grid import FREE, Grid
from protocol.kernels import kernel

Field = NDArray[np.float64]

DIAGONAL = math.sqrt(2.0)

_SHIFT = 42
_ONE = 1 << _SHIFT
_ROOT = round(DIAGONAL * _ONE)
_FAR = 1 << 62
_STEPS = np.array([(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)], np.int64)
"""Neighbours (dx, dy). Step 4 + i is the diagonal between steps i and i + 1."""


def costs(grid: Grid, x: int, y: int) -> Field:
    """Length of the shortest way from cell (x, y) to every cell.

    Returns
    -------
    float64 array, shape (h, w)
        In cells; infinite where no way leads.
    """
    field = np.empty(grid.shape)
    _spread(grid, grid, x, y, _NOBODY, -1.0, field)
    return field


def nearest_first(
    floor: Grid, grid: Grid, x: int, y: int, taken: NDArray[np.int32], range_cells: float
) -> tuple[Field, tuple[int, int] | None]:
    """Find the frontier cell nearest to (x, y) which is farther than `range_cells` from every `taken` cell.

    Where there is none such, the nearest of all counts. The search ends with the bucket in which the cell
    lies; of equally near ones the first counts, row by row.

    Parameters
    ----------
    floor : uint8 array, shape (h, w)
        Where the robot may drive.
    grid : uint8 array, shape (h, w)
        What is known: a frontier cell is a free one with an unknown 4-neighbour.
    taken : int32 array, shape (n, 2)
        Cells (x, y).

    Returns
    -------
    field : float64 array, shape (h, w)
        As `costs` for all cells that are no farther than the one found; infinite or too large beyond.
    cell : (x, y), optional
        None if no frontier cell can be reached.
    """
    field = np.empty(grid.shape)
    cell = _spread(floor, grid, x, y, taken, range_cells, field)
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


_NOBODY = np.empty((0, 2), np.int32)
_NO_WEIGHTS = np.empty((0, 0))


@kernel("int64(uint8[:,::1], uint8[:,::1], int64, int64, int32[:,::1], float64, float64[:,::1])")
def _spread(
    floor: Grid, grid: Grid, x: int, y: int, taken: NDArray[np.int32], range_cells: float, field: Field
) -> int:
    """Settle cells from (x, y) on; a `range_cells` of 0 or more asks for a frontier cell and ends with it."""
    height, width = floor.shape
    stride = width + 2
    # A rim of cells that nobody enters saves all questions about the edge.
    free = np.zeros((height + 2) * stride, np.uint8)
    for row in range(height):
        for column in range(width):
            free[(row + 1) * stride + column + 1] = floor[row, column] == FREE
    length = np.full((height + 2) * stride, _FAR, np.int64)
    came = np.zeros((height + 2) * stride, np.uint8)
    offset = np.empty(8, np.int64)
    for number in range(8):
        offset[number] = _STEPS[number, 1] * stride + _STEPS[number, 0]
    # Buckets in a ring: what is settled now, and what lies up to sqrt 2 further. No bucket can hold more
    # than one entry for each of eight neighbours of each cell on its brim; it grows where it must.
    buckets = np.empty((3, 4096), np.int32)
    fill = np.zeros(3, np.int64)
    start = (y + 1) * stride + x + 1
    length[start] = 0
    buckets[0, 0] = start
    fill[0] = 1
    wanted = np.empty(8, np.uint8)
    level = 0
    empty = 0
    first = -1
    found = -1
    while empty < 3 and found < 0:
        ring = level % 3
        empty = empty + 1 if fill[ring] == 0 else 0
        for ring_ahead in range(1, 3):
            # Eight entries a cell at most.
            to = (level + ring_ahead) % 3
            if fill[to] + 8 * fill[ring] > buckets.shape[1]:
                larger = np.empty((3, 2 * (fill[to] + 8 * fill[ring])), np.int32)
                larger[:, : buckets.shape[1]] = buckets
                buckets = larger
        for at in range(fill[ring]):
            cell = buckets[ring, at]
            base = length[cell]
            if base >> _SHIFT != level or came[cell] & 16:
                continue  # it was reached on a shorter way, or comes twice
            direction = came[cell] & 7
            came[cell] |= 16
            count = 0
            if cell == start:
                for number in range(8):
                    wanted[number] = number
                count = 8
            elif direction < 4:
                wanted[0] = direction
                count = 1
                behind = cell - offset[direction]
                for turn in (1, 3):
                    side = (direction + turn) % 4
                    if not free[behind + offset[side]] and free[cell + offset[side]]:
                        wanted[count] = side
                        wanted[count + 1] = 4 + direction if turn == 1 else 4 + side
                        count += 2
            else:
                wanted[0] = direction
                wanted[1] = direction - 4
                wanted[2] = (direction - 3) % 4
                count = 3
            for index in range(count):
                number = wanted[index]
                to_cell = cell + offset[number]
                if not free[to_cell]:
                    continue
                if number < 4:
                    new = base + _ONE
                else:
                    if not free[cell + offset[number - 4]] or not free[cell + offset[(number - 3) % 4]]:
                        continue
                    new = base + _ROOT
                if new < length[to_cell]:
                    length[to_cell] = new
                    came[to_cell] = number
                    to = (new >> _SHIFT) % 3
                    buckets[to, fill[to]] = to_cell
                    fill[to] += 1
        if range_cells >= 0.0:
            best = -1
            nearest = -1
            for at in range(fill[ring]):
                cell = buckets[ring, at]
                if length[cell] >> _SHIFT != level:
                    continue
                cy = cell // stride - 1
                cx = cell % stride - 1
                if not frontier_at(grid, cx, cy):
                    continue
                if nearest < 0 or (length[cell], cell) < (length[nearest], nearest):
                    nearest = cell
                clear = True
                for other in range(len(taken)):
                    dx, dy = cx - taken[other, 0], cy - taken[other, 1]
                    if dx * dx + dy * dy <= range_cells * range_cells:
                        clear = False
                        break
                if clear and (best < 0 or (length[cell], cell) < (length[best], best)):
                    best = cell
            if first < 0:
                first = nearest
            found = best
        fill[ring] = 0
        level += 1
    for row in range(height):
        for column in range(width):
            whole = length[(row + 1) * stride + column + 1]
            field[row, column] = np.inf if whole == _FAR else whole / _ONE
    if found < 0:
        found = first
    return -1 if found < 0 else (found // stride - 1) * width + found % stride - 1


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
