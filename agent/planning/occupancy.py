"""Path costs by occupancy, so that ways keep away from walls (Burgard et al. 2005, section II-A).

In the paper the cost of a cell is distance times occupancy, on a map smoothed by a Gaussian. Here it is scaled so that
a cell far from all obstacles costs its length. Lengths are integers, in 1024ths of a cell. As in
`agent.planning.cost_field`, no step is shorter than a cell, so the search settles cells in buckets of that width.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from agent.planning.cost_field import Field
from protocol.arrays import BoolRows, Bools, FloatRows, Int32Rows, Int32s
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

P_FREE, P_UNKNOWN, P_OCCUPIED = 0.1, 0.5, 0.9
"""Occupancy probability of a cell of each state."""

SMOOTHING = 1.0
"""Standard deviation of the Gaussian, in cells."""
_TRUNCATE = 3.0

_GRAIN_BITS = 10
_GRAIN = 1 << _GRAIN_BITS
_UNIT = 1.0 / _GRAIN
_ROOT = math.sqrt(2.0)
_RING = 16
"""Buckets in the ring; more than the longest step, sqrt 2 times P_OCCUPIED / P_FREE."""
_FAR = np.int32(np.iinfo(np.int32).max)
_BARRED = np.int32(-1)
_DONE = np.uint8(16)


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


class Terrain:
    """Costs of entering the cells of a planning grid, prepared for `weighted_costs`.

    A robot may enter only cells that are free on `floor`; the paper's occ_max (`barred`) removes some of them.

    Parameters
    ----------
    grid : uint8 array, shape (h, w)
        The planning grid.
    floor : uint8 array, shape (h, w)
        The planning grid with obstacles enlarged by the robot's radius.

    Attributes
    ----------
    weights : float64 array, shape (h, w)
        Cost of entering a cell per cell of way, from 1 to P_OCCUPIED / P_FREE.
    """

    def __init__(self, grid: Grid, floor: Grid) -> None:
        weights = np.clip(smoothed(grid) / P_FREE, 1.0, P_OCCUPIED / P_FREE)
        self.weights = np.rint(weights * _GRAIN) / _GRAIN
        self.straight = np.zeros((grid.shape[0] + 2, grid.shape[1] + 2), np.int32)
        self.diagonal = np.zeros_like(self.straight)
        self.plain = np.zeros(self.straight.shape, np.bool_)
        _lay_out(floor, self.weights, self.straight, self.diagonal, self.plain)


def weighted_costs(terrain: Terrain, x: int, y: int) -> Field:
    """Return the cost of the best way from cell (x, y) to every cell; a step costs by the cell that it enters.

    Returns
    -------
    float64 array, shape (h, w)
        In cells of free floor; infinite without a way.
    """
    height, width = terrain.weights.shape
    field = np.empty((height, width))
    _spread(terrain.straight.ravel(), terrain.diagonal.ravel(), terrain.plain.ravel(), x, y, field)
    return field


@kernel
def _lay_out(
    floor: Grid, weights: FloatRows, straight: Int32Rows, diagonal: Int32Rows, plain: BoolRows
) -> None:
    """Compute the costs of a straight and a diagonal step into each cell, 0 for obstacles and the rim.

    A cell is plain if it and its eight neighbors have equal costs.
    """
    height, width = floor.shape
    for y in range(height):
        for x in range(width):
            if floor[y, x] == FREE:
                straight[y + 1, x + 1] = round(weights[y, x] * _GRAIN)
                diagonal[y + 1, x + 1] = round(weights[y, x] * _ROOT * _GRAIN)
    for y in range(1, height + 1):
        for x in range(1, width + 1):
            alike = straight[y, x] > 0
            for ny in range(y - 1, y + 2):
                for nx in range(x - 1, x + 2):
                    alike = alike and straight[ny, nx] == straight[y, x]
            plain[y, x] = alike


@kernel
def _spread(straight: Int32s, diagonal: Int32s, plain: Bools, x: int, y: int, field: Field) -> None:
    height, width = field.shape
    stride = width + 2
    length = np.where(straight > 0, _FAR, _BARRED)
    came = np.zeros(len(straight), np.uint8)
    buckets = np.empty((_RING, 1024), np.int32)
    fill = np.zeros(_RING, np.int64)
    start = (y + 1) * stride + x + 1
    length[start] = 0
    buckets[0, 0] = start
    fill[0] = 1
    offset = np.array([1, stride, -1, -stride, 1 + stride, stride - 1, -1 - stride, 1 - stride])
    # Successor steps of each step (canonical ordering, as in agent.planning.cost_field); row 8: all steps.
    onward = np.zeros((9, 8), np.int64)
    for number in range(8):
        onward[number, 0] = number
        onward[number, 1] = (number - 4) & 3
        onward[number, 2] = (number - 3) & 3
        onward[8, number] = number
    level = 0
    empty = 0
    while empty < _RING:
        ring = level & (_RING - 1)
        empty = empty + 1 if fill[ring] == 0 else 0
        for ahead in range(1, _RING):
            # A cell enters a bucket at most eight times.
            to = (level + ahead) & (_RING - 1)
            if fill[to] + 8 * fill[ring] > buckets.shape[1]:
                larger = np.empty((_RING, 2 * (fill[to] + 8 * fill[ring])), np.int32)
                larger[:, : buckets.shape[1]] = buckets
                buckets = larger
        for at in range(fill[ring]):
            cell = buckets[ring, at]
            base = length[cell]
            if came[cell] == _DONE:
                continue  # a duplicate, or reached on a cheaper way since
            row = 8
            count = 8
            if plain[cell] and cell != start:
                row = came[cell]
                count = 1 if row < 4 else 3
            came[cell] = _DONE
            for index in range(count):
                number = onward[row, index]
                to_cell = cell + offset[number]
                # Obstacles count as reached; no step is shorter than a cell.
                if length[to_cell] <= base + _GRAIN:
                    continue
                if number < 4:
                    new = base + straight[to_cell]
                else:
                    beside = straight[cell + offset[number - 4]]
                    if beside == 0 or straight[cell + offset[(number - 3) & 3]] == 0:
                        continue
                    new = base + diagonal[to_cell]
                if new < length[to_cell]:
                    length[to_cell] = new
                    came[to_cell] = number
                    to = (new >> _GRAIN_BITS) & (_RING - 1)
                    buckets[to, fill[to]] = to_cell
                    fill[to] += 1
        fill[ring] = 0
        level += 1
    for row in range(height):
        for column in range(width):
            whole = length[(row + 1) * stride + column + 1]
            field[row, column] = np.inf if whole in (_FAR, _BARRED) else whole * _UNIT
