"""Information gain of frontier cells: how much there is to see from them.

information_gain  unknown cells in sensor range that nobody else is about to see
promise           the unknown area in sight, and how much of that is likely to be floor
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from protocol.grid import OCCUPIED, UNKNOWN, Grid, ray_table
from protocol.kernels import kernel

BEAMS = 92
"""Beams by which the unknown in sight is measured."""

_LEAST_FLOOR, _MOST_FLOOR, _A_LENGTH = 0.13, 0.35, 0.3
"""How much of the unknown in sight of a free edge turns out to be floor that is seen from there: the least, the
most, and how much more for an edge as long as the sensor's range."""


def information_gain(
    grid: Grid,
    cells: NDArray[np.int32],
    range_cells: float,
    others: Sequence[tuple[int, int]],
    ranges: ArrayLike | None = None,
) -> NDArray[np.int64]:
    """Count the unknown cells within range of each of `cells` and not within that of one of `others`.

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
    ranges : one float for each of others, optional
        Sensor range of these teammates; as `range_cells` if left out.

    Returns
    -------
    int64 array, shape (n,)
    """
    gain = np.zeros(len(cells), np.int64)
    theirs = np.broadcast_to(range_cells if ranges is None else ranges, len(others))
    discs = [_disc_rows(reach) for reach in theirs.tolist()]
    start = np.cumsum([0, *map(len, discs)])
    taken = np.concatenate(discs) if discs else np.empty(0, np.int64)
    _count(
        grid, cells, np.array(others, np.int32).reshape(-1, 2), taken, start, _disc_rows(range_cells), gain
    )
    return gain


def _disc_rows(range_cells: float) -> NDArray[np.int64]:
    """How far a disc extends to both sides in the row dy away from its middle, for each dy from 0."""
    rows = np.arange(int(range_cells) + 1)
    widths: NDArray[np.int64] = np.sqrt(np.maximum(range_cells**2 - rows**2, 0)).astype(np.int64)
    return widths


def expected_gain(
    grid: Grid, cells: NDArray[np.int32], lengths: NDArray[np.int64], range_cells: float
) -> NDArray[np.float64]:
    """Predict what is to be seen from representatives of free edges.

    The unknown area in sight through what is free or unknown itself bounds it. Most of that lies behind walls
    which nobody has seen yet: the shorter the edge, the more.

    Parameters
    ----------
    grid : uint8 array, shape (h, w)
        The planning grid.
    cells : int32 array, shape (n, 2)
        Frontier cells (x, y).
    lengths : int64 array, shape (n,)
        How many cells the free edge of each has.
    range_cells : float
        Sensor range.

    Returns
    -------
    float64 array, shape (n,)
        Shares of the sensor's disc.
    """
    around = ray_table(range_cells, BEAMS)
    unknown = np.empty(len(cells))
    _look(grid, cells, around.cells, around.start, unknown)
    floor = np.minimum(_LEAST_FLOOR + _A_LENGTH * lengths / range_cells, _MOST_FLOOR)
    shares: NDArray[np.float64] = floor * unknown / (BEAMS * range_cells**2 / 2)
    return shares


@kernel("void(uint8[:,::1], int32[:,::1], int32[:,::1], int32[::1], float64[::1])")
def _look(
    grid: Grid,
    cells: NDArray[np.int32],
    fan_cells: NDArray[np.int32],
    start: NDArray[np.int32],
    unknown: NDArray[np.float64],
) -> None:
    """Sum, over all beams of each cell, the way over unknown cells times the distance at which it is."""
    height, width = grid.shape
    for index in range(len(cells)):
        total = 0.0
        for beam in range(len(start) - 1):
            before = 0.0
            for at in range(start[beam], start[beam + 1]):
                x, y = cells[index, 0] + fan_cells[at, 0], cells[index, 1] + fan_cells[at, 1]
                if x < 0 or y < 0 or x >= width or y >= height or grid[y, x] == OCCUPIED:
                    break
                squared = float(fan_cells[at, 0] ** 2 + fan_cells[at, 1] ** 2)
                if grid[y, x] == UNKNOWN:
                    total += (squared - before) / 2
                before = squared
        unknown[index] = total


@kernel("void(uint8[:,::1], int32[:,::1], int32[:,::1], int64[::1], int64[::1], int64[::1], int64[::1])")
def _count(
    grid: Grid,
    cells: NDArray[np.int32],
    others: NDArray[np.int32],
    taken: NDArray[np.int64],
    start: NDArray[np.int64],
    reach: NDArray[np.int64],
    gain: NDArray[np.int64],
) -> None:
    """`reach` has the rows of a disc (`_disc_rows`), and `taken` those of all others, of each from `start` on."""
    height, width = grid.shape
    open_cells = np.zeros((height, width), np.bool_)
    for y in range(height):
        for x in range(width):
            open_cells[y, x] = grid[y, x] == UNKNOWN
    for other in range(len(others)):
        rows = taken[start[other] : start[other + 1]]
        for dy in range(1 - len(rows), len(rows)):
            y = others[other, 1] + dy
            if 0 <= y < height:
                x0 = max(0, others[other, 0] - rows[abs(dy)])
                x1 = min(width, others[other, 0] + rows[abs(dy)] + 1)
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
