"""The planning grid of a noisy laser, without details that a robot could not explore anyway.

Between beams and beside walls, noise leaves gaps of unknown cells. They are no frontiers: a robot has nothing to enter
there. So an unknown cell counts only if it lies in a square of `NARROW` by `NARROW` unknown cells. Every other one
counts as a wall if a wall touches it, else as free.
"""

from __future__ import annotations

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

NARROW = 2
"""Side of the smallest square of unknown cells that is worth exploring, in cells."""


@kernel
def without_gaps(grid: Grid, narrow: int, marks: Grid, out: Grid) -> None:
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
