"""An occupancy estimator with integer log odds and hysteresis (Moravec and Elfes 1985; Thrun et al. 2005, chapter 9).

Log odds are in units of 0.05. A scan counts once per cell, and a hit precedes a pass. A cell keeps its state while
its log odds lie between the thresholds. Every operation is on integers, so all machines compute the same map.

Positions are in units of 1/256 cell. Beams cross cells as in `protocol.grid.ray_table`: between 4-neighbors only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

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

    def add(
        self, x: int, y: int, ends: NDArray[np.int32], hits: NDArray[np.bool_]
    ) -> tuple[int, int, int, int]:
        """Add a scan taken at (x, y); return the box of touched cells (x0, y0, x1, y1).

        `ends`, shape (beams, 2), are where beams end; `hits` are beams that ended at an obstacle.
        """
        return _add(self.log_odds, self.states, self._marks, self._touched, x, y, ends, hits)

    @property
    def settled(self) -> NDArray[np.bool_]:
        """Cells whose state is certain enough to be corrected at teammates."""
        mask: NDArray[np.bool_] = np.abs(self.log_odds) >= SETTLED
        return mask


@kernel
def _add(log_odds, states, marks, touched, x, y, ends, hits):  # type: ignore[no-untyped-def]
    height, width = states.shape
    count = 0
    x0, y0, x1, y1 = width, height, 0, 0
    for beam in range(len(ends)):
        dx, dy = ends[beam, 0] - x, ends[beam, 1] - y
        along_x, along_y = abs(dx), abs(dy)
        step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        column, row = x >> 8, y >> 8
        last_x, last_y = ends[beam, 0] >> 8, ends[beam, 1] >> 8
        # distance to the next border in x and y, multiplied by the other component
        to_x = (((column + 1) << 8) - x if dx > 0 else x - (column << 8)) * np.int64(along_y)
        to_y = (((row + 1) << 8) - y if dy > 0 else y - (row << 8)) * np.int64(along_x)
        left = abs(last_x - column) + abs(last_y - row)
        while 0 <= column < width and 0 <= row < height:
            mark = 2 if left == 0 and hits[beam] else 1
            place = row * width + column
            if marks[row, column] == 0:
                touched[count] = place
                count += 1
                x0, x1, y0, y1 = min(x0, column), max(x1, column + 1), min(y0, row), max(y1, row + 1)
            if marks[row, column] < mark:
                marks[row, column] = mark
            if left == 0:
                break
            left -= 1
            if (to_x <= to_y and column != last_x) or row == last_y:
                column += step_x
                to_x += np.int64(along_y) << 8
            else:
                row += step_y
                to_y += np.int64(along_x) << 8
    for index in range(count):
        column, row = touched[index] % width, touched[index] // width
        change = STRUCK if marks[row, column] == 2 else PASS
        marks[row, column] = 0
        odds = min(MOST, max(LEAST, np.int64(log_odds[row, column]) + change))
        log_odds[row, column] = odds
        if odds > WALL:
            states[row, column] = OCCUPIED
        elif odds < CLEAR:
            states[row, column] = FREE
    return x0, y0, x1, y1
