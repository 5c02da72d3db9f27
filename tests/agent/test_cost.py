"""Costs of ways, bit for bit as a plain search in whole numbers has them; and the ways themselves."""

from __future__ import annotations

import heapq
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from planning_references import drawn, steps_from
from scipy import ndimage

from agent.planning.cost import DIAGONAL, Floor, costs, costs_on, costs_to, way
from agent.planning.occupancy import P_FREE, P_OCCUPIED, Terrain, weighted_costs
from agent.planning.ways import Ways
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid

seeds = st.integers(0, 2**32 - 1)
ONE = 1 << 42
ROOT = round(math.sqrt(2) * ONE)


@st.composite
def floors(draw: st.DrawFn) -> tuple[Grid, int, int]:
    """Open floors, clutter, mazes and comb-like corridors; and a cell, sometimes not a free one."""
    rng = np.random.default_rng(draw(seeds))
    height, width = rng.integers(1, 31, 2)
    grid = np.full((height, width), FREE, np.uint8)
    kind = draw(st.sampled_from(("clutter", "maze", "blocks", "comb")))
    if kind == "clutter":
        grid[rng.random((height, width)) < draw(st.sampled_from((0.02, 0.1, 0.3, 0.45)))] = OCCUPIED
    elif kind == "maze":
        grid[1::2, 1::2] = OCCUPIED
        for y, x in np.argwhere(grid == OCCUPIED):
            dy, dx = [(0, 1), (1, 0), (0, -1), (-1, 0)][rng.integers(4)]
            grid[max(0, min(y + dy, height - 1)), max(0, min(x + dx, width - 1))] = OCCUPIED
    elif kind == "blocks":
        for _ in range(rng.integers(1, 9)):
            y, x = rng.integers(height), rng.integers(width)
            grid[y : y + rng.integers(1, 9), x : x + rng.integers(1, 9)] = rng.choice([OCCUPIED, UNKNOWN])
    else:
        grid[:, 1::3] = OCCUPIED
        grid[rng.integers(0, height, width), np.arange(width)] = FREE
    grid[rng.random((height, width)) < 0.02] = UNKNOWN
    return grid, int(rng.integers(width)), int(rng.integers(height))


def whole_lengths(grid: Grid, x: int, y: int) -> NDArray[np.float64]:
    """Dijkstra's search with lengths in whole numbers, and no trick at all."""
    lengths = {(x, y): 0}
    queue = [(0, x, y)]
    while queue:
        base, cx, cy = heapq.heappop(queue)
        if base > lengths[cx, cy]:
            continue
        for nx, ny, step in steps_from(grid, cx, cy):
            new = base + (ONE if step == 1 else ROOT)
            if new < lengths.get((nx, ny), 1 << 62):
                lengths[nx, ny] = new
                heapq.heappush(queue, (new, nx, ny))
    field = np.full(grid.shape, np.inf)
    for (cx, cy), length in lengths.items():
        field[cy, cx] = length / ONE
    return field


@given(floors())
def test_costs_are_those_of_a_plain_search_to_the_last_bit(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    assert costs(grid, x, y).tobytes() == whole_lengths(grid, x, y).tobytes()


@given(floors())
def test_exactly_the_4_connected_part_of_the_floor_can_be_reached(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    grid[y, x] = FREE
    areas, _ = ndimage.label(grid == FREE)
    assert (np.isfinite(costs(grid, x, y)) == (areas == areas[y, x]) & (grid == FREE)).all()


@given(floors(), seeds)
def test_a_way_back_is_as_long_as_the_way_there(case: tuple[Grid, int, int], seed: int) -> None:
    grid, x, y = case
    grid[y, x] = FREE
    free = np.argwhere(grid == FREE)
    other_y, other_x = free[seed % len(free)].tolist()
    assert costs(grid, x, y)[other_y, other_x] == costs(grid, other_x, other_y)[y, x]


@given(floors(), seeds, st.integers(0, 12))
def test_costs_to_goals_are_the_same_however_early_the_search_ends(
    case: tuple[Grid, int, int], seed: int, count: int
) -> None:
    grid, x, y = case
    rng = np.random.default_rng(seed)
    height, width = grid.shape
    goals = np.stack([rng.integers(0, width, count), rng.integers(0, height, count)], 1).astype(np.int32)
    field = whole_lengths(grid, x, y)
    assert costs_to(Floor(grid), x, y, goals).tolist() == field[goals[:, 1], goals[:, 0]].tolist()


@given(floors())
@example((np.full((1, 1), OCCUPIED, np.uint8), 0, 0))
def test_each_way_is_driven_step_by_step_and_is_as_long_as_it_costs(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    field = costs(grid, x, y)
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
    assert (costs(grid, x, y) == wanted).all()


def test_a_way_of_nearly_a_million_cells_is_not_too_long() -> None:
    grid = np.full((1399, 1400), FREE, np.uint8)
    grid[1::2, :] = OCCUPIED
    grid[1::4, -1] = FREE
    grid[3::4, 0] = FREE
    field = costs(grid, 0, 0)
    end = field[np.isfinite(field)].max()
    assert end == 700 * 1399 + 699 * 2
    assert len(way(grid, field, 0, 1398)) == field[1398, 0]


def test_no_corner_is_cut() -> None:
    grid = drawn("..", "#.")
    assert costs(grid, 0, 0).tolist() == [[0, 1], [np.inf, 2]]
    assert costs(drawn(".#", "#."), 0, 0)[1, 1] == np.inf
    assert costs(drawn(".?", ".."), 0, 0)[1, 1] == 2
    assert costs(drawn("..", ".."), 0, 0)[1, 1] == pytest.approx(DIAGONAL)


def test_a_robot_in_a_cell_that_is_not_free_finds_its_way_out() -> None:
    grid = drawn("...", ".#.", "...")
    field = costs(grid, 1, 1)
    assert field[1, 1] == 0
    assert field[0, 1] == 1
    assert field[0, 0] == pytest.approx(DIAGONAL)
    assert way(grid, field, 0, 0).tolist() == [[0, 0]]


def test_unknown_cells_are_no_floor() -> None:
    assert costs(drawn(".?."), 0, 0).tolist() == [[0, np.inf, np.inf]]


def test_a_floor_can_be_laid_out_once_for_many_searches() -> None:
    grid = drawn("....", ".##.", "....")
    floor = Floor(grid)
    for x, y in ((0, 0), (3, 2), (1, 0)):
        assert costs_on(floor, x, y).tobytes() == costs(grid, x, y).tobytes()


@given(floors())
def test_weighted_costs_are_those_of_a_plain_search(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    terrain = Terrain(grid, grid)
    grain = 1 << 10
    lengths = {(x, y): 0}
    queue = [(0, x, y)]
    while queue:
        base, cx, cy = heapq.heappop(queue)
        if base > lengths[cx, cy]:
            continue
        for nx, ny, step in steps_from(grid, cx, cy):
            new = base + round(terrain.weights[ny, nx] * (1 if step == 1 else math.sqrt(2.0)) * grain)
            if new < lengths.get((nx, ny), 1 << 62):
                lengths[nx, ny] = new
                heapq.heappush(queue, (new, nx, ny))
    wanted = np.full(grid.shape, np.inf)
    for (cx, cy), length in lengths.items():
        wanted[cy, cx] = length / grain
    found = weighted_costs(terrain, x, y)
    assert (np.isfinite(found) == np.isfinite(wanted)).all()
    assert found[np.isfinite(found)] == pytest.approx(wanted[np.isfinite(found)], abs=1e-9)


def test_weights_lie_between_free_floor_and_wall() -> None:
    rng = np.random.default_rng(3)
    grid = rng.choice(np.array([UNKNOWN, FREE, OCCUPIED], np.uint8), (30, 30))
    weights = Terrain(grid, grid).weights
    assert weights.min() >= 1
    assert weights.max() <= P_OCCUPIED / P_FREE
    assert (
        Terrain(np.full((20, 20), FREE, np.uint8), np.full((20, 20), FREE, np.uint8)).weights[5:15, 5:15] == 1
    ).all()


@given(floors(), st.sampled_from(("shortest", "weighted")))
def test_ways_of_either_kind_lead_over_free_cells_only(case: tuple[Grid, int, int], kind: str) -> None:
    grid, x, y = case
    ways = Ways(grid, kind)
    field = ways.costs(x, y)
    for end_y, end_x in np.argwhere(np.isfinite(field))[::7].tolist():
        cells = ways.way((x, y), (end_x, end_y))
        assert cells is not None
        for (ax, ay), (bx, by) in pairwise([[x, y], *cells.tolist()]):
            assert (bx, by) in {(nx, ny) for nx, ny, _ in steps_from(grid, ax, ay)}
    for end_y, end_x in np.argwhere(~np.isfinite(field))[:3].tolist():
        assert ways.way((x, y), (end_x, end_y)) is None
