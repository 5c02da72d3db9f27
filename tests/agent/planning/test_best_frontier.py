"""The best frontier cell, compared with a look at all of them; and searches that leave no trace."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from agent.planning.best_frontier import TradeOff, best_frontier
from agent.planning.cost_field import FAR, costs, way, way_between, workspace
from agent.planning.frontier import Floor, Regions, frontier_cells
from agent.planning.utility import utilities
from protocol.grid import FREE, Grid
from tests.agent.explorations import exploration, real_map
from tests.agent.planning.planning_references import floors

seeds = st.integers(0, 2**32 - 1)


def plain(grid: Grid, x: int, y: int, trade_off: TradeOff) -> tuple[int, int] | None:
    """Look at all frontier cells, on the whole cost field."""
    field = costs(Floor(grid), x, y)
    cells = frontier_cells(grid, np.isfinite(field))
    if not len(cells):
        return None
    targets = [(int(tx), int(ty)) for tx, ty in trade_off.targets]
    worth = utilities(grid, cells, targets, trade_off.ranges, trade_off.weights.tolist())
    cost = field[cells[:, 1], cells[:, 0]] / trade_off.scale
    best = cells[np.argmax(worth - trade_off.beta * cost)]
    return int(best[0]), int(best[1])


def check(grid: Grid, x: int, y: int, trade_off: TradeOff) -> None:
    found = best_frontier(Floor(grid), grid, x, y, trade_off)
    assert (None if found is None else found[0]) == plain(grid, x, y, trade_off)
    if found is not None:
        cell, cells = found
        assert cells.tolist() == way(grid, costs(Floor(grid), x, y), *cell).tolist()


def appeal_of(rng: np.random.Generator, grid: Grid, range_cells: float, beta: float) -> TradeOff:
    height, width = grid.shape
    count = int(rng.integers(0, 7))
    targets = np.stack([rng.integers(0, width, count), rng.integers(0, height, count)], axis=1)
    targets = targets[rng.integers(0, max(count, 1), count)]  # several robots may drive to one target
    weights = rng.choice([1.0, 0.5, 0.25], count)
    ranges = range_cells * rng.choice([1.0, 0.5, 2.5], count)
    return TradeOff(targets.astype(np.int32), weights, ranges, range_cells, beta)


@given(floors(), seeds, st.floats(1, 30), st.sampled_from([0.0, 0.1, 1.0, 7.0]))
def test_the_result_equals_that_of_an_exhaustive_search(
    case: tuple[Grid, int, int], seed: int, range_cells: float, beta: float
) -> None:
    grid, x, y = case
    check(grid, x, y, appeal_of(np.random.default_rng(seed), grid, range_cells, beta))


def test_the_result_equals_that_of_an_exhaustive_search_at_every_step_of_a_real_exploration() -> None:
    rng = np.random.default_rng(3)
    for grid, (x, y) in exploration(real_map("fr079"), rng, 25, 40.0):
        check(grid, x, y, appeal_of(rng, grid, 40.0, 1.0))


@given(floors(), seeds)
def test_a_way_between_two_cells_is_that_of_the_whole_field(case: tuple[Grid, int, int], seed: int) -> None:
    grid, x, y = case
    field = costs(Floor(grid), x, y)
    rng = np.random.default_rng(seed)
    for _ in range(4):
        end_y, end_x = (int(rng.integers(side)) for side in grid.shape)
        for known in (np.inf, float(field[end_y, end_x])):
            cells = way_between(Floor(grid), (x, y), (end_x, end_y), known)
            if np.isfinite(field[end_y, end_x]):
                assert cells is not None
                assert cells.dtype == np.int32
                assert cells.tolist() == way(grid, field, end_x, end_y).tolist()
            else:
                assert cells is None


@given(floors())
def test_searches_reset_their_shared_memory(case: tuple[Grid, int, int]) -> None:
    grid, x, y = case
    floor = Floor(grid)
    way_between(floor, (x, y), (0, 0))
    check(grid, x, y, TradeOff(np.empty((0, 2), np.int32), np.empty(0), np.empty(0), 5.0, 1.0))
    length, _, _ = workspace(len(floor.free))
    assert (length == FAR).all()


@given(floors())
def test_the_frontier_found_while_flooding_is_the_frontier_of_the_reached_cells(
    case: tuple[Grid, int, int],
) -> None:
    grid, x, y = case
    floor = Floor(grid)
    found = Regions().frontier(floor, grid, x, y)
    assert found.tolist() == frontier_cells(grid, np.isfinite(costs(floor, x, y))).tolist()


def test_without_a_frontier_the_result_is_none() -> None:
    grid = np.full((4, 5), FREE, np.uint8)
    no_robots = TradeOff(np.empty((0, 2), np.int32), np.empty(0), np.empty(0), 5.0, 1.0)
    assert best_frontier(Floor(grid), grid, 1, 1, no_robots) is None
