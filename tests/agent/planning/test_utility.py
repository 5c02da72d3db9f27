"""Utilities, compared with their equations, and lines of sight with the plainest line of cells."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.planning.utility import in_sight, utilities
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.planning.planning_references import drawn

seeds = st.integers(0, 2**32 - 1)
Cell = tuple[int, int]


@st.composite
def scenes(draw: st.DrawFn) -> tuple[Grid, list[Cell], list[Cell], float]:
    """A random grid, some cells and some targets on it, and a sensor range."""
    rng = np.random.default_rng(draw(seeds))
    height, width = rng.integers(1, 18, 2)
    walls = draw(st.sampled_from((0.0, 0.05, 0.3)))
    grid = rng.choice(
        np.array([UNKNOWN, FREE, OCCUPIED], np.uint8), (height, width), p=[0.2, 0.8 - walls, walls]
    )
    somewhere = st.tuples(st.integers(0, int(width) - 1), st.integers(0, int(height) - 1))
    return (
        grid,
        draw(st.lists(somewhere, max_size=8)),
        draw(st.lists(somewhere, max_size=4)),
        draw(st.floats(1, 20)),
    )


def line(one: Cell, other: Cell) -> list[Cell]:
    """Bresenham's line, from the upper end (of two on one height, the left one), as textbooks write it."""
    (x, y), (end_x, end_y) = sorted((one, other), key=lambda cell: (cell[1], cell[0]))
    dx, dy = abs(end_x - x), -(end_y - y)
    step = 1 if x < end_x else -1
    error = dx + dy
    cells = [(x, y)]
    while (x, y) != (end_x, end_y):
        twice = 2 * error
        if twice > dy:
            error += dy
            x += step
        if twice < dx:
            error += dx
            y += 1
        cells.append((x, y))
    return cells


@given(scenes())
def test_a_line_of_sight_is_free_of_obstacles_and_the_same_from_both_ends(scene: Any) -> None:
    grid, cells, targets, _ = scene
    for one in cells:
        for other in targets:
            seen = in_sight(grid, *one, *other)
            assert seen == in_sight(grid, *other, *one)
            assert seen == all(grid[y, x] != OCCUPIED for x, y in line(one, other))


@given(st.tuples(st.integers(0, 40), st.integers(0, 40)), st.tuples(st.integers(0, 40), st.integers(0, 40)))
def test_only_cells_beside_the_straight_line_block_the_line_of_sight(one: Cell, other: Cell) -> None:
    grid = np.full((41, 41), OCCUPIED, np.uint8)
    length = math.dist(one, other)
    ys, xs = np.mgrid[0:41, 0:41]
    off = abs((xs - one[0]) * (other[1] - one[1]) - (ys - one[1]) * (other[0] - one[0]))
    along = (xs - one[0]) * (other[0] - one[0]) + (ys - one[1]) * (other[1] - one[1])
    near = (off <= length * math.sqrt(0.5) + 1e-9) & (along >= 0) & (along <= length**2 + 1e-6)
    grid[near] = FREE
    assert in_sight(grid, *one, *other)


@given(scenes(), st.booleans())
def test_utilities_are_those_of_equations_4_4_and_4_5(scene: Any, weigh: bool) -> None:
    grid, cells, targets, range_cells = scene
    ranges = [range_cells * (number + 1) for number in range(len(targets))] if weigh else range_cells
    weights = [0.25 * (number + 1) for number in range(len(targets))] if weigh else None
    wanted = []
    for cell in cells:
        utility = 1.0
        for number, target in enumerate(targets):
            distance = math.dist(cell, target)
            if all(grid[y, x] != OCCUPIED for x, y in line(cell, target)):
                utility -= (weights[number] if weights else 1.0) * max(
                    0.0, 1 - distance / np.broadcast_to(ranges, len(targets))[number]
                )
        wanted.append(utility)
    array = np.array(cells, np.int32).reshape(-1, 2)
    found = utilities(grid, array, targets, ranges, weights)
    assert found.shape == (len(cells),)
    assert found.tolist() == pytest.approx(wanted, abs=1e-12)


def test_without_targets_every_cell_is_worth_1() -> None:
    cells = np.array([[0, 0], [2, 1]], np.int32)
    assert utilities(drawn("...", "..."), cells, [], 5.0).tolist() == [1.0, 1.0]


def test_a_targets_own_cell_is_worth_nothing_and_one_out_of_range_all() -> None:
    grid = np.full((1, 30), FREE, np.uint8)
    cells = np.array([[5, 0], [10, 0], [15, 0], [25, 0]], np.int32)
    assert utilities(grid, cells, [(5, 0)], 10.0).tolist() == [0.0, 0.5, 1.0, 1.0]


def test_a_wall_keeps_the_utility_of_cells_behind_it() -> None:
    grid = drawn("...#...")
    cells = np.array([[2, 0], [4, 0]], np.int32)
    assert utilities(grid, cells, [(0, 0)], 10.0).tolist() == pytest.approx([0.2, 1.0])


def test_unknown_cells_do_not_block_the_line_of_sight() -> None:
    assert in_sight(drawn(".?."), 0, 0, 2, 0)
    assert not in_sight(drawn(".#."), 0, 0, 2, 0)
    assert not in_sight(drawn(".#"), 0, 0, 1, 0)
    assert in_sight(drawn("."), 0, 0, 0, 0)


def test_targets_in_the_same_place_count_each() -> None:
    grid = np.full((1, 11), FREE, np.uint8)
    cells = np.array([[5, 0]], np.int32)
    assert utilities(grid, cells, [(0, 0), (0, 0), (10, 0)], 10.0).tolist() == pytest.approx([-0.5])
