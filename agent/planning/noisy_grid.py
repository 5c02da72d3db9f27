"""The planning grid of a noisy laser, without details that mislead strategies.

Between beams and beside walls, noise leaves gaps of unknown cells. They are no frontiers: a robot has nothing to enter
there. So an unknown cell counts only if it lies in a square of `NARROW` by `NARROW` unknown cells. Every other one
counts as a wall if a wall touches it, else as free.

False walls can enclose a robot, which would then report that it has nothing left to explore. So the cells that it has
driven over count as free, unless it bumped into something there later.
"""

from __future__ import annotations

import numpy as np

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

NARROW = 2
"""Side of the smallest square of unknown cells that is worth exploring, in cells."""


class NoisyGrid:
    """The planning grid of one robot as its strategy sees it; all grids are uint8 arrays of shape (h, w)."""

    def __init__(self, height: int, width: int) -> None:
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
        _without_gaps(planning, NARROW, self._marks, found)
        found[self._trail != 0] = FREE
        return found


@kernel
def _without_gaps(grid: Grid, narrow: int, marks: Grid, out: Grid) -> None:
    """Write a planning grid without narrow gaps to `out`; `marks` is a buffer of zeros of the same shape."""
    height, width = grid.shape
    for y in range(height - narrow + 1):
        run = 0
        for x in range(width):
            column = 0
            while column < narrow and grid[y + column, x] == UNKNOWN:
                column += 1
            run = run + 1 if column == narrow else 0
            if run >= narrow:
                for row in range(y, y + narrow):
                    for left in range(x - narrow + 1, x + 1):
                        marks[row, left] = 1
    for y in range(height):
        for x in range(width):
            out[y, x] = grid[y, x]
            if grid[y, x] != UNKNOWN or marks[y, x]:
                marks[y, x] = 0
                continue
            out[y, x] = FREE
            for row in range(max(0, y - 1), min(height, y + 2)):
                for column in range(max(0, x - 1), min(width, x + 2)):
                    if grid[row, column] == OCCUPIED:
                        out[y, x] = OCCUPIED
