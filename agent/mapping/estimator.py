"""An occupancy estimator with integer log odds and hysteresis (Moravec and Elfes 1985; Thrun et al. 2005, chapter 9).

Log odds are in units of 0.05. A scan counts once per cell, as a hit or as a pass. Its beams decide which: noise lets
some of them end before a wall, and some behind it. A cell keeps its state while its log odds lie between the
thresholds. Every operation is on integers, so all machines compute the same map.

Positions are in 1 / `protocol.range_scans.UNIT` cell. As in `protocol.grid.ray_table`, beams move between 4-neighbors.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Bools, Int16Rows, Int16s, Int32Rows
from protocol.boxes import NO_BOX, Box
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel
from protocol.range_scans import Vector
from protocol.scans import GridChange

Int8Grid = Annotated[NDArray[np.int8], "int8[:,::1]"]

PASS, HIT = -8, 17
"""What a scan adds to the log odds of a cell that it has passed, or hit."""

LEAST, MOST = -40, 70
"""Limits of the log odds of a cell."""

WALL, CLEAR = 8, -6
"""A cell becomes a wall above the first threshold, and free below the second one."""

HIT_VOTES = 3
"""Votes of a beam that ends in a cell, for a hit; a beam that passes the cell has one vote against it."""

TOUCHED = 1 << 14
"""Mark of a cell with as many votes for a hit as against it, or of a hit if more; 0 if no beam has touched the cell."""

SETTLED = 24
"""Absolute log odds from which a cell is settled."""

NEAR_LOOKS = 3
"""Scans from nearby in which no beam enters an unknown cell in sight, after which it counts as a wall."""


class Estimator:
    """Log odds and states of a grid, shape (h, w); `add` returns the cells whose state or settledness changes."""

    def __init__(self, height: int, width: int) -> None:
        self.known_cells = 0
        """Number of cells that are known."""
        self.log_odds: NDArray[np.int8] = np.zeros((height, width), np.int8)
        self.states: Grid = np.full((height, width), UNKNOWN, np.uint8)
        self._marks: NDArray[np.int16] = np.zeros((height, width), np.int16)
        """The votes of a scan for each cell (`TOUCHED`); 0 between scans."""
        self._looks: NDArray[np.uint8] = np.zeros((height, width), np.uint8)
        """Scans that have not entered a cell nearby (`close`)."""

    def add(self, x: int, y: int, ends: NDArray[np.int32], hits: NDArray[np.bool_]) -> GridChange:
        """Add a scan taken at (x, y).

        `ends`, shape (beams, 2), are where beams end; `hits` are beams that ended at an obstacle.
        """
        return self._apply(_mark_beams(self._marks, x, y, ends, hits))

    def strike(self, x: int, y: int) -> GridChange:
        """Note that the robot has bumped into something in cell (x, y): it is occupied for the time being."""
        height, width = self.states.shape
        if not (0 <= x < width and 0 <= y < height):
            return GridChange(0, NO_BOX)
        self.log_odds[y, x] = max(self.log_odds[y, x], 0)
        self._marks[y, x] = TOUCHED
        return self._apply((x, y, x + 1, y + 1))

    def stand(self, x: int, y: int) -> GridChange:
        """Note that the robot stands in cell (x, y): it is free."""
        self.log_odds[y, x] = min(self.log_odds[y, x], CLEAR - 1 - PASS)
        self._marks[y, x] = TOUCHED - 1
        return self._apply((x, y, x + 1, y + 1))

    def close(self, x: int, y: int, reach: int, first: Vector, last: Vector) -> GridChange:
        """Note that a scan from cell (x, y) has not entered the unknown cells in sight.

        They are at most `reach` rows and columns away, where beams cross every open cell. After `NEAR_LOOKS` scans such
        a cell is a wall, until a beam crosses it: walls right beside a robot are nearer than a laser can measure, or
        lost to the errors of poses. `first` and `last` are the directions between which the laser sees, as vectors;
        both are (0, 0) if it sees all around.
        """
        known, box = _close(self.states, self._looks, x, y, reach, first, last)
        self.known_cells += known
        return GridChange(known, box if known else NO_BOX)

    def _apply(self, touched: Box) -> GridChange:
        known, changed, box = _apply(self.log_odds, self.states, self._marks, touched)
        self.known_cells += known
        return GridChange(changed, box if changed else NO_BOX)


@kernel
def _mark(marks: Int16s, place: int, vote: int) -> None:
    """Count a beam's vote for a cell."""
    if marks[place] == 0:
        marks[place] = TOUCHED
    marks[place] += vote


@kernel
def _mark_beams(marks: Int16Rows, x: int, y: int, ends: Int32Rows, hits: Bools) -> Box:
    """Count the votes of beams between exact positions, for each cell; return a box around the cells."""
    height, width = marks.shape
    flat = marks.reshape(marks.size)
    first_x, first_y = x >> 8, y >> 8
    x0, y0, x1, y1 = first_x, first_y, first_x, first_y
    for beam in range(len(ends)):
        dx, dy = np.int64(ends[beam, 0]) - x, np.int64(ends[beam, 1]) - y
        along_x, along_y = abs(dx), abs(dy)
        step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        column, row = first_x, first_y
        last_x, last_y = int(ends[beam, 0]) >> 8, int(ends[beam, 1]) >> 8
        x0, x1, y0, y1 = min(x0, last_x), max(x1, last_x), min(y0, last_y), max(y1, last_y)
        # the distance to the next border in each axis, multiplied by the component along the other axis
        to_x = (((column + 1) << 8) - x if dx > 0 else x - (column << 8)) * along_y
        to_y = (((row + 1) << 8) - y if dy > 0 else y - (row << 8)) * along_x
        left = abs(last_x - column) + abs(last_y - row)
        while 0 <= column < width and 0 <= row < height:
            place = row * width + column
            if left == 0:
                _mark(flat, place, HIT_VOTES if hits[beam] else -1)
                break
            _mark(flat, place, -1)
            left -= 1
            if (to_x <= to_y and column != last_x) or row == last_y:
                column += step_x
                to_x += along_y << 8
            else:
                row += step_y
                to_y += along_x << 8
    return max(0, x0), max(0, y0), min(width, x1 + 1), min(height, y1 + 1)


@kernel
def _apply(log_odds: Int8Grid, states: Grid, marks: Int16Rows, box: Box) -> tuple[int, int, Box]:
    """Change the log odds and states of the marked cells in a box, and clear the marks.

    Returns the number of cells that became known, the number of cells whose state or settledness changed, and a box
    around the latter.
    """
    x0, y0, x1, y1 = box
    known = changed = 0
    left, top, right, bottom = x1, y1, x0, y0
    for y in range(y0, y1):
        for x in range(x0, x1):
            if marks[y, x] == 0:
                continue
            change = HIT if marks[y, x] >= TOUCHED else PASS
            marks[y, x] = 0
            before, state = int(np.int64(log_odds[y, x])), states[y, x]
            odds = min(MOST, max(LEAST, before + change))
            log_odds[y, x] = odds
            if odds > WALL:
                states[y, x] = OCCUPIED
            elif odds < CLEAR:
                states[y, x] = FREE
            if states[y, x] != state or (abs(odds) >= SETTLED) != (abs(before) >= SETTLED):
                known += state == UNKNOWN and states[y, x] != UNKNOWN
                changed += 1
                left, right, top, bottom = min(left, x), max(right, x + 1), min(top, y), max(bottom, y + 1)
    return known, changed, (left, top, right, bottom)


@kernel
def _in_sight(states: Grid, x: int, y: int, to_x: int, to_y: int) -> bool:
    """Whether all cells on the line between two cells are free, without the second one."""
    dx, dy = to_x - x, to_y - y
    steps = max(abs(dx), abs(dy))
    for step in range(steps):
        column = x + (2 * dx * step + steps) // (2 * steps)
        row = y + (2 * dy * step + steps) // (2 * steps)
        if states[row, column] != FREE:
            return False
    return True


@kernel
def _in_view(dx: int, dy: int, first: Vector, last: Vector) -> bool:
    """Whether a direction lies between the first and the last one of a laser; always if both are 0."""
    (first_x, first_y), (last_x, last_y) = first, last
    behind_first = first_x * dy - first_y * dx >= 0
    before_last = dx * last_y - dy * last_x >= 0
    if first_x * last_y - first_y * last_x > 0:
        return behind_first and before_last
    return behind_first or before_last


@kernel
def _close(
    states: Grid, looks: Grid, x: int, y: int, reach: int, first: Vector, last: Vector
) -> tuple[int, Box]:
    """Count the looks at unknown cells beside free ones in sight; the cells with enough of them become walls.

    Returns their number and a box around them.
    """
    height, width = states.shape
    left, top, right, bottom = width, height, 0, 0
    closed = 0
    for row in range(max(1, y - reach), min(height - 1, y + reach + 1)):
        for column in range(max(1, x - reach), min(width - 1, x + reach + 1)):
            if states[row, column] != UNKNOWN:
                continue
            is_beside = (
                states[row, column - 1] == FREE
                or states[row, column + 1] == FREE
                or states[row - 1, column] == FREE
                or states[row + 1, column] == FREE
            )
            in_view = is_beside and _in_view(column - x, row - y, first, last)
            if not (in_view and _in_sight(states, x, y, column, row)):
                continue
            looks[row, column] += 1
            if looks[row, column] >= NEAR_LOOKS:
                looks[row, column] = 0
                states[row, column] = OCCUPIED
                closed += 1
                left, right = min(left, column), max(right, column + 1)
                top, bottom = min(top, row), max(bottom, row + 1)
    return closed, (left, top, right, bottom)
