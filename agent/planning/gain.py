"""Information gain of frontier cells: unknown cells in sensor range that nobody else is about to see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from protocol.grid import UNKNOWN, Grid
from protocol.kernels import kernel


def information_gain(
    grid: Grid, cells: NDArray[np.int32], range_cells: float, others: Sequence[tuple[int, int]]
) -> NDArray[np.int64]:
    """Count the unknown cells within range of each of `cells` and not within range of one of `others`.

    Sheng et al. 2006, as Al-khawaldah and Nuechter quote it: I of Eq. (1).

    Parameters
    ----------
    grid : uint8 array, shape (h, w)
        The planning grid.
    cells : int32 array, shape (n, 2)
        Frontier cells (x, y).
    range_cells : float
        Sensor range.
    others : sequence of (x, y)
        Where teammates are, and where they are headed.

    Returns
    -------
    int64 array, shape (n,)
    """
    reach = np.sqrt(np.maximum(range_cells**2 - np.arange(int(range_cells) + 1) ** 2, 0)).astype(np.int64)
    gain = np.zeros(len(cells), np.int64)
    _count(grid, cells, np.array(others, np.int32).reshape(-1, 2), reach, gain)
    return gain


@kernel("void(uint8[:,::1], int32[:,::1], int32[:,::1], int64[::1], int64[::1])")
def _count(
    grid: Grid,
    cells: NDArray[np.int32],
    others: NDArray[np.int32],
    reach: NDArray[np.int64],
    gain: NDArray[np.int64],
) -> None:
    """`reach[dy]` is how far a disc extends to both sides in the row dy away from its middle."""
    height, width = grid.shape
    open_cells = np.zeros((height, width), np.bool_)
    for y in range(height):
        for x in range(width):
            open_cells[y, x] = grid[y, x] == UNKNOWN
    for other in range(len(others)):
        for dy in range(1 - len(reach), len(reach)):
            y = others[other, 1] + dy
            if 0 <= y < height:
                x0 = max(0, others[other, 0] - reach[abs(dy)])
                x1 = min(width, others[other, 0] + reach[abs(dy)] + 1)
                open_cells[y, x0:x1] = False
    before = np.zeros((height, width + 1), np.int64)
    for y in range(height):
        for x in range(width):
            before[y, x + 1] = before[y, x] + open_cells[y, x]
    for at in range(len(cells)):
        for dy in range(1 - len(reach), len(reach)):
            y = cells[at, 1] + dy
            if 0 <= y < height:
                x0 = max(0, cells[at, 0] - reach[abs(dy)])
                x1 = min(width, cells[at, 0] + reach[abs(dy)] + 1)
                gain[at] += before[y, x1] - before[y, x0]
