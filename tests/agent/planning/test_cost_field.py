"""Costs of ways, bit for bit as a plain search in whole numbers has them; and the ways themselves."""

from __future__ import annotations

import heapq
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import ndimage

from agent.planning.cost_field import DIAGONAL, costs, costs_to, way
from agent.planning.frontier import Floor
from agent.planning.occupancy import P_FREE, P_OCCUPIED, entry_costs, weighted_costs
from agent.planning.path_planner import PathPlanner
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.planning.planning_references import ONE, ROOT, drawn, floors, steps_from, whole_lengths

seeds = st.integers(0, 2**32 - 1)


@given(floors())
def test_costs_are_those_of_a_plain_search_to_the_last_bit(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    assert costs(Floor(grid), x, y).tobytes() == whole_lengths(grid, x, y).tobytes()


@given(floors())
def test_exactly_the_4_connected_part_of_the_floor_can_be_reached(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    grid[y, x] = FREE
    areas, _ = ndimage.label(grid == FREE)
    assert (np.isfinite(costs(Floor(grid), x, y)) == (areas == areas[y, x]) & (grid == FREE)).all()


@given(floors(), seeds)
def test_a_way_back_is_as_long_as_the_way_there(case: tuple[Grid, int, int], seed: int) -> None:
    grid, x, y = case
    grid[y, x] = FREE
    free = np.argwhere(grid == FREE)
    other_y, other_x = free[seed % len(free)].tolist()
    assert costs(Floor(grid), x, y)[other_y, other_x] == costs(Floor(grid), other_x, other_y)[y, x]


@given(floors(), seeds)
def test_a_search_for_some_cells_equals_a_search_for_all_cells(
    case: tuple[Grid, int, int], seed: int
) -> None:
    grid, x, y = case
    rng = np.random.default_rng(seed)
    height, width = grid.shape
    cells = rng.integers(0, (width, height), (int(rng.integers(0, 9)), 2)).astype(np.int32)
    whole = whole_lengths(grid, x, y)
    assert (costs_to(Floor(grid), x, y, cells) == whole[cells[:, 1], cells[:, 0]]).all()
    planner = PathPlanner(grid)
    end_y, end_x = np.argwhere(np.isfinite(whole))[-1].tolist()
    found = planner.path((x, y), (end_x, end_y))
    assert found is not None
    assert (found == way(grid, whole, end_x, end_y)).all()


@given(floors())
@example((np.full((1, 1), OCCUPIED, np.uint8), 0, 0))
def test_each_way_is_driven_step_by_step_and_is_as_long_as_it_costs(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    field = costs(Floor(grid), x, y)
    for end_y, end_x in np.argwhere(np.isfinite(field)).tolist():
        cells = way(grid, field, end_x, end_y).tolist()
        assert ([x, y] if not cells else cells[-1]) == [end_x, end_y]
        length = 0.0
        for (ax, ay), (bx, by) in pairwise([[x, y], *cells]):
            steps = {(nx, ny): step for nx, ny, step in steps_from(grid, ax, ay)}
            assert (bx, by) in steps, "a step over a wall, around a corner, or a leap"
            length += steps[bx, by]
        assert length == pytest.approx(field[end_y, end_x], abs=1e-9)


@pytest.mark.parametrize("size", [300, 1500])
def test_on_a_large_open_floor_costs_are_octile_distances(size: int) -> None:
    grid = np.full((size, size + 7), FREE, np.uint8)
    x, y = size // 3, size // 2
    dx = abs(np.arange(size + 7) - x)[None, :].astype(np.int64)
    dy = abs(np.arange(size) - y)[:, None].astype(np.int64)
    wanted = (abs(dx - dy) * ONE + np.minimum(dx, dy) * ROOT) / ONE
    assert (costs(Floor(grid), x, y) == wanted).all()


def test_a_way_of_nearly_a_million_cells_is_not_too_long() -> None:
    grid = np.full((1399, 1400), FREE, np.uint8)
    grid[1::2, :] = OCCUPIED
    grid[1::4, -1] = FREE
    grid[3::4, 0] = FREE
    field = costs(Floor(grid), 0, 0)
    end = field[np.isfinite(field)].max()
    assert end == 700 * 1399 + 699 * 2
    assert len(way(grid, field, 0, 1398)) == field[1398, 0]


def test_no_corner_is_cut() -> None:
    grid = drawn("..", "#.")
    assert costs(Floor(grid), 0, 0).tolist() == [[0, 1], [np.inf, 2]]
    assert costs(Floor(drawn(".#", "#.")), 0, 0)[1, 1] == np.inf
    assert costs(Floor(drawn(".?", "..")), 0, 0)[1, 1] == 2
    assert costs(Floor(drawn("..", "..")), 0, 0)[1, 1] == pytest.approx(DIAGONAL)


def test_a_robot_in_a_cell_that_is_not_free_finds_its_way_out() -> None:
    grid = drawn("...", ".#.", "...")
    field = costs(Floor(grid), 1, 1)
    assert field[1, 1] == 0
    assert field[0, 1] == 1
    assert field[0, 0] == pytest.approx(DIAGONAL)
    assert way(grid, field, 0, 0).tolist() == [[0, 0]]


def test_unknown_cells_are_no_floor() -> None:
    assert costs(Floor(drawn(".?.")), 0, 0).tolist() == [[0, np.inf, np.inf]]


def test_a_floor_can_be_laid_out_once_for_many_searches() -> None:
    grid = drawn("....", ".##.", "....")
    floor = Floor(grid)
    for x, y in ((0, 0), (3, 2), (1, 0)):
        assert costs(floor, x, y).tobytes() == costs(Floor(grid), x, y).tobytes()


@given(floors())
def test_weighted_costs_are_those_of_a_plain_search(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    weights = entry_costs(grid)
    grain = 1 << 10
    lengths = {(x, y): 0}
    queue = [(0, x, y)]
    while queue:
        base, cx, cy = heapq.heappop(queue)
        if base > lengths[cx, cy]:
            continue
        for nx, ny, step in steps_from(grid, cx, cy):
            new = base + round(weights[ny, nx] * (1 if step == 1 else math.sqrt(2.0)) * grain)
            if new < lengths.get((nx, ny), 1 << 62):
                lengths[nx, ny] = new
                heapq.heappush(queue, (new, nx, ny))
    wanted = np.full(grid.shape, np.inf)
    for (cx, cy), length in lengths.items():
        wanted[cy, cx] = length / grain
    found = weighted_costs(grid, weights, x, y)
    assert (np.isfinite(found) == np.isfinite(wanted)).all()
    assert found[np.isfinite(found)] == pytest.approx(wanted[np.isfinite(found)], abs=1e-9)


def test_weights_lie_between_free_floor_and_wall() -> None:
    rng = np.random.default_rng(3)
    grid = rng.choice(np.array([UNKNOWN, FREE, OCCUPIED], np.uint8), (30, 30))
    weights = entry_costs(grid)
    assert weights.min() >= 1
    assert weights.max() <= P_OCCUPIED / P_FREE
    assert (entry_costs(np.full((20, 20), FREE, np.uint8))[5:15, 5:15] == 1).all()


@given(floors(), st.sampled_from(("shortest", "weighted")))
def test_ways_of_either_kind_lead_over_free_cells_only(case: tuple[Grid, int, int], kind: str) -> None:
    grid, x, y = case
    planner = PathPlanner(grid, kind)
    field = planner.costs(x, y)
    for end_y, end_x in np.argwhere(np.isfinite(field))[::7].tolist():
        cells = planner.path((x, y), (end_x, end_y))
        assert cells is not None
        for (ax, ay), (bx, by) in pairwise([[x, y], *cells.tolist()]):
            assert (bx, by) in {(nx, ny) for nx, ny, _ in steps_from(grid, ax, ay)}
    for end_y, end_x in np.argwhere(~np.isfinite(field))[:3].tolist():
        assert planner.path((x, y), (end_x, end_y)) is None
