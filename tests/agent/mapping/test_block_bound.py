"""Copies at half resolution: blocks have one state, the bound holds, and passages stay open."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.mapping.block_bound import BlockBound
from agent.mapping.bound import tiles_of
from agent.mapping.estimator import SETTLED
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.mapping.plain_bound import violations

SIDE = 24


def copied(
    own: Grid,
    held: Grid | None = None,
    log_odds: NDArray[np.int8] | None = None,
    *,
    openings: tuple[int, ...] = (3,),
) -> tuple[Grid, Grid, Grid]:
    """Return the copy of a grid, the changed tiles and the exact ones; by default, receivers hold nothing before."""
    held = np.zeros_like(own) if held is None else held
    log_odds = np.array([0, -40, 40], np.int8)[own] if log_odds is None else log_odds
    tiles = np.ones(tiles_of(*own.shape), np.uint8)
    target, changed, exact = np.empty_like(own), np.empty_like(tiles), np.empty_like(tiles)
    bound = BlockBound(1, SETTLED, openings=openings)
    count = bound.apply_blocks(own, log_odds, held, tiles, target, changed, exact)
    assert count == changed.sum()
    assert (exact <= changed).all()
    assert violations(own, log_odds, target, 1, blocks=True) == []
    return target, changed, exact


def room(row: int = 5) -> Grid:
    """Return a grid that is free below a wall and unknown above it."""
    own = np.full((SIDE, SIDE), FREE, np.uint8)
    own[:row], own[row] = UNKNOWN, OCCUPIED
    return own


def blocks_of(grid: Grid) -> Grid:
    """Return the states of the cells of each block, shape (rows, columns, 4)."""
    return grid.reshape(SIDE // 2, 2, SIDE // 2, 2).swapaxes(1, 2).reshape(SIDE // 2, SIDE // 2, 4)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("row", range(2, 20))
def test_a_wall_becomes_one_row_of_blocks(row: int, turned: bool) -> None:
    own = room(row)
    target, changed, exact = copied(own.T.copy() if turned else own)
    target = target.T if turned else target
    first = row // 2 * 2
    assert changed.any()
    assert not exact.any()
    assert (target[first : first + 2] == OCCUPIED).all()
    assert (target[:first] == UNKNOWN).all()
    assert (target[first + 2 :] == FREE).all()


@pytest.mark.parametrize("seed", range(5))
def test_a_wall_that_jitters_between_two_rows_of_a_block_is_straight_in_the_copy(seed: int) -> None:
    own, random = room(4), np.random.default_rng(seed)
    own[4] = np.where(random.random(SIDE) < 0.5, OCCUPIED, FREE)
    own[5] = np.where(own[4] == FREE, OCCUPIED, own[5])
    own[4, ::7], own[5, ::7] = UNKNOWN, OCCUPIED
    target, _, exact = copied(own)
    assert not exact.any()
    assert (target[4:6] == OCCUPIED).all()
    assert (target[6:] == FREE).all()


def test_a_copy_within_the_bound_does_not_change() -> None:
    own = room()
    target, _, _ = copied(own)
    for shifted in (own, np.roll(own, -1, axis=0)):
        again, changed, _ = copied(shifted, target)
        assert not changed.any()
        assert (again == target).all()


@pytest.mark.parametrize("width", range(3, 9))
@pytest.mark.parametrize("column", [8, 9])
def test_a_door_stays_open(column: int, width: int) -> None:
    own = room()
    own[:5] = FREE
    own[5, column : column + width] = FREE
    target, _, _ = copied(own)
    free = np.flatnonzero((target[4:6] == FREE).all(axis=0))
    assert len(free) >= min(3, width)
    assert (np.diff(free) == 1).all()


def test_a_tile_whose_walls_close_a_passage_is_exact() -> None:
    own = np.full((SIDE, SIDE), UNKNOWN, np.uint8)
    own[8:14] = OCCUPIED
    own[9:13] = FREE
    target, changed, exact = copied(own)
    assert exact.any()
    assert changed[1].all()
    assert ((target == FREE).sum(axis=0) >= 3).all()
    assert copied(own, openings=(2, 3))[2].any()
    assert not copied(own, openings=(2,))[2].any()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.floats(0.02, 0.4))
def test_the_bound_holds_and_blocks_of_other_tiles_change_as_a_whole(
    seed: int, unknown: float, walls: float
) -> None:
    random = np.random.default_rng(seed)
    states = np.array([UNKNOWN, FREE, OCCUPIED], np.uint8)
    own = random.choice(states, (SIDE, SIDE), p=[0.2, 0.8 - walls, walls])
    held = np.where(random.random((SIDE, SIDE)) < unknown, UNKNOWN, random.choice(states, (SIDE, SIDE)))
    log_odds = (np.array([0, -1, 1])[own] * random.integers(1, 40, own.shape)).astype(np.int8)
    target, changed, exact = copied(own, held, log_odds)
    whole = np.kron(changed & (1 - exact), np.ones((4, 4), np.uint8)) > 0
    before, after = blocks_of(held), blocks_of(target)
    is_uniform = (after == after[..., :1]).all(axis=-1)
    remains = (after == before).all(axis=-1)
    assert (is_uniform | remains)[whole].all()
    unchanged = np.kron(changed, np.ones((8, 8), np.uint8)) == 0
    assert (target[unchanged] == held[unchanged]).all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.02, 0.3))
def test_the_states_of_the_whole_grid_are_written_for_any_marked_tiles(seed: int, walls: float) -> None:
    random = np.random.default_rng(seed)
    states = np.array([UNKNOWN, FREE, OCCUPIED], np.uint8)
    own = random.choice(states, (SIDE, SIDE), p=[0.1, 0.9 - walls, walls])
    held = np.where(random.random((SIDE, SIDE)) < 0.5, own, UNKNOWN).astype(np.uint8)
    log_odds = (np.array([0, -40, 40])[own]).astype(np.int8)
    tiles = (random.random(tiles_of(SIDE, SIDE)) < 0.4).astype(np.uint8)
    outcomes = []
    for before in states:
        results = np.full_like(own, before), np.full_like(tiles, before), np.full_like(tiles, before)
        BlockBound(1, SETTLED, openings=(2, 3)).apply_blocks(own, log_odds, held, tiles, *results)
        outcomes.append(results)
    for others in outcomes[1:]:
        for result, other in zip(outcomes[0], others, strict=True):
            assert (result == other).all()
    outside = np.kron(tiles, np.ones((8, 8), np.uint8)) == 0
    assert (outcomes[0][0][outside] == held[outside]).all()
