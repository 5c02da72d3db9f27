"""Costs of ways from some cells to some goals, by jump point search (after Harabor and Grastien 2011).

A search for the costs of goals alone can skip most cells. Of the equally long ways to a cell the one with its diagonal
steps first suffices (`agent.planning.cost_field`). So a straight run can turn only at a *jump point*, where an obstacle
beside it has just ended. The distance to the next jump point or goal is computed in advance for all cells and the four
straight directions, once for all searches on a floor. A search then walks along diagonals and jumps along rows and
columns, in the order of Dijkstra's algorithm. Lengths are the integers of `agent.planning.cost_field`, so the costs
are the same bits.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from agent.planning.cost_field import ONE, ROOT, SHIFT, UNIT, offsets
from agent.planning.frontier import Floor
from protocol.arrays import BoolRows, Bools, Cells, FloatRows, Floats, Int64Rows, Int64s, Uint8s
from protocol.kernels import kernel

_Jumps = Annotated[NDArray[np.int16], "int16[:,:,::1]"]

_BEGIN = 8
"""Step number of the start of a search."""


def costs_between(floor: Floor, starts: Cells, goals: Cells) -> FloatRows:
    """Return the length of the shortest way from each start to each goal, shape (m, n), infinite without one."""
    return _found(floor, starts, goals, np.zeros(len(starts), np.int64))


def costs_among(floor: Floor, starts: Cells, goals: Cells) -> tuple[FloatRows, FloatRows]:
    """Return `costs_between` starts and goals, and between all pairs of goals, which are free cells.

    Lengths are symmetric, so each pair of goals is searched once. The outermost goals are searched first, as the
    remaining goals are then close together.
    """
    if not len(goals):
        return np.empty((len(starts), 0)), np.empty((0, 0))
    off = ((goals - goals.sum(axis=0) / len(goals)) ** 2).sum(axis=1)
    order = np.argsort(-off, kind="stable")
    ordered = goals[order]
    row = np.arange(len(starts) + len(goals))
    costs = _found(floor, np.concatenate([starts, ordered]), ordered, np.maximum(row - len(starts), 0))
    back = np.argsort(order)
    ways, between = costs[: len(starts), back], costs[len(starts) :]
    searched = np.minimum.outer(back, back), np.maximum.outer(back, back)
    return np.ascontiguousarray(ways), between[searched]


class GoalCosts:
    """Costs of ways to the goals of one floor, each searched on first use: teams share most of their robots."""

    def __init__(self, goals: Cells) -> None:
        self.goals = goals
        self._ways: dict[tuple[int, ...], Floats] = {}
        """The costs of the ways from each start to all goals."""
        self._between: FloatRows | None = None

    def ways(self, floor: Floor, starts: Cells) -> FloatRows:
        """Return `costs_between` of these starts and the goals."""
        cells = list(map(tuple, starts.tolist()))
        new = [cell for cell in dict.fromkeys(cells) if cell not in self._ways]
        if new:
            costs = costs_between(floor, np.array(new, np.int32), self.goals)
            self._ways |= zip(new, costs, strict=True)
        return np.array([self._ways[cell] for cell in cells]).reshape(len(cells), len(self.goals))

    def among(self, floor: Floor, starts: Cells) -> tuple[FloatRows, FloatRows]:
        """Return `costs_among` of these starts and the goals; callers must not modify the costs between goals."""
        if self._between is None:
            ways, self._between = costs_among(floor, starts, self.goals)
            self._ways |= zip(map(tuple, starts.tolist()), ways, strict=True)
        return self.ways(floor, starts), self._between


def _found(floor: Floor, starts: Cells, goals: Cells, first: Int64s) -> FloatRows:
    """Return the length of the shortest way from each start to each goal with an index of at least its `first`."""
    free, left, top = _cropped(floor, np.concatenate([starts, goals]))
    height, stride = free.shape
    start, goal = (
        (cells[:, 1].astype(np.int64) + (1 - top)) * stride + cells[:, 0] + (1 - left)
        for cells in (starts, goals)
    )
    is_goal = np.zeros(free.size, np.bool_)
    is_goal[goal] = True
    costs = np.empty((len(starts), len(goals)))
    jumps, length, came = _workspace(len(floor.free))
    runs = jumps[: 4 * free.size].reshape(4, height, stride)
    _search(
        free.reshape(-1), is_goal, runs, start, goal, first, length[: free.size], came[: free.size], costs
    )
    return costs


def _cropped(floor: Floor, cells: Cells) -> tuple[BoolRows, int, int]:
    """Return the part of a floor, rim included, that contains all free cells and `cells`; and its left and top."""
    free = floor.free.reshape(floor.height + 2, floor.stride)
    rows, columns = (np.flatnonzero(free.any(axis=axis)) - 1 for axis in (1, 0))
    x = np.concatenate([cells[:, 0], columns[:1], columns[-1:]])
    y = np.concatenate([cells[:, 1], rows[:1], rows[-1:]])
    left, top = int(x.min()), int(y.min())
    part = free[top : int(y.max()) + 3, left : int(x.max()) + 3]
    return np.ascontiguousarray(part), left, top


@lru_cache(maxsize=1)
def _workspace(cells: int) -> tuple[NDArray[np.int16], Int64s, Uint8s]:
    """Return the working memory that all searches on floors of one size share: jumps, lengths, arrival steps.

    Each search initializes the part that it uses.
    """
    return np.empty(4 * cells, np.int16), np.empty(cells, np.int64), np.empty(cells, np.uint8)


@kernel
def _lay_out(free: BoolRows, is_goal: BoolRows, jumps: _Jumps) -> None:
    """Compute the number of steps from each cell to the next jump point or goal in each direction; 0 for none.

    A run may turn at a cell beside which a free cell follows an obstacle. Directions 0 and 2 are +x and -x, 1 and 3 are
    +y and -y.
    """
    height, width = free.shape
    # No run leaves the floor.
    jumps[0, :, width - 2] = jumps[1, height - 2, :] = jumps[2, :, 1] = jumps[3, 1, :] = 0
    stop = np.zeros(width, np.bool_)
    for y in range(1, height - 1):
        for way in (1, -1):
            for x in range(1, width - 1):
                above = free[y - 1, x] & ~free[y - 1, x - way]
                below = free[y + 1, x] & ~free[y + 1, x - way]
                stop[x] = is_goal[y, x] | above | below
            jump = jumps[1 - way, y]
            ahead = 0
            for index in range(1, width - 1):
                x = width - 1 - index if way > 0 else index
                ahead = (x if stop[x] else ahead) if free[y, x] else 0
                jump[x - way] = way * (ahead - x) + 1 if ahead else 0
    for index in range(1, height - 1):
        for way in (1, -1):
            y = height - 1 - index if way > 0 else index
            for x in range(1, width - 1):
                left = free[y, x - 1] & ~free[y - way, x - 1]
                right = free[y, x + 1] & ~free[y - way, x + 1]
                ahead = jumps[2 - way, y, x]
                jump = np.int16(1) if is_goal[y, x] | left | right else ahead + np.int16(ahead > 0)
                jumps[2 - way, y - way, x] = jump if free[y, x] else np.int16(0)


@kernel
def _onward(free: Bools, offset: Int64s, cell: int, step: int) -> int:
    """Return the successor steps, as bits, of a cell reached by a straight step: straight on, and around obstacles."""
    if step == _BEGIN:
        return 255
    onward = 1 << step
    for turn in (1, 3):
        side = (step + turn) & 3
        if free[cell + offset[side]] and not free[cell - offset[step] + offset[side]]:
            onward |= 1 << side | 1 << 4 + (step if turn == 1 else side)
    return onward


@kernel
def _reach(cell: int, new: int, step: int, length: Int64s, came: Uint8s) -> bool:
    """Record an arrival at a cell; return whether it is shorter than before, or equally short by a new step.

    `came` has the arrival steps of the shortest ways so far, as bits; without any bit the cell has no length.
    """
    if came[cell]:
        if new > length[cell] or (new == length[cell] and came[cell] >> step & 1):
            return False
        if new < length[cell]:
            came[cell] = 0
    length[cell] = new
    came[cell] |= 1 << step
    return True


@kernel
def _queue_up(
    cell: int, new: int, step: int, length: Int64s, came: Uint8s, buckets: Int64s, queue: Int64Rows, used: int
) -> int:
    """Queue a jump point if its arrival is new; return the length of the queue."""
    if _reach(cell, new, step, length, came):
        bucket = (new >> SHIFT) & (len(buckets) - 1)
        queue[used, 0], queue[used, 1], queue[used, 2] = cell, step, buckets[bucket]
        buckets[bucket] = used
        used += 1
    return used


@kernel
def _search(
    free: Bools,
    is_goal: Bools,
    laid_out: _Jumps,
    starts: Int64s,
    goals: Int64s,
    first: Int64s,
    length: Int64s,
    came: Uint8s,
    costs: FloatRows,
) -> None:
    """Settle jump points in buckets of width 1, until all goals of a start from its `first` on are settled.

    The queue has rows (cell, arrival step, next entry of the same bucket).
    """
    _, height, stride = laid_out.shape
    _lay_out(free.reshape(height, stride), is_goal.reshape(height, stride), laid_out)
    jumps = laid_out.reshape(4, height * stride)
    offset = offsets(stride)
    # A power of two, with more levels than the longest diagonal with a straight run at its end.
    levels = 1
    while levels < 2 * (height + stride):
        levels *= 2
    buckets = np.empty(levels, np.int64)
    queue = np.empty((1024, 3), np.int64)
    for row in range(len(starts)):
        came[:] = 0
        buckets[:] = -1
        length[starts[row]], came[starts[row]] = 0, 255
        queue[0, 0], queue[0, 1], queue[0, 2] = starts[row], _BEGIN, -1
        buckets[0] = 0
        used, done, level, reached = 1, 0, 0, first[row]
        while done < used and reached < len(goals):
            entry = buckets[level & (levels - 1)]
            buckets[level & (levels - 1)] = -1
            while entry >= 0:
                cell, step, entry = queue[entry]
                done += 1
                base = length[cell]
                if base >> SHIFT != level:
                    continue  # reached on a shorter way since
                if used + 8 * (height + stride) > len(queue):
                    longer = np.empty((2 * used + 8 * (height + stride), 3), np.int64)
                    longer[:used] = queue[:used]
                    queue = longer
                onward = _onward(free, offset, cell, step)
                for number in range(4):
                    jump = jumps[number, cell]
                    if jump and onward >> number & 1:
                        to, new = cell + jump * offset[number], base + jump * ONE
                        used = _queue_up(to, new, number, length, came, buckets, queue, used)
                for number in range(4, 8):
                    if not onward >> number & 1:
                        continue
                    one, other = number - 4, (number - 3) & 3
                    at, so_far = cell, base
                    while free[at + offset[one]] and free[at + offset[other]] and free[at + offset[number]]:
                        at += offset[number]
                        so_far += ROOT
                        if not _reach(at, so_far, number, length, came):
                            break
                        for side in (one, other):
                            jump = jumps[side, at]
                            if jump:
                                to, new = at + jump * offset[side], so_far + jump * ONE
                                used = _queue_up(to, new, side, length, came, buckets, queue, used)
            # Goals are checked in their order; a far goal delays the check of later ones.
            while reached < len(goals) and came[goals[reached]] and length[goals[reached]] >> SHIFT <= level:
                reached += 1
            level += 1
        for number in range(first[row], len(goals)):
            costs[row, number] = length[goals[number]] * UNIT if came[goals[number]] else np.inf
