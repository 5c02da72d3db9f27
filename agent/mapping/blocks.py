"""Blocks of 2 by 2 cells, the unit of copies at half resolution (`agent.mapping.block_bound`).

The cells of a block are at most one cell apart (Chebyshev distance). So with a tolerance of 1 or more, a block that is
a wall may stand for a wall in any one of its cells.
"""

from __future__ import annotations

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

BLOCK = 2
"""Side of a block in cells."""


@kernel
def block_state(grid: Grid, x: int, y: int) -> int:
    """Return the state of a block, given in blocks: a wall if any of its cells is one, else free if any cell is.

    Cells outside the grid are unknown.
    """
    found = int(UNKNOWN)
    for row in range(max(0, BLOCK * y), min(BLOCK * y + BLOCK, grid.shape[0])):
        for column in range(max(0, BLOCK * x), min(BLOCK * x + BLOCK, grid.shape[1])):
            if grid[row, column] & 3 == OCCUPIED:
                return int(OCCUPIED)
            if grid[row, column] & 3 == FREE:
                found = int(FREE)
    return found


@kernel
def _is_opened(own: Grid, held: Grid, x: int, y: int, dx: int, dy: int) -> bool:
    """Whether a wall that ends in the wall of the copy beside it, at (`dx`, `dy`), continues that wall.

    Then there is free space beside both of them, and a gap would open between (x, y) and the next wall.
    """
    height, width = own.shape
    for side in (-1, 1):
        row, column = y + side * dx, x + side * dy
        if not (0 <= row < height and 0 <= column < width):
            continue
        if own[row, column] == FREE and held[row, column] & 3 != OCCUPIED:
            behind = row + dy, column + dx
            if own[behind] != OCCUPIED and held[behind] & 3 != OCCUPIED:
                return True
    return False


@kernel
def is_covered(own: Grid, held: Grid, x: int, y: int) -> bool:
    """Whether a wall of the copy lies directly before or behind a wall of the robot's own grid.

    The next cell along a wall does not count: receivers would see a gap.
    """
    height, width = own.shape
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        inside = 0 <= y + dy < height and 0 <= x + dx < width
        is_wall = inside and held[y + dy, x + dx] & 3 == OCCUPIED
        if is_wall and not _is_opened(own, held, x, y, dx, dy):
            return True
    return False
