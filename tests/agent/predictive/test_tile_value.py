"""The value of tiles for the planning of teammates, compared with a plain implementation."""

from __future__ import annotations

import numpy as np
import pytest

from agent.mapping.bound import TILE, tiles_of
from agent.predictive.tile_value import (
    FREE_TILE_BYTES,
    FRONTIER_CELLS,
    OPEN_CELLS,
    OTHER_TILE_BYTES,
    tile_values,
)
from protocol.grid import FREE, UNKNOWN, Grid

HEIGHT, WIDTH = 29, 35


def frontier(grid: Grid) -> set[tuple[int, int]]:
    """Return the free cells (y, x) beside unknown ones."""
    unknown = np.pad(grid == UNKNOWN, 1)
    beside = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    return set(zip(*(axis.tolist() for axis in np.nonzero((grid == FREE) & beside)), strict=True))


@pytest.mark.parametrize("seed", range(5))
def test_values_are_those_of_a_plain_implementation(seed: int) -> None:
    random = np.random.default_rng(seed)
    target, received = (
        np.kron(random.choice(3, (15, 18), p=[0.2, 0.7, 0.1]), np.ones((2, 2)))[:HEIGHT, :WIDTH].astype(
            np.uint8
        )
        for _ in range(2)
    )
    received[:, : 2 * TILE] = UNKNOWN
    target[:TILE, :TILE] = FREE
    tiles = random.integers(0, 2, tiles_of(HEIGHT, WIDTH), np.uint8)
    tiles[0, 0] = 1
    values = tile_values(target, received, tiles)
    marked = np.kron(tiles, np.ones((TILE, TILE)))[:HEIGHT, :WIDTH] > 0
    after = np.where(marked & (target != UNKNOWN), target, received)
    new = marked & (received == UNKNOWN) & (target != UNKNOWN)
    before, left = frontier(received), frontier(after)
    for row, column in np.ndindex(*tiles.shape):
        cells = {
            (y, x)
            for y in range(row * TILE, min(row * TILE + TILE, HEIGHT))
            for x in range(column * TILE, min(column * TILE + TILE, WIDTH))
        }
        if not tiles[row, column]:
            assert values.cells[row, column] == values.size[row, column] == 0
            assert not values.is_complete[row, column]
            continue
        closed = cells & (before - left)
        assert values.cells[row, column] == sum(new[at] for at in cells) + FRONTIER_CELLS * len(closed)
        opened = sum(new[at] for at in cells & left)
        assert values.is_complete[row, column] == (opened <= OPEN_CELLS)
        is_free = all(new[at] and target[at] == FREE for at in cells)
        assert values.size[row, column] == (FREE_TILE_BYTES if is_free else OTHER_TILE_BYTES)
    assert values.size[0, 0] == FREE_TILE_BYTES
