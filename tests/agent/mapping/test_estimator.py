"""The occupancy estimator: equality with a plain second implementation, and how false walls disappear."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from agent.mapping.estimator import CLEAR, HIT, HIT_VOTES, LEAST, MOST, NEAR_LOOKS, PASS, WALL, Estimator
from protocol.grid import FREE, OCCUPIED, UNKNOWN
from protocol.range_scans import UNIT

SIDE = 40


def crossed(x: int, y: int, to_x: int, to_y: int) -> list[tuple[int, int]]:
    """Return the cells between two positions, by sorting the exact moments at which the beam crosses borders."""
    column, row = x // UNIT, y // UNIT
    moments = []
    for axis, (begin, end) in enumerate(((x, to_x), (y, to_y))):
        first, last = begin // UNIT, end // UNIT
        step = 1 if last > first else -1
        for cell in range(first, last, step):
            border = (cell + (step > 0)) * UNIT
            moments.append((Fraction(border - begin, end - begin), axis, step))
    cells = [(column, row)]
    for _, axis, step in sorted(moments):
        column, row = (column + step, row) if axis == 0 else (column, row + step)
        cells.append((column, row))
    return cells


def plain_add(odds: dict, states: dict, x: int, y: int, ends: np.ndarray, hits: np.ndarray) -> None:
    """Add a scan, cell by cell, with dictionaries."""
    votes: dict[tuple[int, int], int] = {}
    for (to_x, to_y), hit in zip(ends.tolist(), hits.tolist(), strict=True):
        cells = crossed(x, y, to_x, to_y)
        inside = [all(0 <= number < SIDE for number in cell) for cell in cells]
        reach = inside.index(False) if False in inside else len(cells)
        for cell in cells[:reach]:
            votes[cell] = votes.get(cell, 0) + (HIT_VOTES if hit and cell == cells[-1] else -1)
    for cell, vote in votes.items():
        change = HIT if vote >= 0 else PASS
        odds[cell] = min(MOST, max(LEAST, odds.get(cell, 0) + change))
        if odds[cell] > WALL:
            states[cell] = OCCUPIED
        elif odds[cell] < CLEAR:
            states[cell] = FREE


@pytest.mark.parametrize("seed", range(5))
def test_equals_a_plain_implementation_after_every_scan(seed: int) -> None:
    random = np.random.default_rng(seed)
    estimator, odds, states = Estimator(SIDE, SIDE), {}, {}
    for _ in range(12):
        x, y = random.integers(0, SIDE * UNIT, 2).tolist()
        ends = random.integers(-5 * UNIT, (SIDE + 5) * UNIT, (30, 2)).astype(np.int32)
        hits = random.random(30) < 0.7
        estimator.add(x, y, ends, hits)
        plain_add(odds, states, x, y, ends, hits)
        expected = np.full((SIDE, SIDE), UNKNOWN, np.uint8)
        for (column, row), state in states.items():
            expected[row, column] = state
        assert np.array_equal(estimator.states, expected)
        assert all(estimator.log_odds[row, column] == value for (column, row), value in odds.items())


def test_a_false_wall_disappears_after_beams_have_passed_through_it() -> None:
    estimator = Estimator(8, 8)
    end = np.array([[5 * UNIT + 128, 128]], np.int32)
    beyond = np.array([[7 * UNIT + 128, 128]], np.int32)
    estimator.add(128, 128, end, np.array([True]))
    assert estimator.states[0, 5] == OCCUPIED
    assert estimator.stand(3, 3).cells == 1
    assert estimator.strike(3, 3).cells == 1
    assert estimator.states[3, 3] == OCCUPIED
    assert not estimator.strike(8, 3).cells
    scans = math.ceil((HIT - CLEAR + 1) / -PASS)
    for _ in range(scans):
        estimator.add(128, 128, beyond, np.array([True]))
    assert estimator.states[0, 5] == FREE


def test_unknown_cells_that_no_scan_from_nearby_enters_are_walls_until_a_beam_does() -> None:
    estimator = Estimator(9, 9)
    estimator.states[4, 2:6] = FREE
    estimator.states[3, 4] = OCCUPIED
    for _ in range(NEAR_LOOKS - 1):
        assert not estimator.close(2, 4, 4, (0, 0), (0, 0)).cells
    change = estimator.close(2, 4, 4, (0, 0), (0, 0))
    closed = np.argwhere(estimator.states == OCCUPIED).tolist()
    assert {(1, 4), (6, 4), (2, 3), (2, 5)} <= {(x, y) for y, x in closed}
    assert change.cells == len(closed) - 1 == estimator.known_cells
    assert estimator.states[2, 4] == UNKNOWN, "behind the wall"
    middle = np.array([[6 * UNIT + 128, 4 * UNIT + 128]], np.int32)
    estimator.add(2 * UNIT + 128, 4 * UNIT + 128, middle, np.array([False]))
    assert estimator.states[4, 6] == FREE


@pytest.mark.parametrize(
    ("first", "last", "seen"),
    [
        ((1, -1), (1, 1), {(5, 4)}),
        ((0, -1), (0, 1), {(5, 4), (4, 3), (4, 5)}),
        ((-1, -1), (-1, 1), {(5, 4), (4, 3), (4, 5)}),
        ((0, 0), (0, 0), {(5, 4), (4, 3), (4, 5), (3, 4)}),
    ],
)
def test_only_cells_in_the_field_of_view_are_closed(
    first: tuple[int, int], last: tuple[int, int], seen: set[tuple[int, int]]
) -> None:
    estimator = Estimator(9, 9)
    estimator.states[4, 4] = FREE
    for _ in range(NEAR_LOOKS):
        estimator.close(4, 4, 2, first, last)
    assert {(x, y) for y, x in np.argwhere(estimator.states == OCCUPIED).tolist()} == seen
