"""Branch-and-bound search for the frontier cell of the best trade-off of utility and cost.

The thesis (section 4.4) chooses the cell t with the largest U(t) - beta V(t). Utilities are at most 1, and each
teammate's target can only lower them. So the targets counted so far give an upper bound for a cell, and 1 - beta V is
one for all cells that the search has not reached. The search always continues with the highest bound. The first cell
with all targets counted is the best one. It visits only near cells, and counts few targets for most of them.
"""

from __future__ import annotations

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np

from agent.planning.cost_field import (
    FRONTS,
    NO_BOUND,
    UNIT,
    Workspace,
    begin,
    settle,
    tidy,
    way_back,
    workspace,
)
from agent.planning.frontier import Floor, is_enclosed, is_frontier
from agent.planning.utility import in_sight
from protocol.arrays import Bools, Cells, Floats
from protocol.grid import Cell, Grid
from protocol.kernels import kernel


class TradeOff(NamedTuple):
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


_TradeOff = tuple[Cells, Floats, Floats, float, float]


def best_frontier(floor: Floor, grid: Grid, x: int, y: int, trade_off: TradeOff) -> tuple[Cell, Cells] | None:
    """Find the frontier cell of the largest U - beta V among those that can be reached from (x, y).

    The result equals that of `agent.planning.utility.utilities` and `agent.planning.cost_field.costs` for all cells. Of
    equal cells the first counts, row by row. `grid` is the planning grid, `floor` the cells that the robot may enter.

    Returns the cell (x, y) and a shortest way to it, without the start; None if no frontier cell is reachable.
    """
    work = workspace(len(floor.free))
    cell, way = _search(floor.free, work, grid, floor.at(x, y), (*trade_off,))
    return None if cell < 0 else ((cell % floor.stride - 1, cell // floor.stride - 1), way)


@kernel
def _search(free: Bools, work: Workspace, grid: Grid, start: int, trade_off: _TradeOff) -> tuple[int, Cells]:
    targets, weights, ranges, scale, beta = trade_off
    length, _, settled = work
    stride, number = grid.shape[1] + 2, len(targets)
    search, fronts = begin(free, work, stride, start)
    fill, level, checked = search[2], 1, 0
    # Robots often drive to the same target: each counts as the first one that is equal.
    same = np.arange(number)
    for target in range(number):
        for other in range(target):
            dx, dy = targets[target, 0] - targets[other, 0], targets[target, 1] - targets[other, 1]
            if dx == 0 and dy == 0 and ranges[target] == ranges[other]:
                same[target] = other
                break
    # P(d) of each queued cell, in the order of queueing, and of each target, as far as it was counted.
    counted_p = np.empty((64, number))
    queued = 0
    # Entries: negative bound, cell, number of counted targets, utility after these, row of `counted_p`.
    queue = [(0.0, settled[0], 0, 0.0, 0)]
    queue.clear()
    best_cell = -1
    while best_cell < 0:
        for at in range(checked, fill[FRONTS]):
            cell = settled[at]
            if not is_enclosed(free, cell, stride) and is_frontier(
                grid, cell % stride - 1, cell // stride - 1
            ):
                cost = beta * (length[cell] * UNIT / scale)
                heappush(queue, (cost - 1.0, cell, 0, 1.0, queued))
                queued += 1
        checked = fill[FRONTS]
        if fill[:FRONTS].any() and (len(queue) == 0 or -queue[0][0] <= 1.0 - beta * (level / scale)):
            fronts = settle(search, fronts, level, NO_BOUND)
            level += 1
            continue
        if len(queue) == 0:
            break
        if queued > len(counted_p):
            more = np.empty((2 * queued, number))
            more[: len(counted_p)] = counted_p
            counted_p = more
        first, cell, counted, utility, row = heappop(queue)
        if counted == number:
            best_cell = cell
            continue
        x, y = cell % stride - 1, cell // stride - 1
        cost = beta * (length[cell] * UNIT / scale)
        second = max(queue[0][0], first) if queue else first
        while counted < number and cost - utility <= second:
            lowered = 0.0
            if same[counted] < counted:
                lowered = counted_p[row, same[counted]]
            else:
                tx, ty = targets[counted, 0], targets[counted, 1]
                distance = np.sqrt(float((x - tx) ** 2 + (y - ty) ** 2))
                if distance < ranges[counted] and in_sight(grid, x, y, tx, ty):
                    lowered = 1.0 - distance / ranges[counted]
                counted_p[row, counted] = lowered
            utility -= weights[counted] * lowered
            counted += 1
        heappush(queue, (cost - utility, cell, counted, utility, row))
    cells = way_back(search, best_cell)
    tidy(search, fronts)
    return best_cell, cells
