"""Costs of ways from some cells to some goals, by jump point search (after Harabor and Grastien 2011).

A search for the costs of goals alone can skip most cells. Of the equally long ways to a cell the one with its diagonal
steps first suffices (`agent.planning.cost_field`). So a straight run can turn only at a *jump point*, where an obstacle
beside it has just ended. The distance to the next jump point or goal is computed in advance for all cells and the four
straight directions, once for all searches on a floor with the same goals. A search then walks along diagonals and jumps
along rows and columns, in the order of Dijkstra's algorithm. Lengths are the integers of `agent.planning.cost_field`,
so the costs are the same bits.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from agent.planning.cost_field import ONE, ROOT, SHIFT, UNIT, offsets
from agent.planning.frontier import Floor
from protocol.arrays import BoolRows, Bools, Cells, FloatRows, Int16s, Int64Rows, Int64s, Uint8s
from protocol.kernels import kernel

_Jumps = Annotated[NDArray[np.int16], "int16[:,::1]"]
"""Steps from each cell to the next jump point or goal, by direction: +x, +y, -x, -y; 0 for none. Cells are numbered row
by row for the vertical directions, and column by column for the horizontal ones."""

_BEGIN = 8
"""Step number of the start of a search."""


def costs_between(floor: Floor, starts: Cells, goals: Cells) -> FloatRows:
    """Return the length of the shortest way from each start to each goal, shape (m, n), infinite without one."""
    return GoalCosts(goals).search(floor, starts, goals, np.zeros(len(starts), np.int64))


class GoalCosts:
    """Costs of ways to the goals of one floor, each searched on first use: teams share most of their robots."""

    def __init__(self, goals: Cells) -> None:
        self.goals = goals
        self._rows: dict[int, int] = {}
        """The row of each start in `_ways`, by `_keys`."""
        self._ways: FloatRows = np.empty((0, len(goals)))
        """The costs of the ways from each start to all goals."""
        self._between: FloatRows | None = None

    def ways(self, floor: Floor, starts: Cells) -> FloatRows:
        """Return `costs_between` of these starts and the goals."""
        keys, rows = _keys(starts), self._rows
        new = {key: at for at, key in enumerate(keys) if key not in rows}
        if new:
            cells = starts[list(new.values())]
            self._add(list(new), self.search(floor, cells, self.goals, np.zeros(len(cells), np.int64)))
        return self._ways.take(np.fromiter(map(rows.__getitem__, keys), np.intp, len(keys)), axis=0)

    def among(self, floor: Floor, starts: Cells) -> tuple[FloatRows, FloatRows]:
        """Return `costs_between` these starts and the goals, and between all pairs of goals, which are free cells.

        Callers must not modify the costs between goals.
        """
        if self._between is None:
            new = {key: at for at, key in enumerate(_keys(starts))}
            ways, self._between = self._search_among(floor, starts[list(new.values())])
            self._rows, self._ways = {}, self._ways[:0]
            self._add(list(new), ways)
        return self.ways(floor, starts), self._between

    def _add(self, keys: list[int], ways: FloatRows) -> None:
        """Add the costs of the ways from new starts, given by their keys, to all goals."""
        self._rows.update(zip(keys, range(len(self._rows), len(self._rows) + len(keys)), strict=True))
        self._ways = np.concatenate([self._ways, ways])

    def _search_among(self, floor: Floor, starts: Cells) -> tuple[FloatRows, FloatRows]:
        """Search the costs that `among` returns.

        Lengths are symmetric, so each pair of goals is searched once. The outermost goals are searched first, as the
        remaining goals are then close together.
        """
        goals = self.goals
        if not len(goals):
            return np.empty((len(starts), 0)), np.empty((0, 0))
        off = ((goals - goals.sum(axis=0) / len(goals)) ** 2).sum(axis=1)
        order = np.argsort(-off, kind="stable")
        ordered = goals[order]
        row = np.arange(len(starts) + len(goals))
        costs = self.search(
            floor, np.concatenate([starts, ordered]), ordered, np.maximum(row - len(starts), 0)
        )
        back = np.argsort(order)
        ways, between = costs[: len(starts), back], costs[len(starts) :]
        searched = np.minimum.outer(back, back), np.maximum.outer(back, back)
        return np.ascontiguousarray(ways), between[searched]

    def search(self, floor: Floor, starts: Cells, goals: Cells, first: Int64s) -> FloatRows:
        """Search the length of the shortest way from each start to each goal with an index of at least its `first`.

        `goals` are the goals of this object in any order. Returns an array of shape (m, n).
        """
        if not len(starts) or not len(goals):
            return np.empty((len(starts), len(goals)))
        return _workspace(len(floor.free)).jump_points(floor, self).search(starts, goals, first)


def _keys(cells: Cells) -> list[int]:
    """Return a number for each cell, equal for equal cells."""
    keys: list[int] = cells.view(np.int64).ravel().tolist()
    return keys


class _JumpPoints:
    """The jump points of a floor with some goals, inside the box of all goals, and of all free cells with a rim.

    A start outside has no way to any goal. Of the working memory, `jumps` belongs to this object, until that makes the
    next one.
    """

    def __init__(self, floor: Floor, goals: Cells, work: _Workspace) -> None:
        free = floor.free.reshape(floor.height + 2, floor.stride)
        left, top, self._free = _cut_out(free, np.ascontiguousarray(goals))
        self._corner = np.array([left - 1, top - 1], np.int32)
        self._jumps = work.jumps[: 4 * self._free.size].reshape(4, -1)
        self._work = work
        cells = self._in_box(goals)
        _lay_out(self._free, cells, self._jumps[1], self._jumps[3])
        turned = np.ascontiguousarray(self._free.T), np.ascontiguousarray(cells[:, ::-1])
        _lay_out(*turned, self._jumps[0], self._jumps[2])

    def search(self, starts: Cells, goals: Cells, first: Int64s) -> FloatRows:
        """Do the work of `GoalCosts.search`."""
        size = self._free.size
        memory = self._work.length[:size], self._work.came[:size]
        cells = self._in_box(starts), self._in_box(goals)
        costs: FloatRows = _search(self._free, self._jumps, *cells, first, memory)
        return costs

    def _in_box(self, cells: Cells) -> Cells:
        """Return the columns and rows of cells in the box."""
        return np.ascontiguousarray(cells - self._corner)


class _Workspace:
    """Working memory for floors of `cells` cells: jumps, lengths, and arrival steps; each search initializes its part.

    Robots of a process often search ways to the same goals in turn, so the jump points of the last goals are kept.
    """

    def __init__(self, cells: int) -> None:
        self.jumps = np.empty(4 * cells, np.int16)
        self.length = np.empty(cells, np.int64)
        self.came = np.empty(cells, np.uint8)
        self._last: tuple[GoalCosts, _JumpPoints] | None = None

    def jump_points(self, floor: Floor, costs: GoalCosts) -> _JumpPoints:
        """Return the jump points of the floor and the goals of `costs`."""
        if self._last is None or self._last[0] is not costs:
            self._last = costs, _JumpPoints(floor, costs.goals, self)
        return self._last[1]


@lru_cache(maxsize=1)
def _workspace(cells: int) -> _Workspace:
    """Return the working memory that all searches on floors of one size share."""
    return _Workspace(cells)


@kernel
def _cut_out(free: BoolRows, goals: Cells) -> tuple[int, int, BoolRows]:
    """Return the first column and row of the box of a floor (`_JumpPoints`), rims included, and its part of `free`."""
    height, width = free.shape
    in_column, in_row = np.zeros(width, np.bool_), np.zeros(height, np.bool_)
    for y in range(height):
        for x in range(width):
            in_column[x] |= free[y, x]
        in_row[y] = free[y].any()
    columns, rows = in_column.nonzero()[0], in_row.nonzero()[0]
    left, right, top, bottom = width, 0, height, 0
    if len(rows):
        left, right, top, bottom = columns[0] - 1, columns[-1] + 1, rows[0] - 1, rows[-1] + 1
    if len(goals):
        left, right = min(left, goals[:, 0].min() + 1), max(right, goals[:, 0].max() + 1)
        top, bottom = min(top, goals[:, 1].min() + 1), max(bottom, goals[:, 1].max() + 1)
    left, top = max(left, 1) - 1, max(top, 1) - 1
    part = free[top : min(bottom, height - 2) + 2, left : min(right, width - 2) + 2]
    return left, top, part.copy()


@kernel
def _lay_out(free: BoolRows, goals: Cells, down: Int16s, up: Int16s) -> None:
    """Compute the number of steps from each cell to the next jump point or goal below and above; 0 for none.

    A run may turn at a cell beside which a free cell follows an obstacle. No run leaves the floor. All cells of a row
    are independent, so that compilers can use vector instructions; unsigned indices help them.
    """
    height, width = free.shape
    is_goal = np.zeros((height, width), np.bool_)
    for number in range(len(goals)):
        is_goal[goals[number, 1], goals[number, 0]] = True
    down[(height - 2) * width :] = up[: 2 * width] = 0
    for way in (1, -1):
        jumps = down if way > 0 else up
        for index in range(1, height - 1):
            y = height - 1 - index if way > 0 else index
            before = y - way
            here, behind, goal = free[y], free[before], is_goal[y]
            ahead, out = jumps[y * width : (y + 1) * width], jumps[before * width : (before + 1) * width]
            for x in range(np.uint64(1), np.uint64(width - 1)):
                left, right = x - np.uint64(1), x + np.uint64(1)
                stops = goal[x] | here[left] & ~behind[left] | here[right] & ~behind[right]
                jump = np.int16(1) if stops else np.int16(ahead[x] + np.int16(ahead[x] > 0))
                out[x] = jump if here[x] else np.int16(0)


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
def _queue_up(cell: int, new: int, step: int, buckets: Int64s, queue: Int64Rows, used: int) -> int:
    """Queue an arrival at a jump point; return the length of the queue."""
    bucket = (new >> SHIFT) & (len(buckets) - 1)
    queue[used, 0], queue[used, 1], queue[used, 2] = cell, step, buckets[bucket]
    buckets[bucket] = used
    return used + 1


@kernel
def _search(
    floor: BoolRows, jumps: _Jumps, starts: Cells, goals: Cells, first: Int64s, memory: tuple[Int64s, Uint8s]
) -> FloatRows:
    """Settle jump points in buckets of width 1, until all goals of a start from its `first` on are settled.

    Starts outside the floor or on its rim have no way. The queue has rows (cell, arrival step, next entry of the same
    bucket). Returns the costs, shape (m, n); those of goals before `first` are arbitrary.
    """
    length, came = memory
    costs = np.empty((len(starts), len(goals)))
    height, stride = floor.shape
    free = floor.reshape(height * stride)
    offset, turned_offset = offsets(1, stride), offsets(height, 1)
    ends = np.empty(len(goals), np.int64)
    for number in range(len(goals)):
        ends[number] = goals[number, 1] * stride + goals[number, 0]
    # A power of two, with more levels than the longest diagonal with a straight run at its end.
    levels = 1
    while levels < 2 * (height + stride):
        levels *= 2
    buckets = np.empty(levels, np.int64)
    queue = np.empty((1024, 3), np.int64)
    for row in range(len(starts)):
        x, y = starts[row]
        if not (0 < x < stride - 1 and 0 < y < height - 1):
            costs[row] = np.inf
            continue
        start = y * stride + x
        came[:] = 0
        buckets[:] = -1
        length[start], came[start] = 0, 255
        queue[0, 0], queue[0, 1], queue[0, 2] = start, _BEGIN, -1
        buckets[0] = 0
        used, done, level, reached = 1, 0, 0, first[row]
        while done < used and reached < len(ends):
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
                turned = cell % stride * height + cell // stride  # its number column by column
                for number in range(4):
                    jump = np.int64(jumps[number, cell if number & 1 else turned])
                    to, new = cell + jump * offset[number], base + jump * ONE
                    if jump and onward >> number & 1 and _reach(to, new, number, length, came):
                        used = _queue_up(to, new, number, buckets, queue, used)
                for number in range(4, 8):
                    if not onward >> number & 1:
                        continue
                    one, other = number - 4, (number - 3) & 3
                    at, turned_at, so_far = cell, turned, base
                    while free[at + offset[one]] and free[at + offset[other]] and free[at + offset[number]]:
                        at += offset[number]
                        turned_at += turned_offset[number]
                        so_far += ROOT
                        if not _reach(at, so_far, number, length, came):
                            break
                        for side in (one, other):
                            jump = np.int64(jumps[side, at if side & 1 else turned_at])
                            to, new = at + jump * offset[side], so_far + jump * ONE
                            if jump and _reach(to, new, side, length, came):
                                used = _queue_up(to, new, side, buckets, queue, used)
            # Goals are checked in their order; a far goal delays the check of later ones.
            while reached < len(ends) and came[ends[reached]] and length[ends[reached]] >> SHIFT <= level:
                reached += 1
            level += 1
        for number in range(first[row], len(ends)):
            costs[row, number] = length[ends[number]] * UNIT if came[ends[number]] else np.inf
    return costs
