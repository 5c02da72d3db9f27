"""P(d) as learned from measured distances (Burgard et al. 2005, section II-B).

P(d) is the probability that a robot's sensor will cover a cell at distance d from its target. The paper estimates it
"by maintaining a posterior about the estimated distances to be measured", which is updated "while the robot moves".
Here it is the share of all beams so far that reached at least d. The beams are cast over the planning grid. So robots
with the same map and the same beliefs about where their teammates are learn the same P(d), without a message.
"""

from __future__ import annotations

import math

import numpy as np

from agent.planning.utility import in_sight
from protocol.arrays import Cells, Floats, Int32Rows, Int32s, Int64s
from protocol.grid import OCCUPIED, UNKNOWN, Cell, Grid, ray_table
from protocol.kernels import kernel


class MeasuredDistances:
    """The distances that a team's lasers have measured; `longest` is the longest sensor range in cells."""

    def __init__(self, longest: float, beams: int) -> None:
        self._beams = beams
        self._counts = np.zeros(math.ceil(longest) + 1, np.int64)
        """Beams by the whole part of their length in cells; those without a hit count at the last place."""

    def add(self, grid: Grid, cell: Cell, range_cells: float) -> None:
        """Cast the beams of a robot in a cell; beams that end in unknown cells do not count."""
        table = ray_table(range_cells, self._beams)
        _cast(grid, cell[0], cell[1], table.cells, table.start, self._counts)

    def shares(self) -> Floats:
        """Return the share of beams that reached at least 0, 1, 2, ... cells, shape (n,); 1 to 0 without any beam."""
        if not self._counts.any():
            return np.linspace(1.0, 0.0, len(self._counts))
        reached: Floats = np.cumsum(self._counts[::-1])[::-1] / self._counts.sum()
        return reached

    def proximity(self, grid: Grid, cells: Cells, target: Int32s, range_cells: float) -> Floats:
        """Return P(d) of each of `cells` for a target, 0 beyond the range or behind an obstacle, shape (n,).

        P between whole distances is interpolated. The parameters are those of `agent.planning.utility.proximity`.
        """
        found: Floats = _look_up(grid, cells, target, range_cells, self.shares())
        return found


@kernel
def _cast(grid: Grid, x: int, y: int, cells: Int32Rows, start: Int32s, counts: Int64s) -> None:
    height, width = grid.shape
    for beam in range(len(start) - 1):
        length = len(counts) - 1
        for at in range(start[beam], start[beam + 1]):
            dx, dy = cells[at, 0], cells[at, 1]
            if not (0 <= x + dx < width and 0 <= y + dy < height) or grid[y + dy, x + dx] == UNKNOWN:
                length = -1
                break
            if grid[y + dy, x + dx] == OCCUPIED:
                length = min(length, int(np.sqrt(float(dx * dx + dy * dy))))
                break
        if length >= 0:
            counts[length] += 1


@kernel
def _look_up(grid: Grid, cells: Cells, target: Int32s, range_cells: float, shares: Floats) -> Floats:
    found = np.zeros(len(cells))
    for at in range(len(cells)):
        x, y = cells[at]
        distance = np.sqrt(float((x - target[0]) ** 2 + (y - target[1]) ** 2))
        if distance < range_cells and in_sight(grid, x, y, target[0], target[1]):
            below = int(distance)
            above = min(below + 1, len(shares) - 1)
            found[at] = shares[below] + (distance - below) * (shares[above] - shares[below])
    return found
