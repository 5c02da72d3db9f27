"""The bounded error of shared maps: which cells receivers must be sent."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.mapping.bound import Bound, tiles_of
from agent.mapping.estimator import SETTLED
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.mapping.plain_bound import violations

SIDE = 20
Edit = Callable[[Grid, NDArray[np.int8], Grid], None]


def applied(edit: Edit, tolerance: int = 1) -> tuple[int, Grid]:
    """Apply the bound to an edited pair of free grids; return the number of changed tiles and the target."""
    own, held = np.full((2, SIDE, SIDE), FREE, np.uint8)
    log_odds = np.full((SIDE, SIDE), -40, np.int8)
    edit(own, log_odds, held)
    tiles = tiles_of(SIDE, SIDE)
    target, changed = np.empty_like(held), np.empty(tiles, np.uint8)
    bound = Bound(tolerance, SETTLED)
    count = bound.apply(own, log_odds, held, np.ones(tiles, np.uint8), target, changed)
    assert violations(own, log_odds, target, tolerance) == []
    assert count == changed.sum()
    return count, target


def shifted(by: int) -> Edit:
    """Let receivers hold a wall `by` rows beside the robot's own."""

    def edit(own: Grid, log_odds: NDArray[np.int8], held: Grid) -> None:
        own[5], log_odds[5], held[5 + by] = OCCUPIED, 40, OCCUPIED

    return edit


@pytest.mark.parametrize("tolerance", [0, 1, 2, 4])
def test_a_wall_within_the_tolerance_is_not_sent_again_but_one_cell_farther_it_is(tolerance: int) -> None:
    assert applied(shifted(0), tolerance)[0] == 0
    assert applied(shifted(tolerance), tolerance)[0] == 0
    changed, target = applied(shifted(tolerance + 1), tolerance)
    assert changed > 0
    assert (target[5] == OCCUPIED).any()
    assert (target[6 + tolerance] == FREE).all()


def test_a_wall_that_is_not_settled_does_not_replace_free_cells() -> None:
    def speck(own: Grid, log_odds: NDArray[np.int8], held: Grid) -> None:
        own[5, 5], log_odds[5, 5] = OCCUPIED, SETTLED - 1

    assert applied(speck)[0] == 0
    assert applied(speck, tolerance=0)[0] == 1


def test_an_area_seen_once_is_sent_but_single_beams_into_unknown_cells_are_not() -> None:
    def seen(rows: slice) -> Edit:
        def edit(own: Grid, log_odds: NDArray[np.int8], held: Grid) -> None:
            own[:8], held[:8] = UNKNOWN, UNKNOWN
            own[rows], log_odds[:8] = FREE, 0
            log_odds[rows] = -8

        return edit

    assert applied(seen(slice(2, 3)))[0] == 0
    changed, target = applied(seen(slice(2, 6)))
    assert changed == 3
    assert (target[3:5] == FREE).all()


def test_with_tolerance_0_receivers_hold_every_known_cell() -> None:
    random = np.random.default_rng(3)
    states = random.integers(0, 3, (2, SIDE, SIDE)).astype(np.uint8)

    def noise(own: Grid, log_odds: NDArray[np.int8], held: Grid) -> None:
        own[:], held[:] = states
        log_odds[:] = np.array([0, -1, 1], np.int8)[own]

    _, target = applied(noise, tolerance=0)
    own = states[0]
    assert (target[own != UNKNOWN] == own[own != UNKNOWN]).all()


def test_a_free_cell_of_the_next_tile_is_sent_if_the_wall_near_it_is_removed() -> None:
    bound = Bound(1, SETTLED)
    own, held = np.full((2, 16, 16), FREE, np.uint8)
    held[4, 7:9] = OCCUPIED, UNKNOWN
    tiles, target, changed = np.zeros((2, 2), np.uint8), np.empty_like(held), np.empty((2, 2), np.uint8)
    tiles[bound.tiles_near((6, 4, 7, 5))] = 1  # there was a wall in (6, 4)
    assert bound.apply(own, np.full((16, 16), -40, np.int8), held, tiles, target, changed) == 2
    assert (target[:8] == FREE).all()


@pytest.mark.parametrize("tolerance", [1, 2])
def test_a_wall_that_is_not_settled_closes_a_gap_before_unknown_cells(tolerance: int) -> None:
    def gap(own: Grid, log_odds: NDArray[np.int8], held: Grid) -> None:
        own[:5], held[:5] = UNKNOWN, UNKNOWN
        own[5], log_odds[:6] = OCCUPIED, SETTLED - 1

    changed, target = applied(gap, tolerance)
    assert changed == 3
    assert (target[5] == OCCUPIED).all()


def test_a_cell_that_the_robot_has_seen_free_remains_a_frontier() -> None:
    def opening(own: Grid, log_odds: NDArray[np.int8], held: Grid) -> None:
        own[:5], held[:5] = UNKNOWN, UNKNOWN
        own[5, 8:12] = OCCUPIED
        log_odds[:6] = SETTLED - 1

    _, target = applied(opening)
    assert (target[5, 8:12] == OCCUPIED).all()
    assert (target[5, :8] == FREE).all()
