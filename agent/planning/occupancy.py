"""Path costs by occupancy, so that ways keep away from walls (Burgard et al. 2005, section II-A).

In the paper the cost of a cell is distance times occupancy, on a map smoothed by a Gaussian. Here it is scaled so that
a cell far from all obstacles costs its length. Lengths are integers, in 1024ths of a cell. As in
`agent.planning.cost_field`, no step is shorter than a cell, so the search settles cells in buckets of that width.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.planning.cost_field import DIAGONAL, STEPS, Field
from protocol.arrays import FloatRows
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

P_FREE, P_UNKNOWN, P_OCCUPIED = 0.1, 0.5, 0.9
"""Occupancy probability of a cell of each state."""

SMOOTHING = 1.0
"""Standard deviation of the Gaussian, in cells."""
_TRUNCATE = 3.0

_GRAIN = 1024
_RING = 16
"""Buckets in the ring; more than the longest step, sqrt 2 times P_OCCUPIED / P_FREE."""


def smoothed(grid: Grid) -> FloatRows:
    """Return the occupancy probability of each cell, smoothed by a Gaussian: float64 array, shape (h, w)."""
    from scipy import ndimage  # noqa: PLC0415  slow to import, and few commands need it

    table = np.zeros(256, np.float32)
    table[[UNKNOWN, FREE, OCCUPIED]] = P_UNKNOWN, P_FREE, P_OCCUPIED
    found: NDArray[np.float32] = ndimage.gaussian_filter(
        table[grid], SMOOTHING, mode="constant", cval=P_UNKNOWN, truncate=_TRUNCATE
    )
    return found.astype(np.float64)


def barred(grid: Grid, floor: Grid, occ_max: float) -> Grid:
    """Return the floor with cells of more occupancy than `occ_max` as obstacles (section II-A).

    With 0.9 or more there are none. With less, narrow doorways close: with 0.5 those of one cell.
    """
    if occ_max >= P_OCCUPIED:
        return floor
    left = floor.copy()
    left[(smoothed(grid) > occ_max) & (floor == FREE)] = OCCUPIED
    return left


def entry_costs(grid: Grid) -> FloatRows:
    """Return the cost of entering each cell per cell of way, shape (h, w), from 1 to P_OCCUPIED / P_FREE."""
    weights = np.clip(smoothed(grid) / P_FREE, 1.0, P_OCCUPIED / P_FREE)
    return np.rint(weights * _GRAIN) / _GRAIN


def weighted_costs(floor: Grid, weights: FloatRows, x: int, y: int) -> Field:
    """Return the cost of the best way from cell (x, y) to every cell, shape (h, w); infinite without a way.

    A robot may enter only cells that are free on `floor`. A step costs by the cell that it enters (`entry_costs`).
    """
    field = np.full(floor.shape, np.inf)
    _spread(floor, weights, x, y, field)
    return field


@kernel
def _spread(floor: Grid, weights: FloatRows, x: int, y: int, field: Field) -> None:
    height, width = floor.shape
    buckets = np.empty((_RING, 1024), np.int32)
    fill = np.zeros(_RING, np.int64)
    field[y, x], buckets[0, 0], fill[0] = 0.0, y * width + x, 1
    level = 0
    while fill.any():
        ring = level % _RING
        most = fill.max() + 8 * fill[ring]
        if most > buckets.shape[1]:
            larger = np.empty((_RING, 2 * most), np.int32)
            larger[:, : buckets.shape[1]] = buckets
            buckets = larger
        for at in range(fill[ring]):
            cx, cy = buckets[ring, at] % width, buckets[ring, at] // width
            base = field[cy, cx]
            if int(base) != level:
                continue  # reached on a cheaper way since
            for number in range(8):
                nx, ny = cx + STEPS[number, 0], cy + STEPS[number, 1]
                if not (0 <= nx < width and 0 <= ny < height) or floor[ny, nx] != FREE:
                    continue
                if number >= 4 and (floor[cy, nx] != FREE or floor[ny, cx] != FREE):
                    continue
                step = weights[ny, nx] * (DIAGONAL if number >= 4 else 1.0)
                new = base + round(step * _GRAIN) / _GRAIN
                if new < field[ny, nx]:
                    field[ny, nx] = new
                    to = int(new) % _RING
                    buckets[to, fill[to]] = ny * width + nx
                    fill[to] += 1
        fill[ring] = 0
        level += 1
