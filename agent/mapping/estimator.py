"""An occupancy estimator with integer log odds and hysteresis (Moravec and Elfes 1985; Thrun et al. 2005, chapter 9).

Log odds are in units of 0.05. A scan counts once per cell, and a hit precedes a pass. A cell keeps its state while
its log odds lie between the thresholds. Every operation is on integers, so all machines compute the same map.

Positions are in units of 1/256 cell. Beams cross cells as in `protocol.grid.ray_table`: between 4-neighbors only.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Bools, Int32Rows, Int32s
from protocol.boxes import Box
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, RayTable
from protocol.kernels import kernel
from protocol.scans import NONE, Readings

Int8Grid = Annotated[NDArray[np.int8], "int8[:,::1]"]

NO_CELLS: NDArray[np.int32] = np.empty((0, 2), np.int32)

UNIT = 256
"""Units of a position in a cell."""

PASS, STRUCK = -8, 17
LEAST, MOST = -40, 70
WALL, CLEAR = 8, -6
SETTLED = 24
"""Absolute log odds from which a cell is settled."""


class Estimator:
    """Log odds and states of a grid, shape (h, w)."""

    def __init__(self, height: int, width: int) -> None:
        self.log_odds: NDArray[np.int8] = np.zeros((height, width), np.int8)
        self.states: Grid = np.full((height, width), UNKNOWN, np.uint8)
        self._marks: NDArray[np.uint8] = np.zeros((height, width), np.uint8)
        self._touched: NDArray[np.int32] = np.empty(height * width, np.int32)

    def add(self, x: int, y: int, ends: NDArray[np.int32], hits: NDArray[np.bool_]) -> Box:
        """Add a scan taken at (x, y); return the box of touched cells (x0, y0, x1, y1).

        `ends`, shape (beams, 2), are where beams end; `hits` are beams that ended at an obstacle.
        """
        count = _mark_beams(self._marks, self._touched, x, y, ends, hits)
        return _apply(self.log_odds, self.states, self._marks, self._touched, count)

    def add_readings(
        self,
        ray_table: RayTable,
        x: int,
        y: int,
        readings: Readings,
        driven: NDArray[np.int32] = NO_CELLS,
    ) -> Box:
        """Add a scan whose beams cross the cells of a ray table; return the box of touched cells.

        The parameters are those of `protocol.scans.draw`. If scans do not contradict each other, the states equal the
        grid that `draw` produces: the first scan of a cell decides its state.
        """
        cells, start, shared = ray_table.cells, ray_table.start, ray_table.shared
        count = _mark_readings(self._marks, self._touched, cells, start, shared, x, y, readings, driven)
        return _apply(self.log_odds, self.states, self._marks, self._touched, count)

    @property
    def settled(self) -> NDArray[np.bool_]:
        """Cells whose state is certain enough to be corrected at teammates."""
        mask: NDArray[np.bool_] = np.abs(self.log_odds) >= SETTLED
        return mask


@kernel
def _mark(marks: Grid, touched: Int32s, count: int, x: int, y: int, mark: int) -> int:
    """Mark a cell as passed (1) or struck (2); list it if it is new, and return the number of listed cells."""
    if marks[y, x] == 0:
        touched[count] = y * marks.shape[1] + x
        count += 1
    marks[y, x] = max(marks[y, x], mark)
    return count


@kernel
def _mark_beams(marks: Grid, touched: Int32s, x: int, y: int, ends: Int32Rows, hits: Bools) -> int:
    """Mark the cells that beams cross between exact positions; return their number."""
    height, width = marks.shape
    count = 0
    for beam in range(len(ends)):
        dx, dy = np.int64(ends[beam, 0]) - x, np.int64(ends[beam, 1]) - y
        along_x, along_y = abs(dx), abs(dy)
        step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        column, row = x >> 8, y >> 8
        last_x, last_y = ends[beam, 0] >> 8, ends[beam, 1] >> 8
        # the distance to the next border in each axis, multiplied by the component along the other axis
        to_x = (((column + 1) << 8) - x if dx > 0 else x - (column << 8)) * along_y
        to_y = (((row + 1) << 8) - y if dy > 0 else y - (row << 8)) * along_x
        left = abs(last_x - column) + abs(last_y - row)
        while 0 <= column < width and 0 <= row < height:
            count = _mark(marks, touched, count, column, row, 2 if left == 0 and hits[beam] else 1)
            if left == 0:
                break
            left -= 1
            if (to_x <= to_y and column != last_x) or row == last_y:
                column += step_x
                to_x += along_y << 8
            else:
                row += step_y
                to_y += along_x << 8
    return count


@kernel
def _mark_readings(
    marks: Grid,
    touched: Int32s,
    cells: Int32Rows,
    start: Int32s,
    shared: Int32s,
    x: int,
    y: int,
    readings: Readings,
    driven: Int32Rows,
) -> int:
    """Mark the cells of a ray table that a scan crosses or hits, and the driven cells; return their number."""
    height, width = marks.shape
    count = 0
    for at in range(len(driven)):
        if 0 <= driven[at, 0] < width and 0 <= driven[at, 1] < height:
            count = _mark(marks, touched, count, driven[at, 0], driven[at, 1], 1)
    if not (0 <= x < width and 0 <= y < height):
        return count
    count = _mark(marks, touched, count, x, y, 1)
    touched_before = 0
    for beam in range(len(readings)):
        if readings[beam] == NONE:
            touched_before = 0
            continue
        first, hit = np.int64(start[beam]), start[beam] + np.int64(readings[beam] & NONE)
        end = hit + np.int64(readings[beam] >> 15)
        # the cells shared with the beam before, as far as that beam reached, are marked as passed already
        for at in range(first + min(np.int64(shared[beam]), touched_before, hit - first), end):
            column, row = x + cells[at, 0], y + cells[at, 1]
            if not (0 <= column < width and 0 <= row < height):
                break
            count = _mark(marks, touched, count, column, row, 2 if at == hit else 1)
        touched_before = end - first
    return count


@kernel
def _apply(
    log_odds: Int8Grid, states: Grid, marks: Grid, touched: Int32s, count: int
) -> tuple[int, int, int, int]:
    """Change the log odds and states of the marked cells, and clear the marks; return the box of these cells."""
    height, width = states.shape
    x0, y0, x1, y1 = width, height, 0, 0
    for index in range(count):
        column, row = touched[index] % width, touched[index] // width
        x0, x1 = min(x0, column), max(x1, column + 1)
        y0, y1 = min(y0, row), max(y1, row + 1)
        change = STRUCK if marks[row, column] == 2 else PASS
        marks[row, column] = 0
        odds = min(MOST, max(LEAST, np.int64(log_odds[row, column]) + change))
        log_odds[row, column] = odds
        if odds > WALL:
            states[row, column] = OCCUPIED
        elif odds < CLEAR:
            states[row, column] = FREE
    return x0, y0, x1, y1
