"""Straight walls in the copy of a map, as far as the bound allows: they take fewer bytes.

Noise moves parts of a wall by a cell, so its front has notches. A notch is a row or column of at most `LONGEST_NOTCH`
cells between two walls. Its cells become walls if each of them has a wall of the robot's own grid beside it,
perpendicular to the notch, and free space on the other side. So the copy stays within the bound (`agent.mapping.bound`)
with any tolerance of at least 1, and openings between two walls stay open.

Only cells that receivers do not know become walls, so no cell changes back and forth. Cells that the author does not
know stay unknown: behind a thin wall, there may be a passage of the next room.
"""

from __future__ import annotations

from protocol.arrays import Int64s
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

LONGEST_NOTCH = 3
"""Cells of the longest notch that is filled; longer ones save hardly any bytes."""

CLEARANCE = 4
"""Cells without a wall that remain in front of a filled notch: robots must still fit through narrow passages."""


@kernel
def _is(grid: Grid, state: int, x: int, y: int) -> bool:
    """Whether a cell has a state; cells outside the grid have none."""
    return bool(0 <= y < grid.shape[0] and 0 <= x < grid.shape[1] and grid[y, x] & 3 == state)


@kernel
def _is_clear(own: Grid, x: int, y: int, dx: int, dy: int) -> bool:
    """Whether the cell next to (x, y) in direction (`dx`, `dy`) is free, and the next `CLEARANCE` are no walls."""
    for place in range(1, CLEARANCE + 1):
        if _is(own, OCCUPIED, x + place * dx, y + place * dy):
            return False
    return _is(own, FREE, x + dx, y + dy)


@kernel
def _may_fill(own: Grid, held: Grid, target: Grid, x: int, y: int, dx: int, dy: int) -> bool:
    """Whether a cell of a notch in direction (`dx`, `dy`) may become a wall."""
    if held[y, x] & 3 != UNKNOWN or own[y, x] == UNKNOWN or target[y, x] == OCCUPIED:
        return False
    is_free = own[y, x] == FREE
    for side in (-1, 1):
        is_behind = _is(own, OCCUPIED, x + side * dy, y + side * dx)
        if is_behind and (not is_free or _is_clear(own, x, y, -side * dy, -side * dx)):
            return True
    return False


@kernel
def _is_notch(own: Grid, held: Grid, target: Grid, x: int, y: int, length: int, dx: int, dy: int) -> bool:
    """Whether so many cells from (x, y) on, in direction (`dx`, `dy`), lie between two walls and may become walls."""
    ends = _is(target, OCCUPIED, x - dx, y - dy) and _is(target, OCCUPIED, x + length * dx, y + length * dy)
    if not ends:
        return False
    place = 0
    while place < length and _may_fill(own, held, target, x + place * dx, y + place * dy, dx, dy):
        place += 1
    return place == length


@kernel
def fill_notches(own: Grid, held: Grid, target: Grid, box: Int64s) -> None:
    """Turn the cells of notches into walls, in a box of `target`.

    Parameters
    ----------
    own, held : uint8 array, shape (h, w)
        The robot's own grid, and the one that receivers hold.
    target : uint8 array, shape (h, w)
        The states that receivers shall hold, which are within the bound before and after.
    box : int64 array, shape (4,)
        First column and row, and those behind the last ones.
    """
    for direction in range(2):
        dx, dy = 1 - direction, direction
        for length in range(1, LONGEST_NOTCH + 1):
            for y in range(box[1], box[3] - (length - 1) * dy):
                for x in range(box[0], box[2] - (length - 1) * dx):
                    if _is_notch(own, held, target, x, y, length, dx, dy):
                        for place in range(length):
                            target[y + place * dy, x + place * dx] = OCCUPIED
