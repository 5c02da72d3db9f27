"""Information gain of frontier cells: the unknown area that a scan from there would observe.

information_gain  unknown cells in sensor range and out of range of teammates and their targets
expected_gain     the unknown area in sight, times the share of it that is likely to be free
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from protocol.arrays import Cells, Floats, Int32Rows, Int32s, Int64s
from protocol.grid import OCCUPIED, UNKNOWN, Cell, Grid, ray_table
from protocol.kernels import kernel

BEAMS = 92
"""Beams that sample the unknown area in sight."""

_LEAST_SHARE, _MOST_SHARE, _SHARE_PER_RANGE = 0.13, 0.35, 0.3
"""Share of the unknown area in sight of a frontier segment that turns out to be free and visible: least and largest
share, and the increase for a segment as long as the sensor range. Measured on generated maps."""


def information_gain(
    grid: Grid,
    cells: Cells,
    range_cells: float,
    others: Sequence[Cell],
    ranges: ArrayLike | None = None,
) -> Int64s:
    """Count the unknown cells within range of each of `cells` and out of range of all `others`, shape (n,).

    Sheng et al. 2006, as quoted by Al-khawaldah and Nuechter 2014: I of Eq. (1). `others` are the cells and targets of
    teammates; `ranges` has the sensor range of each of them in cells, by default `range_cells`.
    """
    theirs = np.broadcast_to(range_cells if ranges is None else ranges, len(others))
    discs = [_disc_rows(reach) for reach in theirs.tolist()]
    start = np.cumsum([0, *map(len, discs)])
    taken = np.array(others, np.int32).reshape(-1, 2), np.concatenate([np.empty(0, np.int64), *discs]), start
    gain: Int64s = _count(grid, cells, taken, _disc_rows(range_cells))
    return gain


def _disc_rows(range_cells: float) -> Int64s:
    """Return the half width of a disc in the rows at distance 0, 1, ... from its center."""
    rows = np.arange(int(range_cells) + 1)
    widths: Int64s = np.sqrt(np.maximum(range_cells**2 - rows**2, 0)).astype(np.int64)
    return widths


def expected_gain(grid: Grid, cells: Cells, lengths: Int64s, range_cells: float) -> Floats:
    """Predict the area that a robot will observe from representatives of frontier segments, in discs of its sensor.

    An upper bound is the unknown area in sight through free and unknown cells. Most of it lies behind unknown walls,
    and more so for short segments. `lengths`, shape (n,), has the number of cells of the frontier segment of each.
    """
    around = ray_table(range_cells, BEAMS)
    unknown = _sum_unknown(grid, cells, around.cells, around.flat(grid.shape[1] + 2), around.start)
    share = np.minimum(_LEAST_SHARE + _SHARE_PER_RANGE * lengths / range_cells, _MOST_SHARE)
    gain: Floats = share * unknown / (BEAMS * range_cells**2 / 2)
    return gain


@kernel
def _sum_unknown(grid: Grid, cells: Cells, beam_cells: Int32Rows, flat: Int32s, start: Int32s) -> Floats:
    """Sum over all beams of each cell the integral of the distance over unknown cells, up to the first obstacle.

    `flat` has the offsets `beam_cells` as index differences on the grid with a rim of obstacles, which beams cannot
    cross. Returns an array of shape (n,).
    """
    unknown = np.empty(len(cells))
    height, width = grid.shape
    stride = width + 2
    rimmed = np.full((height + 2) * stride, np.uint8(OCCUPIED))
    for y in range(height):
        begin = (y + 1) * stride + 1
        rimmed[begin : begin + width] = grid[y]
    # Twice the integral over each cell: the increase of the squared distance.
    grows = np.empty(len(flat), np.int64)
    for beam in range(len(start) - 1):
        before = 0
        for at in range(start[beam], start[beam + 1]):
            squared = beam_cells[at, 0] * beam_cells[at, 0] + beam_cells[at, 1] * beam_cells[at, 1]
            grows[at] = squared - before
            before = squared
    for index in range(len(cells)):
        center = (cells[index, 1] + 1) * stride + cells[index, 0] + 1
        total = 0
        for beam in range(len(start) - 1):
            for at in range(start[beam], start[beam + 1]):
                state = rimmed[center + flat[at]]
                if state == OCCUPIED:
                    break
                if state == UNKNOWN:
                    total += grows[at]
        unknown[index] = total / 2
    return unknown


@kernel
def _count(grid: Grid, cells: Cells, taken: tuple[Cells, Int64s, Int64s], reach: Int64s) -> Int64s:
    """Count the unknown cells in a disc around each cell, without those in other discs; array of shape (n,).

    `reach` has the rows of the disc (`_disc_rows`), `taken` the centers of the others, all their rows, and where those
    of each begin.
    """
    (others, all_rows, start), gain = taken, np.zeros(len(cells), np.int64)
    height, width = grid.shape
    open_cells = np.zeros((height, width), np.bool_)
    for y in range(height):
        for x in range(width):
            open_cells[y, x] = grid[y, x] == UNKNOWN
    for other in range(len(others)):
        rows = all_rows[start[other] : start[other + 1]]
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
    return gain
