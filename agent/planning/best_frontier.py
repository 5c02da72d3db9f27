"""Branch-and-bound search for the frontier cell of the best trade-off of utility and cost.

The thesis (section 4.4) chooses the cell t with the largest U(t) - beta V(t). Utilities are at most 1, and each
teammate's target can only lower them. So the targets counted so far give an upper bound for a cell, and 1 - beta V is
one for all cells that the search has not reached. The search always continues with the highest bound. The first cell
with all targets counted is the best one. It visits only near cells, and counts few targets for most of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np

from agent.planning.cost_field import (
    NO_BOUND,
    SHIFT,
    UNIT,
    Workspace,
    begin,
    offsets,
    settle,
    tidy,
    way_back,
    workspace,
)
from agent.planning.frontier import Floor, is_enclosed, is_frontier
from agent.planning.utility import sees
from protocol.arrays import Bools, Cells, Floats
from protocol.grid import Grid
from protocol.kernels import kernel


@dataclass(frozen=True)
class TradeOff:
    """Parameters of the trade-off."""

    targets: Cells
    """Cells to which teammates drive."""
    weights: Floats
    """Weight of each target, 0 or more, shape (n,)."""
    ranges: Floats
    """Sensor range of each of them in cells, shape (n,); utilities around its target are lowered within it."""
    scale: float
    """Sensor range that is the unit of V, in cells."""
    beta: float
    """Weight of cost against utility, 0 or more."""


def best_frontier(
    floor: Floor, grid: Grid, x: int, y: int, trade_off: TradeOff
) -> tuple[tuple[int, int], Cells] | None:
    """Find the frontier cell of the largest U - beta V among those that can be reached from (x, y).

    The result equals that of `agent.planning.utility.utilities` and `agent.planning.cost_field.costs` for all cells. Of
    equal cells the first counts, row by row. `grid` is the planning grid, `floor` the cells that the robot may enter.

    Returns the cell (x, y) and a shortest way to it, without the start; None if no frontier cell is reachable.
    """
    work = workspace(len(floor.free))
    counted = trade_off.targets, trade_off.weights, trade_off.ranges
    cell, way = _search(floor.free, grid, floor.at(x, y), *counted, trade_off.scale, trade_off.beta, work)
    return None if cell < 0 else ((cell % floor.stride - 1, cell // floor.stride - 1), way)


@kernel
def _search(
    free: Bools,
    grid: Grid,
    start: int,
    targets: Cells,
    weights: Floats,
    ranges: Floats,
    scale: float,
    beta: float,
    work: Workspace,
) -> tuple[int, Cells]:
    stride = grid.shape[1] + 2
    length = work[0]
    fill = np.empty(5, np.int64)
    buckets = begin(work, fill, start)
    offset = offsets(1, stride)
    here = np.empty(2, np.int32)
    # Entries: negative bound, cell, number of counted targets, utility after these.
    queue = [(0.0, buckets[0, 0], 0, 0.0)]
    queue.clear()
    level = 0
    best_cell = -1
    while best_cell < 0:
        if fill[:4].any() and (len(queue) == 0 or -queue[0][0] <= 1.0 - beta * (level / scale)):
            buckets = settle(free, work, buckets, fill, offset, level, start, NO_BOUND)
            for at in range(fill[level & 3]):
                cell = buckets[level & 3, at]
                if length[cell] >> SHIFT != level or is_enclosed(free, cell, stride):
                    continue
                if is_frontier(grid, cell % stride - 1, cell // stride - 1):
                    cost = beta * (length[cell] * UNIT / scale)
                    heappush(queue, (cost - 1.0, cell, 0, 1.0))
            fill[level & 3] = 0
            level += 1
            continue
        if len(queue) == 0:
            break
        _, cell, counted, utility = heappop(queue)
        if counted == len(targets):
            best_cell = cell
            continue
        here[0], here[1] = cell % stride - 1, cell // stride - 1
        before = utility
        while counted < len(targets) and utility == before:
            utility -= weights[counted] * sees(grid, here, targets[counted], ranges[counted])
            counted += 1
        cost = beta * (length[cell] * UNIT / scale)
        heappush(queue, (cost - utility, cell, counted, utility))
    cells = way_back(free, length, offset, best_cell) if best_cell >= 0 else np.empty((0, 2), np.int32)
    tidy(work, fill)
    return best_cell, cells
