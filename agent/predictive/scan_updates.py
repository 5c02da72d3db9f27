"""Code an update: the poses of scans, the cells that the scans reveal, and corrections (docs/predictive.md).

Author and receiver hold the same grid, and cast each scan again from its pose (`protocol.grid.ray_table`). A beam
passes known free cells and ends at the first known wall. Where it enters an unknown cell, one bit codes whether the
robot has observed the cell, and another whether it is free or a wall. The cell is known from then on, also to the next
beams. Cells that the self-explored grid holds otherwise follow one by one, as corrections.

A cell of the grid is a byte: its state in the low two bits, and the flag `REPORTED` if the author itself reported it.
"""

from __future__ import annotations

import numpy as np

from agent.predictive.coder import (
    AHEAD,
    DECODES,
    FAILED,
    NUMBER,
    PLACE,
    Coder,
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
    CORRECTIONS,
    FIRST_POSE,
    FIRST_X,
    FIRST_Y,
    NEXT_ROW,
    OBSERVED,
    OTHER_ROW,
    REST_MOST,
    SAME_MOTION,
    SAME_ROW,
    neighbors,
)
from agent.predictive.mixer import MixingCoder
from agent.predictive.wall_model import code_wall
from protocol.arrays import BoolRows, Cells, Int32s, Int64s
from protocol.boxes import Box
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

REPORTED = 4
"""Flag of a cell that the author of the map itself has reported."""

STATE = 3
"""Mask of the state of a cell."""

MAX_SCANS = 64
"""Largest number of scans in an update."""

X, Y, DX, DY, SCANS = range(5)
"""Indices of a `Motion`: cell of the last scan, its offset from the scan before, and whether there was a scan."""

Motion = Int64s

Beams = tuple[Cells, Int32s]
"""`cells` and `start` of a `protocol.grid.RayTable`."""


@kernel
def code_pose(coder: Coder, motion: Motion, x: int, y: int) -> None:
    """Encode or decode the next pose into `motion`, predicting that the robot repeats its last motion.

    The last motion is mirrored into the octant between +x and the diagonal. The differences along and across it are
    coded. Poses are cells (x, y).
    """
    if motion[SCANS] == 0:
        column, row = 0, 0
        for place in range(10, -1, -1):
            column = column << 1 | code_bit(coder, FIRST_POSE + place, x >> place & 1, REST_MOST)
        for place in range(10, -1, -1):
            row = row << 1 | code_bit(coder, FIRST_POSE + 11 + place, y >> place & 1, REST_MOST)
        motion[X], motion[Y], motion[DX], motion[DY], motion[SCANS] = column, row, 0, 0, 1
        return
    last_x, last_y = motion[DX], motion[DY]
    flip_x, flip_y, swap = last_x < 0, last_y < 0, abs(last_y) > abs(last_x)
    along, across = abs(last_x), abs(last_y)
    went_x, went_y = x - motion[X], y - motion[Y]
    if flip_x:
        went_x = -went_x
    if flip_y:
        went_y = -went_y
    if swap:
        along, across = across, along
        went_x, went_y = went_y, went_x
    kind = 0 if along == 0 else 1 if across == 0 else 3 if across == along else 2
    same = code_bit(coder, SAME_MOTION + kind, 1 if went_x == along and went_y == across else 0, REST_MOST)
    if same:
        went_x, went_y = along, across
    else:
        farther = code_signed(coder, ALONG + kind * NUMBER, went_x - along, REST_MOST)
        row = ACROSS + (7 * kind + 3 + max(-3, min(3, farther))) * NUMBER
        aside = code_signed(coder, row, went_y - across, REST_MOST)
        went_x, went_y = along + farther, across + aside
    if swap:
        went_x, went_y = went_y, went_x
    if flip_x:
        went_x = -went_x
    if flip_y:
        went_y = -went_y
    motion[X] += went_x
    motion[Y] += went_y
    motion[DX], motion[DY] = went_x, went_y


@kernel
def code_scan(
    coder: Coder,
    mixing: MixingCoder,
    grid: Grid,
    own: Grid,
    beams: Beams,
    x: int,
    y: int,
    changes: Cells,
    changed: int,
    limit: int,
) -> int:
    """Cast one scan, beam by beam, and encode or decode the unknown cells along the beams.

    The scan is cut off at the first unknown cell behind `limit` bytes of the update, if the update has any cell.
    `mixing` is the same coder with a model of walls (`agent.predictive.wall_model`). If the model is empty, walls are
    coded by their neighbors alone. `grid`, shape (h, w), is that from which the scan is predicted; coded cells are
    written to it. `own` is the author's self-explored grid; a decoder passes any. The cell (x, y) of the scan is taken
    to be free without coding. `changes`, shape (n, 2), receives the changed cells, as indices of the flat grid, and
    their previous values, from row `changed` on. Returns the number of used rows of `changes`.
    """
    # Unsigned, a cell beyond the left or upper rim has a very large number; unsigned indexing is twice as fast.
    height, width = np.uint64(grid.shape[0]), np.uint64(grid.shape[1])
    (cells, start), state = beams, coder[0]
    reads = state[DECODES]
    mixes = len(mixing[4]) > 0
    if grid[y, x] & STATE == UNKNOWN:
        changes[changed, 0], changes[changed, 1] = y * grid.shape[1] + x, grid[y, x]
        changed += 1
        grid[y, x] = FREE | REPORTED
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
            if changed and state[PLACE] - AHEAD * reads >= limit:
                return changed
            truth = UNKNOWN if reads else int(own[row, column])
            asked_before = asked
            asked = 1
            seen = code_bit(
                coder, OBSERVED + 2 * unseen_before + asked_before, 1 if truth != UNKNOWN else 0, REST_MOST
            )
            if state[FAILED]:
                return changed
            if not seen:
                unseen = 1
                break
            wall = 1 if truth == OCCUPIED else 0
            if mixes:
                wall = code_wall(mixing, grid, int(column), int(row), wall)
            else:
                wall = code_bit(coder, CELLS + neighbors(grid, int(column), int(row)), wall, CELLS_MOST)
            changes[changed, 0] = np.int64(row) * grid.shape[1] + np.int64(column)
            changes[changed, 1] = grid[row, column]
            changed += 1
            grid[row, column] = (OCCUPIED if wall else FREE) | REPORTED
            if wall:
                break
        if asked:
            unseen_before = unseen
    return changed


@kernel
def find_new_cells(
    grid: Grid, own: Grid, counted: BoolRows, beams: Beams, x: int, y: int, found: Int32s, count: int
) -> int:
    """Find the cells that a scan from (x, y) would reveal and that are not yet `counted`; mark them there.

    A scan reveals the cells on its beams that are unknown in `grid` and known in `own`; a beam ends at a wall, or at a
    cell that is unknown in both. Writes their indices in the flat grid to `found`, from place `count` on; returns the
    place behind the last one.
    """
    cells, start = beams
    height, width = np.uint64(grid.shape[0]), np.uint64(grid.shape[1])
    if grid[y, x] & STATE == UNKNOWN and own[y, x] == FREE and not counted[y, x]:
        counted[y, x] = True
        found[count] = y * grid.shape[1] + x
        count += 1
    for beam in range(len(start) - 1):
        for at in range(np.uint64(start[beam]), np.uint64(start[beam + 1])):
            column, row = np.uint64(x + cells[at, 0]), np.uint64(y + cells[at, 1])
            if column >= width or row >= height:
                break
            known = grid[row, column] & STATE
            if known == UNKNOWN:
                known = own[row, column]
                if known != UNKNOWN and not counted[row, column]:
                    counted[row, column] = True
                    found[count] = row * width + column
                    count += 1
            if known != FREE:
                break
    return count


@kernel
def find_differences(grid: Grid, own: Grid, box: Box, found: Int32s) -> int:
    """Find the cells of a box that need a correction.

    A cell known in `own` needs one if `grid` has another state; a cell unknown in `own`, if the author has reported it.
    Writes their indices in the flat grid to `found`, row by row, up to its length; returns their number.
    """
    count, (x0, y0, x1, y1) = 0, box
    for y in range(y0, y1):
        for x in range(x0, x1):
            truth = own[y, x]
            differs = grid[y, x] & REPORTED if truth == UNKNOWN else grid[y, x] & STATE != truth
            if differs:
                if count < len(found):
                    found[count] = y * grid.shape[1] + x
                count += 1
    return count


@kernel
def code_corrections(
    coder: Coder, grid: Grid, own: Grid, places: Int32s, motion: Motion, changes: Cells, changed: int
) -> int:
    """Encode or decode the corrections, row by row.

    `places` are the corrected cells, as ascending indices of the flat grid; a decoder passes none. The other parameters
    and the result are those of `code_scan`. Returns -1 - `changed` if a decoded cell lies outside the grid.
    """
    state = coder[0]
    height, width = grid.shape
    number = code_number(coder, CORRECTIONS, len(places), REST_MOST)
    x, y = motion[X], motion[Y]
    for index in range(number):
        to_x, to_y = np.int64(0), np.int64(0)
        if not state[DECODES]:
            to_x, to_y = places[index] % width, places[index] // width
        if index == 0:
            x += code_signed(coder, FIRST_X, to_x - x, REST_MOST)
            y += code_signed(coder, FIRST_Y, to_y - y, REST_MOST)
        else:
            rows = code_number(coder, NEXT_ROW, to_y - y, REST_MOST)
            y += rows
            if rows:
                x += code_signed(coder, OTHER_ROW, to_x - x, REST_MOST)
            else:
                x += 1 + code_number(coder, SAME_ROW, to_x - x - 1, REST_MOST)
        if state[FAILED] or not (0 <= x < width and 0 <= y < height) or changed >= len(changes):
            return -1 - changed
        before = int(grid[y, x] & STATE)
        truth = (before + 1) % 3 if state[DECODES] else int(own[y, x])
        other = code_bit(coder, CHANGED + before, 1 if truth == (before + 2) % 3 else 0, REST_MOST)
        now = (before + 1 + other) % 3
        changes[changed, 0], changes[changed, 1] = y * width + x, grid[y, x]
        changed += 1
        grid[y, x] = now | REPORTED if now != UNKNOWN else UNKNOWN
    return changed
