"""The planning grid of a noisy laser, without details that mislead strategies.

Between beams and beside walls, noise leaves gaps of unknown cells. They are no frontiers: a robot has nothing to enter
there. So an unknown cell counts only if it lies in a square of unknown cells as wide as the narrowest opening. Every
other one counts as a wall if a wall touches it, else as free. Likewise, noise opens walls: a free cell beside unknown
ones counts as a wall if it does not lie in a square of as many cells without walls.

False walls can enclose a robot, which would then report that it has nothing left to explore. So the cells that it has
driven over count as free, unless it bumped into something there later.
"""

from __future__ import annotations

import math

import numpy as np

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

OPENING_M = 0.3
"""Width of the narrowest opening that is worth exploring, in meters; wider robots need at least their own width."""

LEAST_CELLS = 2
"""The same in cells, at least."""

_UNKNOWN_SQUARE, _OPEN_SQUARE = 1, 2
"""Marks of cells in squares of unknown cells, and of cells without walls."""


class NoisyGrid:
    """The planning grid of one robot as its strategy sees it; all grids are uint8 arrays of shape (h, w).

    `narrow` is the width of the narrowest opening in cells (`narrow_cells`).
    """

    def __init__(self, height: int, width: int, narrow: int) -> None:
        self._narrow = narrow
        self._trail: Grid = np.zeros((height, width), np.uint8)
        self._marks: Grid = np.zeros((height, width), np.uint8)
        self._here: tuple[int, int] | None = None

    def drive(self, x: int, y: int) -> None:
        """Note that the robot has driven straight to cell (x, y)."""
        column, row = self._here or (x, y)
        self._trail[row, column] = 1
        while (column, row) != (x, y):
            if abs(x - column) >= abs(y - row):
                column += 1 if x > column else -1
            else:
                row += 1 if y > row else -1
            self._trail[row, column] = 1
        self._here = x, y

    def bump(self, x: int, y: int) -> None:
        """Note that the robot has bumped into something in cell (x, y)."""
        if (x, y) != self._here and 0 <= y < len(self._trail) and 0 <= x < self._trail.shape[1]:
            self._trail[y, x] = 0

    def clean(self, planning: Grid) -> Grid:
        """Return a copy of a planning grid without misleading details."""
        found = np.empty_like(planning)
        _without_gaps(planning, self._narrow, self._marks, found)
        found[self._trail != 0] = FREE
        return found


def narrow_cells(radius_cells: float, resolution: float) -> int:
    """Return the width in cells of the narrowest opening that a robot explores; cells are `resolution` meters wide."""
    return max(LEAST_CELLS, round(OPENING_M / resolution), math.ceil(2 * radius_cells))


@kernel
def _mark_squares(grid: Grid, narrow: int, walls: bool, marks: Grid, mark: int) -> None:
    """Mark the cells of all squares of `narrow` by `narrow` cells without walls, or of unknown cells only."""
    height, width = grid.shape
    for y in range(height - narrow + 1):
        run = 0
        for x in range(width):
            column = 0
            while column < narrow and (
                grid[y + column, x] != OCCUPIED if walls else grid[y + column, x] == UNKNOWN
            ):
                column += 1
            run = run + 1 if column == narrow else 0
            if run >= narrow:
                for row in range(y, y + narrow):
                    for left in range(x - narrow + 1, x + 1):
                        marks[row, left] |= mark


@kernel
def _touches(grid: Grid, state: int, x: int, y: int) -> bool:
    """Whether a cell or one of its eight neighbors has a state."""
    for row in range(max(0, y - 1), min(grid.shape[0], y + 2)):
        for column in range(max(0, x - 1), min(grid.shape[1], x + 2)):
            if grid[row, column] == state:
                return True
    return False


@kernel
def _without_gaps(grid: Grid, narrow: int, marks: Grid, out: Grid) -> None:
    """Write a planning grid without narrow gaps and openings to `out`; `marks` is a buffer of the same shape."""
    marks[:] = 0
    _mark_squares(grid, narrow, False, marks, _UNKNOWN_SQUARE)
    _mark_squares(grid, narrow, True, marks, _OPEN_SQUARE)
    for y in range(grid.shape[0]):
        for x in range(grid.shape[1]):
            state, mark = grid[y, x], marks[y, x]
            out[y, x] = state
            if state == UNKNOWN and not mark & _UNKNOWN_SQUARE:
                out[y, x] = OCCUPIED if _touches(grid, OCCUPIED, x, y) else FREE
            elif state == FREE and not mark & _OPEN_SQUARE and _touches(grid, UNKNOWN, x, y):
                out[y, x] = OCCUPIED
