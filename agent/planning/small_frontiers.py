"""Frontiers that robots leave unexplored because they are small (the setting `min_frontier_size`).

Most of them border a few cells that were hidden behind a corner. Explorers of ROS have such a threshold, too.
"""

from __future__ import annotations

import numpy as np

from agent.planning.candidates import components
from agent.planning.frontier import frontier_cells
from protocol.arrays import Cells
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel


def without_small_frontiers(grid: Grid, min_cells: float) -> Grid:
    """Return a planning grid, uint8 of shape (h, w), with walls in the unknown cells beside each small frontier.

    A frontier is small if its size is below `min_cells` cells. Its size is the longer side of the box around its cells,
    which are 8-connected. Returns `grid` itself if no frontier is small, else a copy.
    """
    cells = frontier_cells(grid, grid == FREE)
    if not len(cells):
        return grid
    cells, counts = components(cells)
    first = np.cumsum(counts) - counts
    size = (np.maximum.reduceat(cells, first) - np.minimum.reduceat(cells, first)).max(axis=1) + 1
    small = cells[np.repeat(size < min_cells, counts)]
    if not len(small):
        return grid
    closed = grid.copy()
    _close(closed, small)
    return closed


@kernel
def close_beside(grid: Grid, x: int, y: int) -> None:
    """Turn the unknown 4-neighbors of a cell into walls."""
    for row, column in ((y, x - 1), (y, x + 1), (y - 1, x), (y + 1, x)):
        if 0 <= row < grid.shape[0] and 0 <= column < grid.shape[1] and grid[row, column] == UNKNOWN:
            grid[row, column] = OCCUPIED


@kernel
def _close(grid: Grid, cells: Cells) -> None:
    for number in range(len(cells)):
        close_beside(grid, cells[number, 0], cells[number, 1])
