"""Planning grids of noisy lasers: narrow gaps are no frontiers, and a robot is never enclosed on its own way."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from agent.planning.noisy_grid import NARROW, NoisyGrid
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid


def plain_clean(grid: Grid) -> Grid:
    """Remove narrow gaps, cell by cell."""
    height, width = grid.shape
    wide = np.zeros(grid.shape, np.bool_)
    for y in range(height - NARROW + 1):
        for x in range(width - NARROW + 1):
            if (grid[y : y + NARROW, x : x + NARROW] == UNKNOWN).all():
                wide[y : y + NARROW, x : x + NARROW] = True
    cleaned = grid.copy()
    for y, x in np.argwhere((grid == UNKNOWN) & ~wide).tolist():
        around = grid[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2]
        cleaned[y, x] = OCCUPIED if (around == OCCUPIED).any() else FREE
    return cleaned


@given(st.integers(0, 2**32 - 1), st.sampled_from((0.1, 0.5, 0.8)))
def test_gaps_disappear_as_in_a_plain_implementation_at_every_call(seed: int, unknown: float) -> None:
    random = np.random.default_rng(seed)
    shape = tuple(random.integers(1, 20, 2).tolist())
    noisy = NoisyGrid(*shape)
    for _ in range(2):
        states = np.array([UNKNOWN, FREE, OCCUPIED], np.uint8)
        grid = random.choice(states, shape, p=[unknown, (1 - unknown) / 2, (1 - unknown) / 2])
        assert np.array_equal(noisy.clean(grid), plain_clean(grid))


def test_the_way_that_a_robot_has_driven_stays_open() -> None:
    grid = np.full((20, 20), OCCUPIED, np.uint8)
    noisy = NoisyGrid(20, 20)
    noisy.drive(2, 3)
    noisy.drive(9, 6)
    free = np.argwhere(noisy.clean(grid) == FREE).tolist()
    assert [3, 2] in free
    assert [6, 9] in free
    assert len(free) == 1 + 7 + 3, "cells are 4-neighbors of each other"


def test_an_obstacle_on_the_way_closes_it() -> None:
    grid = np.full((5, 20), OCCUPIED, np.uint8)
    noisy = NoisyGrid(5, 20)
    noisy.drive(2, 3)
    noisy.drive(9, 3)
    noisy.bump(8, 3)
    noisy.bump(9, 3)
    noisy.bump(-1, 40)
    cleaned = noisy.clean(grid)
    assert cleaned[3, 8] == OCCUPIED
    assert cleaned[3, 9] == FREE, "the robot's own cell"
