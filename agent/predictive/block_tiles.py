"""Code changes of a grid as tiles at half resolution (for maps of noisy lasers on narrow media).

The box of changed tiles, and the bit of each tile in it, are coded as in `agent.predictive.tiles`. In a changed tile,
one more bit says whether it is exact. An exact tile has the resolution of cells, and is coded as there. In any other
tile, one bit per block of 2 by 2 cells says whether the state of the block has changed (`agent.mapping.blocks`), and
another which of the two other states it has now. All cells of a changed block get its state. The contexts of a block
are like those of a cell, but have counts of their own: its neighbors are blocks.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from agent.mapping.blocks import BLOCK, block_state
from agent.mapping.bound import TILE
from agent.predictive import tiles
from agent.predictive.coder import DECODES, FAILED
from agent.predictive.mixer import MixingCoder, Model, code_mixed, new_model
from agent.predictive.model_table import shipped_model
from agent.predictive.scan_updates import REPORTED, STATE
from agent.predictive.tiles import (
    CELL_CONTEXTS,
    code_cell,
    code_cells,
    code_changed,
    code_changed_box,
    set_cell_contexts,
)
from protocol.arrays import Cells, Int64s
from protocol.grid import Grid
from protocol.kernels import kernel

_BLOCKS = tiles.CONTEXTS
_EXACT = _BLOCKS + 6 * CELL_CONTEXTS
"""Contexts of whether a tile is exact: those of the tiles to the left and above are, and one for any tile."""

CONTEXTS = _EXACT + 5

_BLOCK_SET = tiles.SETS
_EXACT_SET = _BLOCK_SET + 5 * 6

SETS = _EXACT_SET + 1

_ACROSS = TILE // BLOCK
"""Blocks in a row of a tile."""

_REACH = 4
"""Blocks around a tile that contexts of its blocks may read."""

TABLE = Path(__file__).with_name("block_tile_start.npz")
"""The shipped table: the initial model of every log, trained on generated maps (`deploy.study.tile_table`)."""


def start_model() -> Model:
    """Return a copy of the initial model of every log."""
    return shipped_model(TABLE, CONTEXTS, SETS)


def untrained_model() -> Model:
    """Return a model that has been trained on tiles of cells only (`agent.predictive.tiles`)."""
    chances, ages, weights = new_model(CONTEXTS, SETS)
    trained = tiles.start_model()
    chances[:, : tiles.CONTEXTS], ages[:, : tiles.CONTEXTS], weights[: tiles.SETS] = trained
    return chances, ages, weights


@kernel
def _read_blocks(grid: Grid, blocks: Grid, x0: int, y0: int, x1: int, y1: int) -> None:
    """Write the states of some blocks, given by the first column and row, and those behind the last ones."""
    for y in range(max(0, y0), min(y1, blocks.shape[0])):
        for x in range(max(0, x0), min(x1, blocks.shape[1])):
            blocks[y, x] = block_state(grid, x, y)


@kernel
def _code_exact(coder: MixingCoder, exact: Grid, box: Int64s, x: int, y: int) -> int:
    """Encode or decode whether a changed tile is exact."""
    left = np.int64(exact[y, x - 1]) if x > box[0] else 0
    up = np.int64(exact[y - 1, x]) if y > box[1] else 0
    coder[5][0, :] = _EXACT + 2 * left + up
    coder[5][0, 0] = _EXACT + 4
    exact[y, x] = code_mixed(coder, _EXACT_SET, 1 if exact[y, x] else 0)
    return int(exact[y, x])


@kernel
def _write_block(grid: Grid, x: int, y: int, state: int, changes: Cells, count: int) -> int:
    """Write a block, given in blocks, to the grid, and its changed cells to `changes`; return their number so far."""
    height, width = grid.shape
    for row in range(BLOCK * y, min(BLOCK * y + BLOCK, height)):
        for column in range(BLOCK * x, min(BLOCK * x + BLOCK, width)):
            if grid[row, column] & STATE != state:
                changes[count, 0], changes[count, 1] = row * width + column, grid[row, column]
                count += 1
                grid[row, column] = state | REPORTED
    return count


@kernel
def _code_blocks(
    coder: MixingCoder,
    grid: Grid,
    blocks: Grid,
    target: Grid,
    tile_x: int,
    tile_y: int,
    changes: Cells,
    count: int,
) -> int:
    """Encode or decode the blocks of a changed tile; `blocks` has their states. Otherwise as `code_cells`."""
    for y in range(tile_y * _ACROSS, min(tile_y * _ACROSS + _ACROSS, blocks.shape[0])):
        for x in range(tile_x * _ACROSS, min(tile_x * _ACROSS + _ACROSS, blocks.shape[1])):
            before = int(blocks[y, x])
            truth = before if coder[0][DECODES] else block_state(target, x, y)
            known = set_cell_contexts(coder[5][0], blocks, x, y)
            now = code_cell(coder, known, before, truth, _BLOCKS, _BLOCK_SET)
            if now != before:
                blocks[y, x] = now
                count = _write_block(grid, x, y, now, changes, count)
    return count


@kernel
def code_block_tiles(
    coder: MixingCoder, grid: Grid, target: Grid, changed: Grid, exact: Grid, last: Int64s, changes: Cells
) -> int:
    """Encode or decode the changed tiles, and write their cells to the grid.

    `exact`, uint8 of the shape of `changed`, is 1 for changed tiles that are exact; a decoder passes zeros, and it is
    filled. In the other changed tiles, each block of `target` has one state, or those of the grid if the state of the
    block remains. Otherwise as `agent.predictive.tiles.code_tiles`.
    """
    height, width = grid.shape
    blocks = np.zeros((-(-height // BLOCK), -(-width // BLOCK)), np.uint8)
    count, box = 0, code_changed_box(coder, changed, last)
    if coder[0][FAILED]:
        return count
    first, end = box[:2] * _ACROSS, (box[2:] + 1) * _ACROSS
    _read_blocks(grid, blocks, first[0] - _REACH, first[1] - _REACH, end[0] + _REACH, end[1] + _REACH)
    for tile_y in range(box[1], box[3] + 1):
        for tile_x in range(box[0], box[2] + 1):
            if coder[0][FAILED]:
                return count
            if not code_changed(coder, grid, changed, box, tile_x, tile_y):
                continue
            if _code_exact(coder, exact, box, tile_x, tile_y):
                count = code_cells(coder, grid, target, tile_x, tile_y, changes, count)
                x, y = tile_x * _ACROSS, tile_y * _ACROSS
                _read_blocks(grid, blocks, x, y, x + _ACROSS, y + _ACROSS)
            else:
                count = _code_blocks(coder, grid, blocks, target, tile_x, tile_y, changes, count)
    return count
