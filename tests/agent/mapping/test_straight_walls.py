"""Straight walls: notches of first reports are filled, openings stay open, and the bound still holds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.mapping.bound import Bound, tiles_of
from agent.mapping.estimator import SETTLED
from agent.mapping.straight_walls import CLEARANCE, LONGEST_NOTCH
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.mapping.plain_bound import violations

SIDE = 24


def target_of(
    own: Grid, held: Grid | None = None, log_odds: NDArray[np.int8] | None = None, *, tolerance: int = 1
) -> tuple[Grid, Grid]:
    """Return the states that receivers shall hold, without and with straight walls; by default they hold nothing."""
    held = np.zeros_like(own) if held is None else held
    log_odds = np.array([0, -40, 40], np.int8)[own] if log_odds is None else log_odds
    tiles = np.ones(tiles_of(*own.shape), np.uint8)
    plain, straight = np.empty((2, *own.shape), np.uint8)
    counts = [
        Bound(tolerance, SETTLED, straightens=straightens).apply(
            own, log_odds, held, tiles, target, np.empty_like(tiles)
        )
        for target, straightens in ((plain, False), (straight, True))
    ]
    assert counts[0] == counts[1]
    return plain, straight


def room(wall_row: int = 5) -> Grid:
    """Return a grid that is free below a wall and unknown above it."""
    own = np.full((SIDE, SIDE), FREE, np.uint8)
    own[:wall_row], own[wall_row] = UNKNOWN, OCCUPIED
    return own


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("length", range(1, LONGEST_NOTCH + 2))
def test_a_notch_is_filled_unless_it_is_too_long(length: int, turned: bool) -> None:
    own = room()
    own[4, 9 : 9 + length], own[5, 9 : 9 + length] = OCCUPIED, FREE
    plain, straight = target_of(own.T.copy() if turned else own)
    wall = straight.T[5] if turned else straight[5]
    assert (plain == (own.T if turned else own)).all()
    assert (wall == OCCUPIED).all() == (length <= LONGEST_NOTCH)


@pytest.mark.parametrize("length", range(1, LONGEST_NOTCH + 1))
def test_an_opening_stays_open(length: int) -> None:
    own = room()
    own[:, 9 : 9 + length] = FREE
    assert (target_of(own)[1] == own).all()


@pytest.mark.parametrize("width", range(1, CLEARANCE + 4))
def test_a_narrow_passage_does_not_get_narrower(width: int) -> None:
    own = room()
    own[6 + width :] = OCCUPIED
    own[4, 9], own[5, 9] = OCCUPIED, FREE
    is_filled = bool((target_of(own)[1][5] == OCCUPIED).all())
    assert is_filled == (width >= CLEARANCE)


def test_walls_that_receivers_know_are_not_straightened() -> None:
    own = room()
    own[4:6, 9] = OCCUPIED, FREE
    held = own.copy()
    held[:, :8] = UNKNOWN
    _, straight = target_of(own, held)
    assert (straight == own).all()


def test_with_tolerance_0_nothing_is_straightened() -> None:
    own = room()
    own[4:6, 9] = OCCUPIED, FREE
    assert (target_of(own, tolerance=0)[1] == own).all()


@pytest.mark.parametrize("tolerance", [1, 2])
@pytest.mark.parametrize("seed", range(8))
def test_the_bound_holds_and_only_cells_that_the_author_knows_and_receivers_do_not_become_walls(
    seed: int, tolerance: int
) -> None:
    random = np.random.default_rng(seed)
    own = random.choice([UNKNOWN, FREE, OCCUPIED], (SIDE, SIDE), p=[0.2, 0.5, 0.3]).astype(np.uint8)
    held = np.where(random.random((SIDE, SIDE)) < 0.7, UNKNOWN, own).astype(np.uint8)
    log_odds = (np.array([0, -1, 1])[own] * random.integers(1, 40, own.shape)).astype(np.int8)
    plain, straight = target_of(own, held, log_odds, tolerance=tolerance)
    assert violations(own, log_odds, straight, tolerance) == []
    differ = plain != straight
    assert differ.any()
    assert (held[differ] == UNKNOWN).all()
    assert (own[differ] != UNKNOWN).all()
    assert (straight[differ] == OCCUPIED).all()
