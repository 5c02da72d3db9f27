"""The frontier: reachable free cells with an unknown 4-neighbor (thesis, Eq. 4.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FREE, UNKNOWN, Grid
from protocol.kernels import kernel


def frontier_cells(grid: Grid, reached: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return all reachable frontier cells, row by row.

    Parameters
    ----------
    grid : uint8 array, shape (h, w)
        The planning grid.
    reached : bool array, shape (h, w)
        The reachable cells (`agent.planning.reachability.reachable`).

    Returns
    -------
    int32 array, shape (n, 2)
        Cells (x, y).
    """
    out = np.empty((grid.size, 2), np.int32)
    return out[: _collect(grid, reached, out)].copy()


def is_frontier(grid: Grid, x: int, y: int) -> bool:
    """Return whether cell (x, y) is free and has an unknown 4-neighbor."""
    return bool(frontier_at(grid, x, y))


@kernel("boolean(uint8[:,::1], int64, int64)")
def frontier_at(grid: Grid, x: int, y: int) -> bool:
    """`is_frontier` for kernels."""
    height, width = grid.shape
    return grid[y, x] == FREE and (
        (x + 1 < width and grid[y, x + 1] == UNKNOWN)
        or (y + 1 < height and grid[y + 1, x] == UNKNOWN)
        or (x > 0 and grid[y, x - 1] == UNKNOWN)
        or (y > 0 and grid[y - 1, x] == UNKNOWN)
    )


@kernel("boolean(boolean[::1], int64, int64)")
def is_enclosed(free: NDArray[np.bool_], cell: int, stride: int) -> bool:
    """Return whether all 4-neighbors of a cell are free on a flat floor, so that it is no frontier cell."""
    return bool(free[cell - 1] and free[cell + 1] and free[cell - stride] and free[cell + stride])


@kernel("int64(uint8[:,::1], boolean[:,:], int32[:,::1])")
def _collect(grid: Grid, reached: NDArray[np.bool_], out: NDArray[np.int32]) -> int:
    height, width = grid.shape
    count = 0
    for y in range(height):
        for x in range(width):
            if reached[y, x] and frontier_at(grid, x, y):
                out[count, 0] = x
                out[count, 1] = y
                count += 1
    return count
