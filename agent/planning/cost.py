"""Cost of reaching cells: exact shortest ways on the planning grid (thesis, section 4.4.1, Algorithm 7).

A way is 8-connected over free cells, 1 to a 4-neighbour and sqrt 2 to a diagonal one; a diagonal step needs
both cells beside it free. Value iteration would give the same; here cells are settled in buckets of width 1.
No step is shorter than that, so cells of one bucket cannot improve each other and need no order among them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FREE, Grid
from protocol.kernels import kernel

Field = NDArray[np.float64]

DIAGONAL = math.sqrt(2.0)


def costs(grid: Grid, x: int, y: int) -> Field:
    """Length of the shortest way from cell (x, y) to every cell.

    Returns
    -------
    float64 array, shape (h, w)
        In cells; infinite where no way leads.
    """
    field = np.full(grid.shape, np.inf)
    _spread(grid, x, y, field)
    return field


def way(grid: Grid, field: Field, x: int, y: int) -> NDArray[np.int32]:
    """Cells of a shortest way from where `field` is 0 to (x, y), which it reaches, in the order of driving.

    Steepest descent; of equal neighbours the first counts, straight ones before diagonal ones.

    Returns
    -------
    int32 array, shape (n, 2)
        Cells (x, y) without the start; empty if (x, y) is the start.
    """
    out = np.empty((grid.size, 2), np.int32)
    length = _descend(grid, field, x, y, out)
    return out[:length][::-1].copy()


_NEIGHBOURS = np.array([(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)], np.int64)


@kernel("void(uint8[:,::1], int64, int64, float64[:,::1])")
def _spread(grid: Grid, x: int, y: int, field: Field) -> None:
    height, width = grid.shape
    # Buckets in a ring: what is settled now, and what lies up to sqrt 2 further.
    buckets = np.empty((3, 1024), np.int32)
    fill = np.zeros(3, np.int64)
    field[y, x] = 0.0
    buckets[0, 0] = y * width + x
    fill[0] = 1
    level = 0
    empty = 0
    while empty < 3:
        ring = level % 3
        empty = empty + 1 if fill[ring] == 0 else 0
        for at in range(fill[ring]):
            cell = buckets[ring, at]
            cy = cell // width
            cx = cell - cy * width
            base = field[cy, cx]
            if int(base) != level:
                continue  # it was reached on a shorter way since it was put here
            for number in range(8):
                dx = _NEIGHBOURS[number, 0]
                dy = _NEIGHBOURS[number, 1]
                nx = cx + dx
                ny = cy + dy
                if nx < 0 or ny < 0 or nx >= width or ny >= height or grid[ny, nx] != FREE:
                    continue
                length = base + 1.0
                if number >= 4:
                    if grid[cy, nx] != FREE or grid[ny, cx] != FREE:
                        continue
                    length = base + DIAGONAL
                if length < field[ny, nx]:
                    field[ny, nx] = length
                    to = int(length) % 3
                    if fill[to] == buckets.shape[1]:
                        larger = np.empty((3, 2 * fill[to]), np.int32)
                        larger[:, : fill[to]] = buckets
                        buckets = larger
                    buckets[to, fill[to]] = ny * width + nx
                    fill[to] += 1
        fill[ring] = 0
        level += 1


@kernel("int64(uint8[:,::1], float64[:,::1], int64, int64, int32[:,::1])")
def _descend(grid: Grid, field: Field, x: int, y: int, out: NDArray[np.int32]) -> int:
    height, width = grid.shape
    length = 0
    while field[y, x] > 0.0:
        out[length, 0] = x
        out[length, 1] = y
        length += 1
        best = np.inf
        best_x = x
        best_y = y
        for number in range(8):
            nx = x + _NEIGHBOURS[number, 0]
            ny = y + _NEIGHBOURS[number, 1]
            if nx < 0 or ny < 0 or nx >= width or ny >= height:
                continue
            step = 1.0
            if number >= 4:
                # The start may be a cell that is not free on this grid, but nothing else on a way is.
                if grid[y, nx] != FREE or grid[ny, x] != FREE:
                    continue
                step = DIAGONAL
            if field[ny, nx] + step < best:
                best = field[ny, nx] + step
                best_x = nx
                best_y = ny
        x = best_x
        y = best_y
    return length
