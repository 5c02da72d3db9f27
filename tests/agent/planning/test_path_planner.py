"""PathPlanner: costs against a plain Dijkstra search, and the cells that ways lead over."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.memo_cache import MemoCache
from agent.planning.cost_field import costs
from agent.planning.frontier import Floor
from agent.planning.occupancy import entry_costs, weighted_costs
from agent.planning.path_planner import PathPlanner
from agent.planning.route import Route, corners, straighten
from protocol.grid import FREE, OCCUPIED, Grid
from tests.agent.planning.planning_references import dijkstra, drawn, grids, steps_from


@st.composite
def grids_with_a_cell(draw: st.DrawFn) -> tuple[Grid, int, int]:
    grid = draw(grids())
    return grid, draw(st.integers(0, grid.shape[1] - 1)), draw(st.integers(0, grid.shape[0] - 1))


@given(grids_with_a_cell())
def test_costs_are_those_of_a_plain_search(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    np.testing.assert_allclose(costs(Floor(grid), x, y), dijkstra(grid, x, y), rtol=0, atol=1e-9)


@given(grids_with_a_cell())
def test_weighted_costs_are_those_of_a_plain_search(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    weights = entry_costs(grid)
    slow = dijkstra(grid, x, y, weights)
    # Each of at most 200 steps is rounded to a 1024th of a cell.
    np.testing.assert_allclose(weighted_costs(grid, weights, x, y), slow, rtol=0, atol=0.1)


@given(grids_with_a_cell(), grids_with_a_cell(), st.sampled_from(["shortest", "weighted"]))
def test_planners_with_a_shared_cache_give_the_same_results(
    one: tuple[Grid, int, int], other: tuple[Grid, int, int], kind: str
) -> None:
    once = MemoCache()
    for grid, x, y in (one, other, one):
        start, goals = np.array([[x, y]], np.int32), np.argwhere(grid.T == FREE).astype(np.int32)[::5]
        shared, alone = PathPlanner(grid, kind, cache=once), PathPlanner(grid, kind)
        np.testing.assert_equal(shared.costs_between(start, goals), alone.costs_between(start, goals))
        np.testing.assert_equal(shared.costs_among(start, goals), alone.costs_among(start, goals))
        # Blocked cells join regions; other regions are known before the robot asks for them.
        for at in range(0, grid.size, 3):
            here = at % grid.shape[1], at // grid.shape[1]
            np.testing.assert_equal(shared.frontier(*here), alone.frontier(*here))


def test_a_wrong_noted_cost_does_not_change_the_way() -> None:
    grid = np.full((9, 30), FREE, np.uint8)
    grid[:8, 15] = OCCUPIED
    start, end = (2, 2), (28, 3)
    best = PathPlanner(grid).path(start, end)
    assert best is not None
    for cost in (1.0, 30.0, 1000.0, math.inf):
        planner = PathPlanner(grid)
        planner.note_cost(start, end, cost)
        np.testing.assert_equal(planner.path(start, end), best)


@given(grids_with_a_cell(), st.sampled_from(["shortest", "weighted"]))
def test_a_way_consists_of_steps_and_has_the_computed_cost(case: tuple[Grid, int, int], kind: str) -> None:
    grid, x, y = case
    planner = PathPlanner(grid, kind)
    field = planner.costs(x, y)
    for end_y, end_x in np.argwhere(np.isfinite(field))[::7]:
        cells = planner.path((x, y), (int(end_x), int(end_y)))
        assert cells is not None
        total = 0.0
        weights = entry_costs(grid)
        for (ax, ay), (bx, by) in pairwise([(x, y), *cells.tolist()]):
            lengths = {(nx, ny): length for nx, ny, length in steps_from(grid, ax, ay)}
            total += lengths[bx, by] * (weights[by, bx] if kind == "weighted" else 1.0)
        assert total == pytest.approx(field[end_y, end_x], abs=0.1 if kind == "weighted" else 1e-9)


def test_weighted_ways_keep_away_from_walls() -> None:
    grid = np.full((9, 30), FREE, np.uint8)
    grid[0] = OCCUPIED
    cells = PathPlanner(grid, "weighted").path((1, 1), (28, 1))
    assert cells is not None
    assert cells[:, 1].max() >= 2
    plain = PathPlanner(grid).path((1, 1), (28, 1))
    assert plain is not None
    assert plain[:, 1].max() == 1


def test_far_from_obstacles_a_weighted_way_costs_its_length() -> None:
    grid = np.full((31, 31), FREE, np.uint8)
    field = PathPlanner(grid, "weighted").costs(10, 15)
    assert field[15, 20] == pytest.approx(10.0)


def test_a_disc_does_not_pass_where_a_point_does() -> None:
    grid = drawn(
        "..........",
        "..........",
        "####..####",
        "..........",
        "..........",
    )
    assert PathPlanner(grid).path((1, 0), (1, 4)) is not None
    assert PathPlanner(grid, radius_cells=1.0).path((1, 0), (1, 4)) is None


@pytest.mark.parametrize("kind", ["shortest", "weighted"])
def test_without_a_cell_a_disc_keeps_as_far_from_walls_as_before(kind: str) -> None:
    grid = drawn(*["." * 15] * 5, "." * 7 + "#" + "." * 7, *["." * 15] * 5)
    planner = PathPlanner(grid, kind, 2.0)
    barred = planner.without([(2, 8)])
    floor = planner.floor.copy()
    floor[8, 2] = OCCUPIED
    assert (barred.floor == floor).all()
    assert (np.isfinite(barred.costs(0, 0)) <= (floor == FREE)).all()
    assert not np.isfinite(barred.costs(0, 0)[4, 7])


@given(grids_with_a_cell(), st.integers(0, 2**32 - 1))
def test_the_nearest_frontier_is_the_nearest_away_from_teammates_targets(
    case: tuple[Grid, int, int], seed: int
) -> None:
    grid, x, y = case
    random = np.random.default_rng(seed)
    taken = np.stack([random.integers(0, side, 2) for side in (grid.shape[1], grid.shape[0])], axis=1)
    planner = PathPlanner(grid)
    found = planner.first_frontier(x, y, taken.astype(np.int32), 4.0)
    cells = planner.frontier(x, y)
    if not len(cells):
        assert found is None
        return
    length = dijkstra(grid, x, y)[cells[:, 1], cells[:, 0]]
    clear = np.array([all(math.dist(cell, other) > 4.0 for other in taken) for cell in cells])
    best = length[clear].min() if clear.any() else length.min()
    assert found is not None
    assert dijkstra(grid, x, y)[found[1], found[0]] == pytest.approx(best)
    way = planner.path((x, y), found)
    assert way is not None
    assert (len(way) == 0) == (found == (x, y))


@given(grids_with_a_cell())
def test_a_straightened_way_is_driven_in_steps_and_is_no_longer(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    planner = PathPlanner(grid)
    for end_y, end_x in np.argwhere(np.isfinite(planner.costs(x, y)))[::5]:
        cells = planner.path((x, y), (int(end_x), int(end_y)))
        assert cells is not None
        straight = straighten(grid, (x, y), cells)
        assert len(straight) <= len(cells)
        for (ax, ay), (bx, by) in pairwise([(x, y), *straight.tolist()]):
            assert (bx, by) in {(nx, ny) for nx, ny, _ in steps_from(grid, ax, ay)}
        assert not len(cells) or tuple(straight[-1]) == (end_x, end_y)


def test_a_way_in_the_open_has_one_corner_its_end() -> None:
    grid = np.full((20, 20), FREE, np.uint8)
    cells = PathPlanner(grid).path((2, 2), (15, 7))
    assert cells is not None
    np.testing.assert_array_equal(corners(grid, (2300, 1800), cells), [(15000, 7000)])


def test_a_route_is_closed_by_a_wall_on_it_or_beside_a_diagonal_and_by_nothing_else() -> None:
    floor = np.full((5, 6), FREE, np.uint8)
    route = Route()
    route.cells = np.array([(1, 1), (2, 2), (3, 2)], np.int32)
    needed = {(1, 0), (0, 1), (1, 1), (2, 1), (1, 2), (2, 2), (3, 2)}
    for y, x in np.ndindex(floor.shape):
        walled = floor.copy()
        walled[y, x] = OCCUPIED
        assert route.is_open(walled, (0, 0)) == ((x, y) not in needed)


def test_a_route_forgets_the_cells_up_to_where_the_robot_is_and_none_if_it_is_elsewhere() -> None:
    route = Route()
    route.cells = np.array([(1, 1), (2, 1), (1, 1), (0, 1)], np.int32)
    route.advance_to(5, 5)
    assert len(route.cells) == 4
    route.advance_to(1, 1)
    assert route.cells.tolist() == [[0, 1]]
    route.advance_to(0, 1)
    assert route.cells.tolist() == []
