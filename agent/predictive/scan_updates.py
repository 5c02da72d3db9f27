"""A unit: from where a robot looked, and what was surprising about what it saw (docs/predictive.md).

Sender and receiver hold the same grid. From a pose they cast the same scan again (`protocol.grid.ray_table`): along each
beam cells known to be free pass, the first known wall ends it, and where it enters an unknown cell one decision tells
whether the robot has seen it, and another whether it is free or a wall. The cells so told are known from then on, to
the next beam too. Whatever the robot knows otherwise than this leads one to expect is told cell by cell: exceptions.

A grid here has a byte a cell: its state in the low two bits, and `TOLD` where the maker itself has said so.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.predictive.coder import (
    BROKEN,
    NUMBER,
    READS,
    Counts,
    Data,
    State,
    code_bit,
    code_number,
    code_signed,
)
from agent.predictive.contexts import (
    ACROSS,
    ALONG,
    CELLS,
    CELLS_MOST,
    CHANGED,
    EXCEPTIONS,
    FIRST_X,
    FIRST_Y,
    NEXT_ROW,
    OTHER_ROW,
    PLACED,
    REST_MOST,
    SAME,
    SAME_ROW,
    SEEN,
    neighbors,
)
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

TOLD = 4
"""Set in a cell of which the maker of the stream itself has told."""

STATE = 3
"""Mask of a cell's state."""

MAX_LOOKS = 64
"""Looks in a unit at most."""

X, Y, DX, DY, PLACES = range(5)
"""What is remembered of a robot's way: where it looked from last, how it came there, and how many looks there were."""

Cells = NDArray[np.int32]
Way = NDArray[np.int64]


@kernel("int64(int64[::1], uint8[::1], uint16[:,::1], int64[::1], int64, int64)")
def code_pose(state: State, data: Data, counts: Counts, way: Way, x: int, y: int) -> int:
    """Write the next pose (x, y), or read it into `way`: it is expected to go on as it did the last time.

    The last way is turned and mirrored until it leads along +x and not more along +y: how much farther the robot
    came along it and across it is what is told. Returns 1, or 0 if what was read is no pose.
    """
    if way[PLACES] == 0:
        column, row = 0, 0
        for place in range(10, -1, -1):
            column = column << 1 | code_bit(state, data, counts, PLACED + place, x >> place & 1, REST_MOST)
        for place in range(10, -1, -1):
            row = row << 1 | code_bit(state, data, counts, PLACED + 11 + place, y >> place & 1, REST_MOST)
        way[X], way[Y], way[DX], way[DY], way[PLACES] = column, row, 0, 0, 1
        return 1
    last_x, last_y = way[DX], way[DY]
    flip_x, flip_y, swap = last_x < 0, last_y < 0, abs(last_y) > abs(last_x)
    along, across = abs(last_x), abs(last_y)
    went_x, went_y = x - way[X], y - way[Y]
    if flip_x:
        went_x = -went_x
    if flip_y:
        went_y = -went_y
    if swap:
        along, across = across, along
        went_x, went_y = went_y, went_x
    kind = 0 if along == 0 else 1 if across == 0 else 3 if across == along else 2
    same = code_bit(
        state, data, counts, SAME + kind, 1 if went_x == along and went_y == across else 0, REST_MOST
    )
    if same:
        went_x, went_y = along, across
    else:
        farther = code_signed(state, data, counts, ALONG + kind * NUMBER, went_x - along, REST_MOST)
        row = ACROSS + (7 * kind + 3 + max(-3, min(3, farther))) * NUMBER
        aside = code_signed(state, data, counts, row, went_y - across, REST_MOST)
        went_x, went_y = along + farther, across + aside
    if swap:
        went_x, went_y = went_y, went_x
    if flip_x:
        went_x = -went_x
    if flip_y:
        went_y = -went_y
    way[X] += went_x
    way[Y] += went_y
    way[DX], way[DY] = went_x, went_y
    return 1


@kernel("int64(int64[::1], uint8[::1], uint16[:,::1], uint8[:,::1], uint8[:,::1], int32[:,::1], int32[::1],"
        "int64, int64, int32[:,::1], int64)")  # fmt: skip
def code_look(
    state: State,
    data: Data,
    counts: Counts,
    grid: Grid,
    own: Grid,
    cells: Cells,
    start: NDArray[np.int32],
    x: int,
    y: int,
    changes: Cells,
    changed: int,
) -> int:
    """Cast the scan of one look again, beam by beam, and tell or read what is unknown along it.

    Parameters
    ----------
    grid : uint8 array, shape (h, w)
        What the stream is built on; what is told is written into it.
    own : uint8 array, shape (h, w)
        The writer's self-explored grid; a reader gives any.
    cells, start : the beams, as in `protocol.grid.RayTable`
    x, y : int
        The cell where the robot looked from; it is free, which is taken for granted.
    changes : int32 array, shape (n, 2)
        Cells that change, as places in the flat grid, and what they were before, from row `changed` on.

    Returns
    -------
    int
        Rows of `changes` that are used by now.
    """
    # Without a sign what lies beyond the left or upper rim is a very large number, and indexing is twice as fast.
    height, width = np.uint64(grid.shape[0]), np.uint64(grid.shape[1])
    reads = state[READS]
    if grid[y, x] & STATE == UNKNOWN:
        changes[changed, 0], changes[changed, 1] = y * grid.shape[1] + x, grid[y, x]
        changed += 1
        grid[y, x] = FREE | TOLD
    unseen_before = 0
    for beam in range(len(start) - 1):
        asked = unseen = 0
        for at in range(np.uint64(start[beam]), np.uint64(start[beam + 1])):
            column, row = np.uint64(x + cells[at, 0]), np.uint64(y + cells[at, 1])
            if column >= width or row >= height:
                break
            known = grid[row, column] & STATE
            if known == FREE:
                continue
            if known == OCCUPIED:
                break
            truth = UNKNOWN if reads else int(own[row, column])
            asked_before = asked
            asked = 1
            seen = code_bit(
                state,
                data,
                counts,
                SEEN + 2 * unseen_before + asked_before,
                1 if truth != UNKNOWN else 0,
                REST_MOST,
            )
            if state[BROKEN]:
                return changed
            if not seen:
                unseen = 1
                break
            wall = code_bit(
                state, data, counts, CELLS + neighbors(grid, int(column), int(row)),
                1 if truth == OCCUPIED else 0, CELLS_MOST,
            )  # fmt: skip
            changes[changed, 0] = np.int64(row) * grid.shape[1] + np.int64(column)
            changes[changed, 1] = grid[row, column]
            changed += 1
            grid[row, column] = (OCCUPIED if wall else FREE) | TOLD
            if wall:
                break
        if asked:
            unseen_before = unseen
    return changed


@kernel("int64(uint8[:,::1], uint8[:,::1], boolean[:,::1], int32[:,::1], int32[::1], int64, int64)")
def claims(
    grid: Grid,
    own: Grid,
    claimed: NDArray[np.bool_],
    cells: Cells,
    start: NDArray[np.int32],
    x: int,
    y: int,
) -> int:
    """Count the cells of which a look from (x, y) would tell, and no look has that was asked before; claim them.

    They are those that its beams meet, unknown in `grid` and known in `own`; what they tell is known to it already.
    """
    height, width = np.uint64(grid.shape[0]), np.uint64(grid.shape[1])
    count = 0
    if grid[y, x] & STATE == UNKNOWN and own[y, x] == FREE and not claimed[y, x]:
        claimed[y, x] = True
        count = 1
    for beam in range(len(start) - 1):
        for at in range(np.uint64(start[beam]), np.uint64(start[beam + 1])):
            column, row = np.uint64(x + cells[at, 0]), np.uint64(y + cells[at, 1])
            if column >= width or row >= height:
                break
            known = grid[row, column] & STATE
            if known == UNKNOWN:
                known = own[row, column]
                if known != UNKNOWN and not claimed[row, column]:
                    claimed[row, column] = True
                    count += 1
            if known != FREE:
                break
    return count


@kernel("int64(uint8[:,::1], uint8[:,::1], int64, int64, int64, int64, int32[::1])")
def differing(grid: Grid, own: Grid, x0: int, y0: int, x1: int, y1: int, found: NDArray[np.int32]) -> int:
    """Find the cells of columns x0 to x1 - 1 and rows y0 to y1 - 1 in which `own` is not what `grid` tells of it.

    A cell that the robot knows must have its state; one that it does not know must not have been told by it.
    Writes their places in the flat grid to `found` as far as there is room, row by row; returns how many there are.
    """
    count = 0
    for y in range(y0, y1):
        for x in range(x0, x1):
            truth = own[y, x]
            differs = grid[y, x] & TOLD if truth == UNKNOWN else grid[y, x] & STATE != truth
            if differs:
                if count < len(found):
                    found[count] = y * grid.shape[1] + x
                count += 1
    return count


@kernel("int64(int64[::1], uint8[::1], uint16[:,::1], uint8[:,::1], uint8[:,::1], int32[::1], int64, int64[::1],"
        "int32[:,::1], int64)")  # fmt: skip
def code_exceptions(
    state: State,
    data: Data,
    counts: Counts,
    grid: Grid,
    own: Grid,
    places: NDArray[np.int32],
    number: int,
    way: Way,
    changes: Cells,
    changed: int,
) -> int:
    """Tell, or read, the cells that are not as the looks lead one to expect, row by row.

    `places` has the `number` of them, as places in the flat grid, ascending; a reader gives none. The rest is as with
    `code_look`; returns -1 - `changed` if what was read is no exception.
    """
    height, width = grid.shape
    number = code_number(state, data, counts, EXCEPTIONS, number, REST_MOST)
    x, y = way[X], way[Y]
    for index in range(number):
        to_x, to_y = np.int64(0), np.int64(0)
        if not state[READS]:
            to_x, to_y = places[index] % width, places[index] // width
        if index == 0:
            x += code_signed(state, data, counts, FIRST_X, to_x - x, REST_MOST)
            y += code_signed(state, data, counts, FIRST_Y, to_y - y, REST_MOST)
        else:
            rows = code_number(state, data, counts, NEXT_ROW, to_y - y, REST_MOST)
            y += rows
            if rows:
                x += code_signed(state, data, counts, OTHER_ROW, to_x - x, REST_MOST)
            else:
                x += 1 + code_number(state, data, counts, SAME_ROW, to_x - x - 1, REST_MOST)
        if state[BROKEN] or not (0 <= x < width and 0 <= y < height) or changed >= len(changes):
            return -1 - changed
        before = int(grid[y, x] & STATE)
        truth = (before + 1) % 3 if state[READS] else int(own[y, x])
        other = code_bit(
            state, data, counts, CHANGED + before, 1 if truth == (before + 2) % 3 else 0, REST_MOST
        )
        now = (before + 1 + other) % 3
        changes[changed, 0], changes[changed, 1] = y * width + x, grid[y, x]
        changed += 1
        grid[y, x] = now | TOLD if now != UNKNOWN else UNKNOWN
    return changed
