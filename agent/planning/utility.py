"""Utility of a frontier cell: the expected unknown area after teammates have reached their targets.

Thesis, section 4.4.2: the utility is 1, minus P(d) for each teammate's target at distance d in sight of the cell
(Eqs. 4.4 and 4.5).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from protocol.arrays import Cells, Floats, Int32s
from protocol.grid import OCCUPIED, Cell, Grid
from protocol.kernels import kernel


def utilities(
    grid: Grid,
    cells: Cells,
    targets: Sequence[Cell] | Cells,
    range_cells: ArrayLike,
    weights: Sequence[float] | Floats | None = None,
) -> Floats:
    """Return the utility of each of `cells` on a planning grid, shape (n,); occupied cells block the line of sight.

    `range_cells` has the sensor range of the teammate of each of the `targets`, scalar or shape (m,):
    P(d) = max(0, 1 - d / range). `weights` has the weight of each target, by default 1.
    """
    result = np.ones(len(cells))
    weighted = np.ones(len(targets)) if weights is None else np.asarray(weights, np.float64)
    ranges = np.full(len(targets), range_cells, np.float64)
    _lower(grid, cells, np.array(targets, np.int32).reshape(-1, 2), weighted, ranges, result)
    return result


def proximity(grid: Grid, cells: Cells, target: Int32s, range_cells: float) -> Floats:
    """Return P(d) of each of `cells` for one target, the amount by which it lowers their utilities, shape (n,)."""
    lowered = np.zeros(len(cells))
    _lower(grid, cells, target.reshape(1, 2), np.ones(1), np.array([range_cells]), lowered)
    return -lowered


def covers(grid: Grid, target: Cell, cell: Cell, range_cells: float) -> bool:
    """Return whether a robot at its target sees a cell: within sensor range, with no occupied cell between them."""
    (x, y), (to_x, to_y) = target, cell
    return (x - to_x) ** 2 + (y - to_y) ** 2 < range_cells**2 and in_sight(grid, x, y, to_x, to_y)


@kernel
def in_sight(grid: Grid, x0: int, y0: int, x1: int, y1: int) -> bool:
    """Return whether no occupied cell lies on the straight line between two cells."""
    # The line always begins at the same end, so that the result is symmetric.
    if (y1, x1) < (y0, x0):
        x0, y0, x1, y1 = x1, y1, x0, y0
    dx, dy = abs(x1 - x0), y1 - y0
    step = 1 if x1 > x0 else -1
    error = dx - dy
    while True:
        if grid[y0, x0] == OCCUPIED:
            return False
        if x0 == x1 and y0 == y1:
            return True
        double = 2 * error
        if double > -dy:
            error -= dy
            x0 += step
        if double < dx:
            error += dx
            y0 += 1


@kernel
def sees(grid: Grid, one: Int32s, other: Int32s, range_cells: float) -> float:
    """Return P(d) of two cells for each other, 0 if an obstacle lies between them; for kernels."""
    distance = np.sqrt(float((one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2))
    if distance < range_cells and in_sight(grid, one[0], one[1], other[0], other[1]):
        return float(1.0 - distance / range_cells)
    return 0.0


@kernel
def _lower(grid: Grid, cells: Cells, targets: Cells, weights: Floats, ranges: Floats, result: Floats) -> None:
    for target in range(len(targets)):
        for at in range(len(cells)):
            result[at] -= weights[target] * sees(grid, cells[at], targets[target], ranges[target])
