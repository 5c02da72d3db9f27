"""The value of a tile for the planning of teammates, and its approximate bytes.

Teammates plan with the maps that they have received. A tile with cells that are new to them saves them a drive there.
So does a tile that closes one of their frontiers: scans from afar leave gaps in walls, which later scans close. A tile
that only moves walls by a cell hardly changes their plans, but takes as many bytes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.mapping.bound import TILE, TileMask
from protocol.arrays import Floats
from protocol.grid import FREE, UNKNOWN, Grid
from protocol.kernels import kernel

FRONTIER_CELLS = 5
"""Value of a closed frontier cell, in new cells. Within a tolerance, a few walls close a long frontier."""

FREE_TILE_BYTES, OTHER_TILE_BYTES = 0.12, 2.0
"""Typical bytes of a tile that is new and free, and of any other one."""

OPEN_CELLS = 2
"""Most new frontier cells of a complete tile."""


@dataclass(frozen=True)
class TileValues:
    """What tiles are worth to teammates; all arrays have shape (tile rows, tile columns) and are 0 for other tiles."""

    cells: NDArray[np.float64]
    """New cells of each tile, and `FRONTIER_CELLS` for each frontier cell that it closes."""
    size: NDArray[np.float64]
    """Its approximate bytes in an update."""
    is_complete: TileMask
    """Whether few of its new cells are frontier cells: else, it will probably change soon."""


def tile_values(target: Grid, received: Grid, tiles: Grid) -> TileValues:
    """Rate tiles by the cells that teammates would learn from them.

    `target`, shape (h, w), has the states of the cells of these tiles in this robot's log, once they are sent;
    `received` those that all logs report, this robot's included. `tiles` are marks, uint8 of shape (tile rows, tile
    columns).
    """
    cells, size, opened = np.zeros(tiles.size), np.zeros(tiles.size), np.zeros(tiles.size)
    _rate(target, received, tiles, cells, size, opened)
    is_complete = opened.reshape(tiles.shape) <= OPEN_CELLS
    return TileValues(cells.reshape(tiles.shape), size.reshape(tiles.shape), is_complete & (tiles > 0))


@kernel
def _after(target: Grid, received: Grid, tiles: Grid, x: int, y: int) -> int:
    """Return the state of a cell that teammates know once they have received the marked tiles."""
    if tiles[y // TILE, x // TILE] and target[y, x] != UNKNOWN:
        return int(target[y, x])
    return int(received[y, x])


@kernel
def _is_frontier(target: Grid, received: Grid, tiles: Grid, x: int, y: int) -> bool:
    """Whether a cell is then a frontier cell: free, beside an unknown one."""
    if _after(target, received, tiles, x, y) != FREE:
        return False
    height, width = target.shape
    return bool(
        (x > 0 and _after(target, received, tiles, x - 1, y) == UNKNOWN)
        or (x + 1 < width and _after(target, received, tiles, x + 1, y) == UNKNOWN)
        or (y > 0 and _after(target, received, tiles, x, y - 1) == UNKNOWN)
        or (y + 1 < height and _after(target, received, tiles, x, y + 1) == UNKNOWN)
    )


@kernel
def _rate(target: Grid, received: Grid, tiles: Grid, cells: Floats, size: Floats, opened: Floats) -> None:
    """Write the value of each marked tile, its bytes, and the number of its new frontier cells."""
    rows, columns = tiles.shape
    height, width = target.shape
    nothing = np.zeros_like(tiles)
    for row in range(rows):
        for column in range(columns):
            if not tiles[row, column]:
                continue
            tile = row * columns + column
            new, closed, opens, is_free = 0, 0, 0, True
            for y in range(row * TILE, min(row * TILE + TILE, height)):
                for x in range(column * TILE, min(column * TILE + TILE, width)):
                    is_new = received[y, x] == UNKNOWN and target[y, x] != UNKNOWN
                    new += is_new
                    is_free = is_free and is_new and target[y, x] == FREE
                    now = _is_frontier(target, received, tiles, x, y)
                    opens += is_new and now
                    closed += not now and _is_frontier(target, received, nothing, x, y)
            cells[tile] = new + FRONTIER_CELLS * closed
            opened[tile] = opens
            size[tile] = FREE_TILE_BYTES if is_free else OTHER_TILE_BYTES
