"""Costs from cells to goals, bit for bit as a plain search in whole numbers has them; what is reached."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from agent.planning.cost_field import costs
from agent.planning.frontier import Floor
from agent.planning.jump_point_search import GoalCosts, costs_between
from agent.planning.path_planner import PathPlanner
from protocol.grid import FREE, OCCUPIED, Grid
from tests.agent.planning.planning_references import drawn, floors, whole_lengths

seeds = st.integers(0, 2**32 - 1)
counts = st.integers(0, 9)


def some_cells(grid: Grid, rng: np.random.Generator, count: int) -> NDArray[np.int32]:
    """Cells (x, y), free or not, now and then the same one twice."""
    height, width = grid.shape
    return np.stack([rng.integers(0, width, count), rng.integers(0, height, count)], 1).astype(np.int32)


@given(floors(), counts, counts, seeds)
def test_costs_between_cells_are_those_of_a_plain_search_to_the_last_bit(
    case: tuple[Grid, int, int], starts: int, goals: int, seed: int
) -> None:
    grid, *_ = case
    rng = np.random.default_rng(seed)
    from_cells, to_cells = some_cells(grid, rng, starts), some_cells(grid, rng, goals)
    found = costs_between(Floor(grid), from_cells, to_cells)
    assert found.shape == (starts, goals)
    for cell, row in zip(from_cells.tolist(), found, strict=True):
        assert row.tobytes() == whole_lengths(grid, *cell)[to_cells[:, 1], to_cells[:, 0]].tobytes()


@given(floors(), counts, counts, seeds)
def test_costs_among_goals_equal_those_of_a_search_from_each_goal(
    case: tuple[Grid, int, int], starts: int, goals: int, seed: int
) -> None:
    grid, *_ = case
    rng = np.random.default_rng(seed)
    free = np.argwhere(grid == FREE)[:, ::-1].astype(np.int32)
    from_cells, to_cells = some_cells(grid, rng, starts), free[rng.integers(0, len(free), goals)]
    ways, between = GoalCosts(to_cells).among(Floor(grid), from_cells)
    assert ways.tobytes() == costs_between(Floor(grid), from_cells, to_cells).tobytes()
    assert between.tobytes() == costs_between(Floor(grid), to_cells, to_cells).tobytes()


@given(floors(), counts, counts, seeds)
def test_shared_costs_equal_those_of_a_search_of_their_own(
    case: tuple[Grid, int, int], starts: int, goals: int, seed: int
) -> None:
    grid, *_ = case
    rng, floor = np.random.default_rng(seed), Floor(grid)
    free = np.argwhere(grid == FREE)[:, ::-1].astype(np.int32)
    shared = GoalCosts(free[rng.integers(0, len(free), goals)])
    for _ in range(3):
        from_cells = some_cells(grid, rng, starts)
        expected = GoalCosts(shared.goals).among(floor, from_cells)
        assert shared.ways(floor, from_cells).tobytes() == expected[0].tobytes()
        for found, each in zip(shared.among(floor, from_cells), expected, strict=True):
            assert found.tobytes() == each.tobytes()


def test_a_start_far_from_all_free_cells_has_no_way_and_one_beside_them_has() -> None:
    grid = np.full((40, 30), OCCUPIED, np.uint8)
    grid[20:24, 10:15] = FREE
    starts = np.array([(0, 0), (29, 39), (9, 21), (8, 21), (12, 22)], np.int32)
    goals = np.array([(10, 20), (14, 23)], np.int32)
    found = costs_between(Floor(grid), starts, goals)
    for cell, row in zip(starts.tolist(), found, strict=True):
        assert row.tobytes() == whole_lengths(grid, *cell)[goals[:, 1], goals[:, 0]].tobytes()
    assert np.isfinite(found).all(axis=1).tolist() == [False, False, True, False, True]


@given(floors())
def test_with_every_cell_a_goal_the_whole_field_is_found(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    ys, xs = np.mgrid[: grid.shape[0], : grid.shape[1]]
    goals = np.stack([xs.ravel(), ys.ravel()], 1).astype(np.int32)
    found = costs_between(Floor(grid), np.array([(x, y)], np.int32), goals)
    assert found.tobytes() == whole_lengths(grid, x, y).tobytes()


@pytest.mark.parametrize("walls", [0.0, 0.003, 0.05, 0.2, 0.35])
def test_on_large_floors_costs_are_those_of_the_search_that_settles_all_cells(walls: float) -> None:
    rng = np.random.default_rng(7)
    for shape in ((400, 300), (17, 1200), (300, 301)):
        grid = np.where(rng.random(shape) < walls, OCCUPIED, FREE).astype(np.uint8)
        floor = Floor(grid)
        starts, goals = some_cells(grid, rng, 6), some_cells(grid, rng, 80)
        fields = [costs(floor, x, y)[goals[:, 1], goals[:, 0]] for x, y in starts.tolist()]
        assert (costs_between(floor, starts, goals) == np.array(fields)).all()


def test_a_way_through_a_maze_of_a_hundred_thousand_cells_is_not_too_long() -> None:
    grid = np.full((401, 500), FREE, np.uint8)
    grid[1::2, :] = OCCUPIED
    grid[1::4, -1] = FREE
    grid[3::4, 0] = FREE
    ends = np.array([(0, 0), (0, 400)], np.int32)
    assert costs_between(Floor(grid), ends[:1], ends).tolist() == [[0, 200 * 499 + 400]]


def test_a_search_finds_the_same_whatever_was_searched_before_it() -> None:
    open_floor, walled = Floor(drawn("....", "....", "....")), Floor(drawn("..#.", "..#.", "..#."))
    ends = np.array([(0, 0), (3, 2)], np.int32)
    for _ in range(2):
        assert costs_between(open_floor, ends[:1], ends).tolist() == [
            [0, pytest.approx(1 + 2 * math.sqrt(2))]
        ]
        assert costs_between(walled, ends[:1], ends).tolist() == [[0, math.inf]]
    assert costs(Floor(drawn("...", "...", "...")), 0, 0)[2, 2] == pytest.approx(2 * math.sqrt(2))


@pytest.mark.parametrize("kind", ["shortest", "weighted"])
def test_costs_between_cells_equal_those_of_the_whole_field(kind: str) -> None:
    grid = drawn("......?", ".####..", ".#...#.", "...#...")
    starts, goals = np.array([(0, 0), (6, 3)], np.int32), np.array([(2, 2), (5, 0), (4, 3)], np.int32)
    planner = PathPlanner(grid, kind)
    found = planner.costs_between(starts, goals)
    for (x, y), row in zip(starts.tolist(), found, strict=True):
        assert row.tolist() == planner.costs(x, y)[goals[:, 1], goals[:, 0]].tolist()


@given(floors())
def test_the_reachable_cells_are_the_4_connected_part_of_the_floor(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    grid[y, x] = FREE
    areas, _ = ndimage.label(grid == FREE)
    assert (np.isfinite(costs(Floor(grid), x, y)) == (areas == areas[y, x]) & (grid == FREE)).all()


def test_from_a_cell_that_is_not_free_the_floor_on_all_its_sides_can_be_reached() -> None:
    found = np.isfinite(costs(Floor(drawn(".#.", "###", ".#?")), 1, 0))
    assert found.tolist() == [[True, True, True], [False] * 3, [False] * 3]
