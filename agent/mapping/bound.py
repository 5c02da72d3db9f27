"""The bounded error of a shared map: change as little of the grid that receivers hold as a tolerance of one cell needs.

Distances are Chebyshev distances in cells; a cell is settled if its log odds are certain (`SETTLED`). After an update

1. every settled wall has a held wall within the tolerance,
2. every held wall on a cell that is settled as free has a wall of the robot's own grid within the tolerance,
3. every settled free cell is held as free, or has a held wall within the tolerance.

Unknown cells of tiles that change anyway are filled with less certain states (`FILL`): this costs little, and saves a
later update.
"""

from __future__ import annotations

import numpy as np

from agent.mapping.estimator import SETTLED, Int8Grid
from protocol.boxes import Box
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

TILE = 8
"""Side of a tile in cells; the sides of grids are multiples of it."""

TOLERANCE = 1
"""Cells between a wall and its copy at most."""

FILL = 9
"""Absolute log odds from which a cell of a changed tile is sent if its state is unknown to the receivers."""

_REMOVE, _WALLS, _FREE, _FILL = range(4)
"""Phases, in this order: remove walls that the robot has not found (2), add walls (1), add free cells (3), also those
that have lost their wall, fill the changed tiles. A removed wall is never the only copy of a settled wall, because it
has no wall of the robot's own grid within the tolerance."""

_REACH = 2 * TOLERANCE
"""A change may remove a held wall within the tolerance, on which an unknown cell as far from it relied (3)."""


def mark_tiles(tiles: Grid, box: Box) -> None:
    """Mark the tiles in which changes in a box (x0, y0, x1, y1) may violate the bound."""
    x0, y0, x1, y1 = box
    rows = slice(max(0, y0 - _REACH) // TILE, (y1 + _REACH - 1) // TILE + 1)
    tiles[rows, max(0, x0 - _REACH) // TILE : (x1 + _REACH - 1) // TILE + 1] = 1


@kernel
def _has_wall(grid: Grid, x: int, y: int) -> bool:
    """Whether there is a wall within the tolerance of a cell."""
    for row in range(max(0, y - TOLERANCE), min(grid.shape[0], y + TOLERANCE + 1)):
        for column in range(max(0, x - TOLERANCE), min(grid.shape[1], x + TOLERANCE + 1)):
            if grid[row, column] & 3 == OCCUPIED:
                return True
    return False


@kernel
def _violates(phase: int, own: Grid, log_odds: Int8Grid, target: Grid, x: int, y: int) -> bool:
    """Whether a cell must take the robot's own state in a phase."""
    state, certain = own[y, x], abs(np.int64(log_odds[y, x]))
    if certain < (FILL if phase == _FILL else SETTLED):
        return False
    if phase == _REMOVE:
        return bool(state == FREE and target[y, x] == OCCUPIED and not _has_wall(own, x, y))
    if phase == _WALLS:
        return bool(state == OCCUPIED and not _has_wall(target, x, y))
    if phase == _FREE:
        return bool(state == FREE and target[y, x] == UNKNOWN and not _has_wall(target, x, y))
    return bool(target[y, x] == UNKNOWN)


@kernel
def apply_bound(own: Grid, log_odds: Int8Grid, held: Grid, tiles: Grid, target: Grid, changed: Grid) -> int:
    """Compute the states that receivers shall hold, in the marked tiles; return the number of tiles that change.

    Parameters
    ----------
    own, log_odds : arrays, shape (h, w)
        States and log odds of the robot's estimator.
    held : uint8 array, shape (h, w)
        The grid that receivers hold; states are in the low two bits.
    tiles : uint8 array, shape (h / TILE, w / TILE)
        Marks of tiles whose cells changed in `own` or `held` since they fulfilled the bound (`mark_tiles`).
    target, changed : uint8 arrays
        Results: states of all cells, and 1 for tiles in which they differ from the held ones.
    """
    for y in range(held.shape[0]):
        for x in range(held.shape[1]):
            target[y, x] = held[y, x] & 3
    changed[:] = 0
    count = 0
    for phase in (_REMOVE, _WALLS, _FREE, _FILL):
        for tile_y in range(tiles.shape[0]):
            for tile_x in range(tiles.shape[1]):
                if not tiles[tile_y, tile_x] or (phase == _FILL and not changed[tile_y, tile_x]):
                    continue
                before = changed[tile_y, tile_x]
                for y in range(tile_y * TILE, tile_y * TILE + TILE):
                    for x in range(tile_x * TILE, tile_x * TILE + TILE):
                        if own[y, x] == UNKNOWN or own[y, x] == target[y, x]:
                            continue
                        if _violates(phase, own, log_odds, target, x, y):
                            target[y, x] = own[y, x]
                            changed[tile_y, tile_x] = 1
                count += changed[tile_y, tile_x] - before
    return count
