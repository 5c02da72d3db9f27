"""Exact shortest ways on the planning grid (thesis, section 4.4.1, Algorithm 7).

A way is 8-connected over free cells. A step to a 4-neighbor has length 1, a diagonal step sqrt 2; it needs both cells
beside it free. The result equals that of value iteration. The search is Dijkstra's with buckets of width 1 (Dial 1969):
no step is shorter, so the cells of a bucket, a level, cannot improve each other, and need no order.

Two measures make it fast. Of several equally long ways to a cell one suffices, the one with its diagonal steps first.
So the search continues from a cell only in the direction of the last step, and sideways where an obstacle has just
ended (canonical ordering, Harabor and Grastien 2011). And lengths are integers, with 2^42 per cell: their sums do not
depend on the order of addition, so every exact method gives the same bits.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from agent.planning.frontier import Floor, is_enclosed, is_frontier
from protocol.arrays import Bools, Cells, FloatRows, Floats, Int32Rows, Int32s, Int64s, Uint8s
from protocol.grid import FREE, Cell, Grid
from protocol.kernels import kernel

Field = FloatRows

DIAGONAL = math.sqrt(2.0)

SHIFT = 42
"""Bits of a length behind the binary point."""

ONE = 1 << SHIFT
ROOT = round(DIAGONAL * ONE)
"""Lengths of a straight and of a diagonal step, as integers."""

UNIT = 1.0 / ONE
"""Factor from an integer length to cells."""

FAR = 1 << 62
"""Length of a cell that the search has not reached."""

STEPS = np.array([(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)], np.int64)
"""Neighbors (dx, dy). Step 4 + i is the diagonal between steps i and i + 1."""

FRONTS = 20
"""Rows of cells that a search has reached and not settled yet (`settle`)."""

Workspace = tuple[Int64s, Uint8s, Int32s]
"""Working memory of a search: the length of the way to each cell, the last step of this way, and a list of the settled
cells, to which no shorter way can be found."""

Search = tuple[Bools, Workspace, Int64s, Int64s]
"""A search under way: the free cells of the floor, the working memory, the number of cells in each front, and last that
of settled cells, and the index difference of each step."""

Bound = tuple[int, int]
"""A cell and a length: cells that cannot be on a way of this length to the cell need no successors."""

NO_BOUND: Bound = (0, FAR)

_NO_WEIGHTS = np.empty((0, 0))


@lru_cache(maxsize=1)
def workspace(cells: int) -> Workspace:
    """Return the working memory that all searches on floors of one size share.

    Fresh memory pages take nearly as long as a search, so each search resets the cells that it has reached (`tidy`):
    the next one finds all lengths `FAR`. Kernels hold the interpreter's lock, so no two searches run at the same time.
    """
    return np.full(cells, FAR, np.int64), np.zeros(cells, np.uint8), np.empty(cells, np.int32)


def way_between(floor: Floor, start: Cell, end: Cell, length: float = math.inf) -> Cells | None:
    """Return the cells of a shortest way between two cells, without the start; None if there is none.

    The way equals that of `way` on a whole field, but the search ends at `end`. If its `length` is known, in cells as
    other functions of this module return it, the search leaves out the cells that cannot be on a way of this length.
    """
    limit = round(length * ONE) if math.isfinite(length) else FAR
    work = workspace(len(floor.free))
    found, cells = _lead(floor.free, work, floor.stride, floor.at(*start), floor.at(*end), limit)
    return cells if found else None


def costs(floor: Floor, x: int, y: int) -> Field:
    """Return the length of the shortest way from cell (x, y) to every cell, shape (h, w); infinite without a way."""
    field = np.empty((floor.height, floor.width))
    _spread(floor.free, workspace(len(floor.free)), floor.at(x, y), field)
    return field


def costs_to(floor: Floor, x: int, y: int, cells: Cells) -> Floats:
    """Return the length of the shortest way from cell (x, y) to each of `cells`, shape (n,), as `costs` does.

    The search ends at the last of them: suited to cells near each other. For cells all over the floor
    `agent.planning.jump_point_search` is faster.
    """
    found: Floats = _spread_to(floor.free, workspace(len(floor.free)), floor.stride, floor.at(x, y), cells)
    return found


def nearest_first(
    floor: Floor, grid: Grid, x: int, y: int, taken: Cells, ranges: ArrayLike
) -> tuple[Cell, Cells] | None:
    """Find the frontier cell nearest to (x, y) that is out of range of every `taken` cell.

    Without one, the nearest of all frontier cells. The search ends with the bucket of this cell. Of equally near cells
    the first counts, row by row. `taken` are the targets of teammates; each excludes frontier cells within its entry
    of `ranges` (cells; scalar or shape (n,)).

    Returns the cell (x, y) and a shortest way to it, without the start; None if no frontier cell is reachable.
    """
    around = np.full(len(taken), ranges, np.float64)
    work = workspace(len(floor.free))
    cell, way = _spread_to_frontier(floor.free, work, grid, floor.at(x, y), taken, around)
    return None if cell < 0 else ((cell % floor.stride - 1, cell // floor.stride - 1), way)


def way(grid: Grid, field: Field, x: int, y: int, weights: FloatRows = _NO_WEIGHTS) -> Cells:
    """Return the cells of a shortest way from the origin of `field` to (x, y), in driving order, by steepest descent.

    The start is left out. `field` must be finite at (x, y). Of equal neighbors the first counts, straight steps before
    diagonal ones. A field of `agent.planning.occupancy` needs its `weights`, shape (h, w).
    """
    out = np.empty((grid.size, 2), np.int32)
    length = _descend(grid, weights, field, x, y, out)
    return out[:length][::-1].copy()


@kernel
def begin(free: Bools, work: Workspace, stride: int, start: int) -> tuple[Search, Int32Rows]:
    """Begin a search: settle the start, and put its neighbors into the fronts of level 1; return it with all fronts."""
    length, came, settled = work
    fronts = np.empty((FRONTS, 512), np.int32)
    fill, offset = np.zeros(FRONTS + 1, np.int64), offsets(1, stride)
    length[start], settled[0], fill[FRONTS] = 0, start, 1
    for step in range(8):
        cell = start + offset[step]
        is_open = free[cell]
        if step >= 4:
            is_open = is_open and free[start + offset[step - 4]] and free[start + offset[(step - 3) & 3]]
        if is_open:
            row = 4 + step if step < 4 else 12 + (step & 3)
            length[cell], came[cell] = ONE if step < 4 else ROOT, step
            fronts[row, 0], fill[row] = cell, 1
    return (free, work, fill, offset), fronts


@kernel
def tidy(search: Search, fronts: Int32Rows) -> None:
    """Reset the lengths of all cells that the search has reached."""
    _, (length, _, settled), fill, _ = search
    for at in range(fill[FRONTS]):
        length[np.uint64(settled[np.uint64(at)])] = FAR
    for row in range(FRONTS):
        for at in range(fill[row]):
            length[np.uint64(fronts[np.uint64(row), np.uint64(at)])] = FAR


@kernel
def settle(search: Search, fronts: Int32Rows, level: int, bound: Bound) -> Int32Rows:
    """Settle the cells of a level, from 1: list them, and put their neighbors into the fronts of the next two levels.

    Returns the fronts, enlarged if necessary. A level has eight of them, one for each step by which its cells were
    reached, so the loop over a front has a fixed direction. Straight step i: row 4 (level % 2) + i, as straight steps
    lead to the next level. Diagonal step 4 + i, which may lead to the one after that: row 8 + 4 (level % 3) + i.
    """
    # Unsigned indices cannot count from the end of an array, which saves a comparison each.
    free, (length, came, settled), fill, offset = search
    straight, next_straight = 4 * (level & 1), 4 * (~level & 1)
    diagonal, next_diagonal = 8 + 4 * (level % 3), 8 + 4 * ((level + 1) % 3)
    later_diagonal = 8 + 4 * ((level + 2) % 3)
    # A cell has at most one successor in each front.
    most = fill[:FRONTS].max()
    for step in range(4):
        most += fill[straight + step] + fill[diagonal + step]
    if most > fronts.shape[1]:
        larger = np.empty((FRONTS, 2 * most), np.int32)
        larger[:, : fronts.shape[1]] = fronts
        fronts = larger
    stride = offset[1]
    bound_x, bound_y = bound[0] % stride, bound[0] // stride
    count = fill[FRONTS]
    for step in range(4):
        ahead = offset[step]
        for at in range(fill[straight + step]):
            cell = np.int64(fronts[np.uint64(straight + step), np.uint64(at)])
            here = np.uint64(cell)
            if came[here] != step:
                continue  # reached on a shorter way since
            settled[np.uint64(count)] = cell
            count += 1
            base = length[here]
            if bound[1] < FAR:
                dx, dy = abs(cell % stride - bound_x), abs(cell // stride - bound_y)
                if base + min(dx, dy) * ROOT + abs(dx - dy) * ONE > bound[1]:
                    continue  # too far even without obstacles
            to = np.uint64(cell + ahead)
            for turn in (1, 3):
                side = (step + turn) & 3
                aside = offset[np.uint64(side)]
                to_side, across = np.uint64(cell + aside), np.uint64(cell + aside + ahead)
                if free[np.uint64(cell + aside - ahead)] or not free[to_side]:
                    continue
                if base + ONE < length[to_side]:
                    length[to_side], came[to_side] = base + ONE, side
                    row = np.uint64(next_straight + side)
                    fronts[row, np.uint64(fill[row])] = to_side
                    fill[row] += 1
                if free[to] and free[across] and base + ROOT < length[across]:
                    between = step if turn == 1 else side
                    length[across], came[across] = base + ROOT, 4 + between
                    is_next = (base + ROOT) >> SHIFT == level + 1
                    row = np.uint64((next_diagonal if is_next else later_diagonal) + between)
                    fronts[row, np.uint64(fill[row])] = across
                    fill[row] += 1
            if free[to] and base + ONE < length[to]:
                length[to], came[to] = base + ONE, step
                row = np.uint64(next_straight + step)
                fronts[row, np.uint64(fill[row])] = to
                fill[row] += 1
        fill[straight + step] = 0
    for step in range(4, 8):
        for at in range(fill[diagonal + step - 4]):
            cell = np.int64(fronts[np.uint64(diagonal + step - 4), np.uint64(at)])
            here = np.uint64(cell)
            if came[here] != step:
                continue
            settled[np.uint64(count)] = cell
            count += 1
            base = length[here]
            if bound[1] < FAR:
                dx, dy = abs(cell % stride - bound_x), abs(cell // stride - bound_y)
                if base + min(dx, dy) * ROOT + abs(dx - dy) * ONE > bound[1]:
                    continue
            are_free = True
            for side in (step - 4, (step - 3) & 3):
                to = np.uint64(cell + offset[np.uint64(side)])
                are_free = are_free and free[to]
                if free[to] and base + ONE < length[to]:
                    length[to], came[to] = base + ONE, side
                    row = np.uint64(next_straight + side)
                    fronts[row, np.uint64(fill[row])] = to
                    fill[row] += 1
            to = np.uint64(cell + offset[np.uint64(step)])
            if are_free and free[to] and base + ROOT < length[to]:
                length[to], came[to] = base + ROOT, step
                is_next = (base + ROOT) >> SHIFT == level + 1
                row = np.uint64((next_diagonal if is_next else later_diagonal) + step - 4)
                fronts[row, np.uint64(fill[row])] = to
                fill[row] += 1
        fill[diagonal + step - 4] = 0
    fill[FRONTS] = count
    return fronts


@kernel
def offsets(right: int, down: int) -> Int64s:
    """Return the index difference of each step on a flat floor, given those of a step right and of one down."""
    offset = np.empty(8, np.int64)
    for number in range(8):
        offset[number] = STEPS[number, 0] * right + STEPS[number, 1] * down
    return offset


@kernel
def _settle_until(
    search: Search, fronts: Int32Rows, level: int, end: int, bound: Bound
) -> tuple[Int32Rows, int]:
    """Settle level after level until the cell `end` is settled or no cell is left; return the fronts and the level."""
    _, work, fill, _ = search
    while work[0][end] >> SHIFT >= level and fill[:FRONTS].any():
        fronts = settle(search, fronts, level, bound)
        level += 1
    return fronts, level


@kernel
def _spread(free: Bools, work: Workspace, start: int, field: Field) -> None:
    height, width = field.shape
    search, fronts = begin(free, work, width + 2, start)
    # Cell 0, on the rim, is never settled.
    fronts, _ = _settle_until(search, fronts, 1, 0, NO_BOUND)
    length = work[0]
    for row in range(height):
        first = (row + 1) * (width + 2) + 1
        source = length[first : first + width]
        for column in range(width):
            field[row, column] = source[column] * UNIT if source[column] != FAR else np.inf
    tidy(search, fronts)


@kernel
def _spread_to(free: Bools, work: Workspace, stride: int, start: int, cells: Cells) -> Floats:
    length, found = work[0], np.empty(len(cells))
    search, fronts = begin(free, work, stride, start)
    level = 1
    for index in range(len(cells)):
        cell = (cells[index, 1] + 1) * stride + cells[index, 0] + 1
        fronts, level = _settle_until(search, fronts, level, cell, NO_BOUND)
        found[index] = length[cell] * UNIT if length[cell] != FAR else np.inf
    tidy(search, fronts)
    return found


@kernel
def _lead(free: Bools, work: Workspace, stride: int, start: int, end: int, limit: int) -> tuple[bool, Cells]:
    search, fronts = begin(free, work, stride, start)
    fronts, _ = _settle_until(search, fronts, 1, end, (end, limit))
    found = work[0][end] != FAR
    cells = way_back(search, end)
    tidy(search, fronts)
    return found, cells


@kernel
def _spread_to_frontier(
    free: Bools, work: Workspace, grid: Grid, start: int, taken: Cells, ranges: Floats
) -> tuple[int, Cells]:
    """Return the index of the found cell, -1 if there is none, and the way to it."""
    length, _, settled = work
    stride = grid.shape[1] + 2
    search, fronts = begin(free, work, stride, start)
    fill = search[2]
    level, first, found, checked = 1, -1, -1, 0
    while found < 0:
        nearest = -1
        for at in range(checked, fill[FRONTS]):
            cell = settled[at]
            if is_enclosed(free, cell, stride):
                continue
            cx, cy = cell % stride - 1, cell // stride - 1
            if not is_frontier(grid, cx, cy):
                continue
            if nearest < 0 or (length[cell], cell) < (length[nearest], nearest):
                nearest = cell
            clear = True
            for other in range(len(taken)):
                dx, dy = cx - taken[other, 0], cy - taken[other, 1]
                clear = clear and dx * dx + dy * dy > ranges[other] * ranges[other]
            if clear and (found < 0 or (length[cell], cell) < (length[found], found)):
                found = cell
        if first < 0:
            first = nearest
        checked = fill[FRONTS]
        if not fill[:FRONTS].any():
            break
        if found < 0:
            fronts = settle(search, fronts, level, NO_BOUND)
            level += 1
    if found < 0:
        found = first
    cells = way_back(search, found)
    tidy(search, fronts)
    return found, cells


@kernel
def way_back(search: Search, end: int) -> Int32Rows:
    """Return the cells (x, y) of the way to a settled cell, in driving order; none for another cell.

    It computes the same sums as `_descend`, so it chooses the same one of several shortest ways.
    """
    free, (length, _, _), _, offset = search
    if end < 0 or length[end] == FAR:
        return np.empty((0, 2), np.int32)
    stride = offset[1]
    count = (length[end] >> SHIFT) + 1  # no step is shorter than a cell
    cells = np.empty((count, 2), np.int32)
    first = count
    at = end
    while length[at] > 0:
        first -= 1
        cells[first, 0], cells[first, 1] = at % stride - 1, at // stride - 1
        best, next_one = np.inf, at
        for number in range(8):
            before = at + offset[number]
            if length[before] == FAR:
                continue
            step = 1.0
            if number >= 4:
                if not free[at + offset[number - 4]] or not free[at + offset[(number - 3) & 3]]:
                    continue
                step = DIAGONAL
            if length[before] * UNIT + step < best:
                best, next_one = length[before] * UNIT + step, before
        at = next_one
    return cells[first:].copy()


@kernel
def _descend(grid: Grid, weights: FloatRows, field: Field, x: int, y: int, out: Cells) -> int:
    height, width = grid.shape
    length = 0
    while field[y, x] > 0.0:
        out[length, 0], out[length, 1] = x, y
        length += 1
        weight = weights[y, x] if weights.size else 1.0
        best, best_x, best_y = np.inf, x, y
        for number in range(8):
            nx, ny = x + STEPS[number, 0], y + STEPS[number, 1]
            if nx < 0 or ny < 0 or nx >= width or ny >= height:
                continue
            step = weight
            if number >= 4:
                # On a way only the start may be a cell that is not free on this grid.
                if grid[y, nx] != FREE or grid[ny, x] != FREE:
                    continue
                step = weight * DIAGONAL
            if field[ny, nx] + step < best:
                best, best_x, best_y = field[ny, nx] + step, nx, ny
        x, y = best_x, best_y
    return length
