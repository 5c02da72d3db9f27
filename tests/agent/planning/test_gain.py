"""Expected gain: worked by hand, and against a plain ray cast."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.planning.gain import BEAMS, expected_gain
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, ray_table
from tests.agent.planning.planning_references import drawn, grids

ONE = np.array([1])


def at(x: int, y: int) -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
    return np.array([(x, y)], np.int32)


def test_the_expected_gain_is_zero_without_unknown_cells_in_sight() -> None:
    room = drawn("#####", "#...#", "#...#", "#####", "?????")
    assert expected_gain(room, at(2, 1), ONE, 10.0)[0] == 0.0


def test_the_expected_gain_grows_with_the_length_of_the_segment() -> None:
    grid: Grid = np.full((41, 41), UNKNOWN, np.uint8)
    grid[20, 20] = FREE
    shares = [
        float(expected_gain(grid, at(20, 20), np.array([length]), 10.0)[0]) for length in (1, 5, 10, 99)
    ]
    # A beam ends with the last cell whose center is in range: a little less than the whole disc is counted.
    assert shares == pytest.approx([0.16, 0.28, 0.35, 0.35], rel=0.1)
    assert shares[0] < shares[1] < shares[2] == shares[3]


def test_walls_hide_the_unknown_behind_them() -> None:
    grid: Grid = np.full((41, 41), UNKNOWN, np.uint8)
    grid[20, 20] = FREE
    whole = expected_gain(grid, at(20, 20), ONE, 10.0)[0]
    grid[:, 19] = OCCUPIED
    assert expected_gain(grid, at(20, 20), ONE, 10.0)[0] == pytest.approx(whole / 2, rel=0.1)


@given(grids(), st.floats(1.0, 9.0), st.integers(0, 2**16))
def test_the_expected_gain_equals_that_of_a_plain_ray_cast(grid: Grid, range_cells: float, pick: int) -> None:
    y, x = divmod(pick % grid.size, grid.shape[1])
    around = ray_table(range_cells, BEAMS)
    total = 0.0
    for first, end in zip(around.start[:-1].tolist(), around.start[1:].tolist(), strict=True):
        before = 0
        for dx, dy in around.cells[first:end].tolist():
            inside = 0 <= x + dx < grid.shape[1] and 0 <= y + dy < grid.shape[0]
            if not inside or grid[y + dy, x + dx] == OCCUPIED:
                break
            if grid[y + dy, x + dx] == UNKNOWN:
                total += (dx**2 + dy**2 - before) / 2
            before = dx**2 + dy**2
    share = total / (BEAMS * range_cells**2 / 2)
    floor = min(0.13 + 0.3 / range_cells, 0.35)
    assert expected_gain(grid, at(x, y), ONE, range_cells)[0] == pytest.approx(floor * share)
