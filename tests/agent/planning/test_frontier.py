"""The frontier of random grids, compared with its definition, cell by cell."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from agent.planning.cost_field import costs, nearest_first, way
from agent.planning.frontier import Floor, Regions, are_frontier, frontier_cells, is_frontier
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.planning.planning_references import dijkstra, drawn

seeds = st.integers(0, 2**32 - 1)


@st.composite
def known_parts(draw: st.DrawFn) -> tuple[Grid, int, int]:
    """A random world of which a random part is known, and a free cell of it."""
    rng = np.random.default_rng(draw(seeds))
    height, width = rng.integers(1, 20, 2)
    unknown = draw(st.sampled_from((0.02, 0.1, 0.4)))
    grid = rng.choice(
        np.array([UNKNOWN, FREE, OCCUPIED], np.uint8), (height, width), p=[unknown, 0.85 - unknown, 0.15]
    )
    x, y = int(rng.integers(width)), int(rng.integers(height))
    grid[y, x] = FREE
    return grid, x, y


def by_definition(grid: Grid, x: int, y: int) -> bool:
    height, width = grid.shape
    around = [(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)]
    return grid[y, x] == FREE and any(
        grid[ny, nx] == UNKNOWN for nx, ny in around if 0 <= nx < width and 0 <= ny < height
    )


@given(known_parts())
def test_frontier_cells_are_free_reachable_and_beside_the_unknown_row_by_row(
    case: tuple[Grid, int, int],
) -> None:
    grid, x, y = case
    field = dijkstra(grid, x, y)
    height, width = grid.shape
    wanted = [
        [cx, cy]
        for cy in range(height)
        for cx in range(width)
        if by_definition(grid, cx, cy) and field[cy, cx] < math.inf
    ]
    found = Regions().frontier(Floor(grid), grid, x, y)
    assert found.dtype == np.int32
    assert found.tolist() == wanted


@given(known_parts())
def test_is_frontier_agrees_for_each_cell(case: tuple[Grid, int, int]) -> None:
    grid, _, _ = case
    height, width = grid.shape
    cells = [(cx, cy) for cy in range(height) for cx in range(width)]
    wanted = [by_definition(grid, *cell) for cell in cells]
    assert [is_frontier(grid, *cell) for cell in cells] == wanted
    assert are_frontier(grid, np.array(cells, np.int32)).tolist() == wanted


def test_the_rim_of_the_grid_is_no_frontier_and_a_diagonal_neighbor_does_not_count() -> None:
    inside = drawn("...", "...")
    assert not Regions().frontier(Floor(inside), inside, 0, 0).size
    grid = drawn("..#", "..#", "##?")
    assert not is_frontier(grid, 1, 1)
    assert is_frontier(drawn("..", ".?"), 1, 0)


def test_a_frontier_behind_a_wall_does_not_count() -> None:
    grid = drawn(".#.?")
    assert is_frontier(grid, 2, 0)
    assert not Regions().frontier(Floor(grid), grid, 0, 0).size


@given(
    known_parts(), st.lists(st.tuples(st.integers(0, 19), st.integers(0, 19)), max_size=4), st.floats(0, 8)
)
def test_the_nearest_frontier_is_found_in_the_order_of_distance(
    case: tuple[Grid, int, int], targets: list[tuple[int, int]], range_cells: float
) -> None:
    grid, x, y = case
    ranges = [range_cells / (number + 1) for number in range(len(targets))]
    whole = costs(Floor(grid), x, y)
    cells = frontier_cells(grid, np.isfinite(whole)).tolist()
    cells.sort(key=lambda cell: (whole[cell[1], cell[0]], cell[1], cell[0]))
    clear = [
        cell
        for cell in cells
        if all(math.dist(cell, t) > r + 1e-9 for t, r in zip(targets, ranges, strict=True))
    ]
    unsure = [
        c for c in cells if any(abs(math.dist(c, t) - r) < 1e-6 for t, r in zip(targets, ranges, strict=True))
    ]
    taken = np.array(targets, np.int32).reshape(-1, 2)
    found = nearest_first(Floor(grid), grid, x, y, taken, ranges)
    if not cells:
        assert found is None
        return
    assert found is not None
    cell, cells_to_it = found
    if not unsure:
        assert list(cell) == (clear or cells)[0]
    assert cells_to_it.tolist() == way(grid, whole, *cell).tolist()
