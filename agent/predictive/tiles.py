"""Code changes of a grid as tiles of 8 x 8 cells (for maps of noisy lasers, with a tolerance).

Author and receiver hold the same grid. An update names the box of changed tiles, relative to that of the update before.
One bit per tile of the box says whether the tile has changed. In a changed tile, one bit per cell says whether the
cell has changed, and another which of the two other states it has now. Bits are predicted from the cells around, as
corrected so far, by several contexts at once (`agent.predictive.mixer`). Every log begins with the same trained model.

A cell of the grid is a byte, as in `agent.predictive.scan_updates`. The code does not read its flag.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from agent.mapping.bound import TILE
from agent.predictive.coder import DECODES, FAILED
from agent.predictive.contexts import cell_state
from agent.predictive.mixer import INPUTS, MixingCoder, Model, code_mixed
from agent.predictive.model_table import shipped_model
from agent.predictive.scan_updates import REPORTED
from protocol.arrays import Cells, Int64s
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

BOX_BITS = 9
"""Bits of an edge of the box, as a difference from the last one or from the opposite edge."""

CELL_CONTEXTS = 6561
"""Contexts of a bit of a cell: 3^8. There are six of these blocks, by the state before and the question."""

_TILES = 6 * CELL_CONTEXTS
_TILE_CONTEXTS = 512
_BOX = _TILES + _TILE_CONTEXTS
_BOX_CONTEXTS = 64
"""Contexts of an edge of the box: its first bits, then places of the bits."""

CONTEXTS = _BOX + 4 * _BOX_CONTEXTS

_TILE_SET, _BOX_SET, _CELL_SET = range(3)
"""Sets of weights: of tiles, of the box, and of cells by their known neighbors, the state before, and the question."""

SETS = _CELL_SET + 5 * 6

_OUTSIDE = 2
"""Context of a neighboring tile outside the box."""

TABLE = Path(__file__).with_name("tile_start.npz")
"""The shipped table: the initial model of every log, trained on generated maps (`deploy.study.tile_table`)."""


def start_model() -> Model:
    """Return a copy of the initial model of every log."""
    return shipped_model(TABLE, CONTEXTS, SETS)


@kernel
def _code_edge(coder: MixingCoder, edge: int, value: int) -> int:
    """Encode or decode a number of `BOX_BITS` bits, the highest first."""
    buffer = coder[5]
    first = _BOX + edge * _BOX_CONTEXTS
    number = 1
    for place in range(BOX_BITS - 1, -1, -1):
        buffer[0, :] = first + 40 + place
        buffer[0, 0] = first + min(number, 39)
        number = number << 1 | code_mixed(coder, _BOX_SET, value >> place & 1)
    return number - (1 << BOX_BITS)


@kernel
def _code_box(coder: MixingCoder, box: Int64s, last: Int64s) -> None:
    """Encode or decode the first and last column and row of tiles; `last` is the previous box, and becomes this one."""
    half = 1 << BOX_BITS - 1
    for edge in range(4):
        reference, shift = (last[edge], half) if edge < 2 else (box[edge - 2], 0)
        box[edge] = reference + _code_edge(coder, edge, box[edge] - reference + shift) - shift
    last[:] = box


@kernel
def _set_tile_contexts(buffer: Int64s, grid: Grid, changed: Grid, box: Int64s, x: int, y: int) -> None:
    """Set the contexts of a tile's bit: what is known of it, and which neighboring tiles have changed."""
    known = walls = 0
    for row in range(y * TILE, y * TILE + TILE):
        for column in range(x * TILE, x * TILE + TILE):
            state = cell_state(grid, column, row)
            known += state != UNKNOWN
            walls += state == OCCUPIED
    left = np.int64(changed[y, x - 1]) if x > box[0] else _OUTSIDE
    up = np.int64(changed[y - 1, x]) if y > box[1] else _OUTSIDE
    right = np.int64(changed[y - 1, x + 1]) if y > box[1] and x < box[2] else _OUTSIDE
    part = 0 if known == 0 else 3 if known == TILE * TILE else 1 if known < TILE * TILE // 2 else 2
    around, content = left * 9 + up * 3 + right, part * 4 + min(walls, 3)
    buffer[0] = _TILES + content * 27 + around
    buffer[1] = _TILES + content
    buffer[2] = _TILES + around
    buffer[3] = _TILES + min(known // 4, 16) * 16 + min(walls, 15)
    buffer[4] = _TILES + part * 9 + left * 3 + up
    buffer[5] = _TILES + left * 3 + up


@kernel
def set_cell_contexts(buffer: Int64s, grid: Grid, x: int, y: int) -> int:
    """Set the contexts of a cell, without their block: its neighbors, 49 cells around it, and its place in the tile.

    Returns how many of its four nearest neighbors are known.
    """
    west, north = cell_state(grid, x - 1, y), cell_state(grid, x, y - 1)
    east, south = cell_state(grid, x + 1, y), cell_state(grid, x, y + 1)
    north_west, north_east = cell_state(grid, x - 1, y - 1), cell_state(grid, x + 1, y - 1)
    south_west, south_east = cell_state(grid, x - 1, y + 1), cell_state(grid, x + 1, y + 1)
    west_2, north_2 = cell_state(grid, x - 2, y), cell_state(grid, x, y - 2)
    east_2, south_2 = cell_state(grid, x + 2, y), cell_state(grid, x, y + 2)
    before = ((west * 3 + north) * 3 + north_west) * 3 + north_east
    behind = ((east * 3 + south) * 3 + south_east) * 3 + south_west
    above = ((west_2 * 3 + north_2) * 3 + cell_state(grid, x + 1, y - 2)) * 3 + cell_state(grid, x - 1, y - 2)
    aside = ((west * 3 + north) * 3 + cell_state(grid, x - 2, y - 1)) * 3 + cell_state(grid, x + 2, y - 1)
    free = walls = 0
    for row in range(y - 3, y + 4):
        for column in range(x - 3, x + 4):
            state = cell_state(grid, column, row)
            free += state == FREE
            walls += state == OCCUPIED
    buffer[0] = before * 81 + behind
    buffer[1] = before * 81 + above
    buffer[2] = free // 3 * 17 + min(walls, 16)
    buffer[3] = aside * 27 + north_east * 9 + west_2 * 3 + north_2
    buffer[4] = (before * 9 + east * 3 + south) * 9 + east_2 * 3 + south_2
    buffer[5] = (y % TILE * TILE + x % TILE) * 9 + west * 3 + north
    return int(west != UNKNOWN) + int(north != UNKNOWN) + int(east != UNKNOWN) + int(south != UNKNOWN)


@kernel
def code_cell(
    coder: MixingCoder, known: int, state: int, truth: int, first_context: int, first_set: int
) -> int:
    """Encode or decode the state of a cell that is now `state`, with `known` known neighbors.

    The contexts are set without their block, which follows `first_context`; `first_set` is the first set of weights.
    """
    buffer = coder[5]
    block = 2 * state
    weights = first_set + 6 * known + block
    for index in range(INPUTS):
        buffer[0, index] += first_context + block * CELL_CONTEXTS
    if not code_mixed(coder, weights, 1 if truth != state else 0):
        return state
    for index in range(INPUTS):
        buffer[0, index] += CELL_CONTEXTS
    first, second = (FREE, OCCUPIED) if state == UNKNOWN else (3 - state, UNKNOWN)
    return first if code_mixed(coder, weights + 1, 1 if truth == first else 0) else second


@kernel
def code_cells(
    coder: MixingCoder, grid: Grid, target: Grid, tile_x: int, tile_y: int, changes: Cells, count: int
) -> int:
    """Encode or decode the cells of a changed tile; the other parameters are those of `code_tiles`.

    Returns the number of changes so far, `count` of which there were before.
    """
    decodes, buffer = coder[0][DECODES], coder[5]
    height, width = grid.shape
    for y in range(tile_y * TILE, min(tile_y * TILE + TILE, height)):
        for x in range(tile_x * TILE, min(tile_x * TILE + TILE, width)):
            before = cell_state(grid, x, y)
            truth = before if decodes else cell_state(target, x, y)
            known = set_cell_contexts(buffer[0], grid, x, y)
            now = code_cell(coder, known, before, truth, 0, _CELL_SET)
            if now != before:
                changes[count, 0], changes[count, 1] = y * width + x, grid[y, x]
                count += 1
                grid[y, x] = now | REPORTED
    return count


@kernel
def code_changed_box(coder: MixingCoder, changed: Grid, last: Int64s) -> Int64s:
    """Encode or decode the first and last column and row of the box of changed tiles; `last` becomes this box.

    The coder has failed if the box does not lie on the grid.
    """
    state = coder[0]
    rows, columns = changed.shape
    box = np.array([columns, rows, 0, 0])
    if not state[DECODES]:
        for y in range(rows):
            for x in range(columns):
                if changed[y, x]:
                    box[0], box[1] = min(box[0], x), min(box[1], y)
                    box[2], box[3] = max(box[2], x), max(box[3], y)
    _code_box(coder, box, last)
    if not (0 <= box[0] <= box[2] < columns and 0 <= box[1] <= box[3] < rows):
        state[FAILED] = 1
    return box


@kernel
def code_changed(coder: MixingCoder, grid: Grid, changed: Grid, box: Int64s, x: int, y: int) -> bool:
    """Encode or decode whether a tile has changed; return it unless the coder has failed."""
    _set_tile_contexts(coder[5][0], grid, changed, box, x, y)
    changed[y, x] = code_mixed(coder, _TILE_SET, 1 if changed[y, x] else 0)
    return bool(changed[y, x]) and not coder[0][FAILED]


@kernel
def code_tiles(
    coder: MixingCoder, grid: Grid, target: Grid, changed: Grid, last: Int64s, changes: Cells
) -> int:
    """Encode or decode the changed tiles, and write their cells to the grid; return the number of changed cells.

    `grid`, shape (h, w), is that of author and receiver, `target` has the states that the changed tiles shall have; a
    decoder passes any. `changed`, uint8 of shape (tile rows, tile columns), is 1 for changed tiles, at least one; a
    decoder passes zeros, and it is filled. `last`, shape (4,), has the first column and row, and the last ones, of the
    tiles of the last update; it is replaced. `changes`, shape (n, 2), receives the changed cells, as indices of the
    flat grid, and their previous values. The coder has failed if the box does not lie on the grid.
    """
    count, box = 0, code_changed_box(coder, changed, last)
    for tile_y in range(box[1], box[3] + 1):
        for tile_x in range(box[0], box[2] + 1):
            if coder[0][FAILED]:
                return count
            if code_changed(coder, grid, changed, box, tile_x, tile_y):
                count = code_cells(coder, grid, target, tile_x, tile_y, changes, count)
    return count
