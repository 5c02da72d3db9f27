"""The bounded error holds at every receiver, cell by cell, after arbitrary sequences of noisy grids."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.mapping.bound import TILE, apply_bound, mark_tiles
from agent.mapping.estimator import SETTLED
from agent.predictive.coder import check_end, reader, writer, written
from agent.predictive.mixer import mixing_coder
from agent.predictive.tiles import STATE, code_tiles, start_model
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid

SIDE = 40
REPORTED = 4
AUTHORS = 3


def walls_near(grid: Grid, x: int, y: int) -> int:
    """Count the walls within one cell."""
    cells = [(x + dx, y + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
    return sum(
        0 <= column < SIDE and 0 <= row < SIDE and grid[row, column] == OCCUPIED for column, row in cells
    )


def violations(own: Grid, settled: NDArray[np.bool_], held: Grid) -> list[tuple[str, int, int]]:
    """Return the cells that violate one of the three conditions."""
    found = []
    for y, x in np.argwhere(settled).tolist():
        if own[y, x] == OCCUPIED and not walls_near(held, x, y):
            found.append(("missing wall", x, y))
        if own[y, x] == FREE and held[y, x] == OCCUPIED and not walls_near(own, x, y):
            found.append(("invented wall", x, y))
        if own[y, x] == FREE and held[y, x] != FREE and not walls_near(held, x, y):
            found.append(("missing free cell", x, y))
    return found


class Side:
    """One map's log at its author or at a receiver: the grid, and the model of the code."""

    def __init__(self) -> None:
        self.grid = np.zeros((SIDE, SIDE), np.uint8)
        self.model, self.last = start_model(), np.full(4, SIDE // TILE // 2, np.int64)
        self.changes = np.empty((SIDE * SIDE, 2), np.int32)

    def overlay(self, places: NDArray[np.int32], states: NDArray[np.uint8]) -> NDArray[np.int32]:
        """Write another author's report where this map's author has reported nothing; return the changed places."""
        flat = self.grid.reshape(-1)
        open_ = (flat[places] & REPORTED == 0) & (flat[places] != states)
        flat[places[open_]] = states[open_]
        return places[open_]

    def encode(self, target: Grid, changed: Grid) -> tuple[bytes, int]:
        """Encode an update and apply it; return it and the number of changed cells."""
        state, data = writer(1 << 14)
        coder = mixing_coder(state, data, self.model)
        count = code_tiles(coder, self.grid, target, changed, self.last, REPORTED, self.changes)
        return written(state, data), count

    def decode(self, message: bytes) -> Grid:
        """Decode an update and apply it; return the changed tiles."""
        state, data = reader(message)
        changed = np.zeros((SIDE // TILE, SIDE // TILE), np.uint8)
        coder = mixing_coder(state, data, self.model)
        code_tiles(coder, self.grid, self.grid, changed, self.last, REPORTED, self.changes)
        check_end(state, "update")
        return changed


def disturb(random: np.random.Generator, own: Grid, log_odds: NDArray[np.int8]) -> tuple[int, int, int, int]:
    """Replace a box of an estimate by noise; return the box."""
    x0, y0 = random.integers(0, SIDE - 1, 2).tolist()
    x1, y1 = min(SIDE, x0 + int(random.integers(1, 16))), min(SIDE, y0 + int(random.integers(1, 16)))
    shape = (y1 - y0, x1 - x0)
    states = random.choice([UNKNOWN, FREE, OCCUPIED], shape, p=[0.2, 0.7, 0.1]).astype(np.uint8)
    own[y0:y1, x0:x1] = states
    log_odds[y0:y1, x0:x1] = np.array([0, -1, 1])[states] * random.integers(1, 40, shape)
    return x0, y0, x1, y1


@pytest.mark.parametrize("seed", range(4))
def test_the_bound_holds_at_every_receiver_after_every_update(seed: int) -> None:
    random = np.random.default_rng(seed)
    authors, receivers = [Side() for _ in range(AUTHORS)], [Side() for _ in range(AUTHORS)]
    own = np.zeros((AUTHORS, SIDE, SIDE), np.uint8)
    log_odds = np.zeros((AUTHORS, SIDE, SIDE), np.int8)
    tiles = np.zeros((AUTHORS, SIDE // TILE, SIDE // TILE), np.uint8)
    logs: list[list[tuple[NDArray[np.int32], NDArray[np.uint8]]]] = [[] for _ in range(AUTHORS)]
    read = np.zeros((AUTHORS, AUTHORS), np.int64)
    target = np.empty((SIDE, SIDE), np.uint8)
    changed = np.empty((SIDE // TILE, SIDE // TILE), np.uint8)
    sent = 0
    for _ in range(60):
        map_id = int(random.integers(AUTHORS))
        author, receiver = authors[map_id], receivers[map_id]
        for _ in range(int(random.integers(4))):
            mark_tiles(tiles[map_id], disturb(random, own[map_id], log_odds[map_id]))
        for other in set(range(AUTHORS)) - {map_id}:
            for places, states in logs[other][read[map_id, other] :]:
                for place in author.overlay(places, states).tolist():
                    x, y = place % SIDE, place // SIDE
                    mark_tiles(tiles[map_id], (x, y, x + 1, y + 1))
                receiver.overlay(places, states)
            read[map_id, other] = len(logs[other])
        if apply_bound(own[map_id], log_odds[map_id], author.grid, tiles[map_id], target, changed):
            expected = changed.copy()
            message, count = author.encode(target, changed)
            assert np.array_equal(receiver.decode(message), expected)
            places = author.changes[:count, 0].copy()
            logs[map_id].append((places, author.grid.reshape(-1)[places] & np.uint8(STATE)))
            sent += 1
        tiles[map_id] = 0
        assert np.array_equal(receiver.grid, author.grid)
        settled = np.abs(log_odds[map_id]) >= SETTLED
        assert violations(own[map_id], settled, receiver.grid & np.uint8(STATE)) == []
    assert sent > 30


def grids(edit: Callable[[Grid, NDArray[np.int8], Grid], None]) -> tuple[int, Grid]:
    """Apply the bound to an edited pair of free grids; return the number of changed tiles and the target."""
    own, held = np.full((2, 16, 16), FREE, np.uint8)
    log_odds = np.full((16, 16), -40, np.int8)
    edit(own, log_odds, held)
    target, changed = np.empty_like(held), np.empty((2, 2), np.uint8)
    return apply_bound(own, log_odds, held, np.ones((2, 2), np.uint8), target, changed), target


def test_a_wall_one_cell_away_is_not_sent_again_but_two_cells_away_it_is() -> None:
    def shifted(by: int) -> Callable[[Grid, NDArray[np.int8], Grid], None]:
        def edit(own: Grid, log_odds: NDArray[np.int8], held: Grid) -> None:
            own[5], log_odds[5], held[5 + by] = OCCUPIED, 40, OCCUPIED

        return edit

    assert grids(shifted(0))[0] == 0
    assert grids(shifted(1))[0] == 0
    changed, target = grids(shifted(2))
    assert changed == 2
    assert (target[5] == OCCUPIED).any()
    assert (target[7] == FREE).all()


def test_a_cell_that_is_not_settled_is_not_sent() -> None:
    def speck(own: Grid, log_odds: NDArray[np.int8], held: Grid) -> None:
        own[5, 5], log_odds[5, 5] = OCCUPIED, SETTLED - 1

    assert grids(speck)[0] == 0


def test_a_free_cell_of_the_next_tile_is_sent_if_the_wall_near_it_is_removed() -> None:
    own, held = np.full((2, 16, 16), FREE, np.uint8)
    held[4, 7:9] = OCCUPIED, UNKNOWN
    tiles, target, changed = np.zeros((2, 2), np.uint8), np.empty_like(held), np.empty((2, 2), np.uint8)
    mark_tiles(tiles, (6, 4, 7, 5))  # there was a wall in (6, 4)
    assert apply_bound(own, np.full((16, 16), -40, np.int8), held, tiles, target, changed) == 2
    assert (target == FREE).all()
