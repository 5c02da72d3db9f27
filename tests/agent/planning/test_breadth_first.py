"""Breadth-first search by hops, compared with a plain one."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from agent.planning.breadth_first import first_by_hops, is_wide_frontier
from protocol.grid import FREE, UNKNOWN, Grid
from tests.agent.planning.planning_references import drawn, steps_from

AROUND = [(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dx or dy]


def hops(grid: Grid, start: tuple[int, int]) -> dict[tuple[int, int], int]:
    """Fewest steps to every cell."""
    found = {start: 0}
    queue = deque([start])
    while queue:
        x, y = queue.popleft()
        for nx, ny, _ in steps_from(grid, x, y):
            if (nx, ny) not in found:
                found[nx, ny] = found[x, y] + 1
                queue.append((nx, ny))
    return found


def by_definition(grid: Grid, x: int, y: int) -> bool:
    height, width = grid.shape
    return bool(grid[y, x] == FREE) and any(
        0 <= x + dx < width
        and 0 <= y + dy < height
        and grid[y + dy, x + dx] == UNKNOWN
        and (not (dx and dy) or FREE in (grid[y, x + dx], grid[y + dy, x]))
        for dx, dy in AROUND
    )


@given(st.integers(0, 2**32 - 1), st.integers(0, 3))
def test_the_result_is_the_cell_of_fewest_steps_away_from_teammates_targets(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    grid = random.choice(np.array([0, 1, 2], np.uint8), (12, 17), p=[0.08, 0.77, 0.15])
    x, y = int(random.integers(17)), int(random.integers(12))
    grid[y, x] = FREE
    targets = [(int(random.integers(17)), int(random.integers(12))) for _ in range(count)]
    ranges = random.uniform(0, 8, count)
    steps = hops(grid, (x, y))
    cells = [cell for cell in steps if by_definition(grid, *cell)]
    assert all(is_wide_frontier(grid, *cell) == (cell in cells) for cell in steps)
    near = [c for c in cells if any(math.dist(c, t) <= r for t, r in zip(targets, ranges, strict=True))]
    clear = [cell for cell in cells if cell not in near]
    found = first_by_hops(grid, grid, (x, y), np.array(targets, np.int32).reshape(-1, 2), ranges)
    if not cells:
        assert found is None
        return
    assert found is not None
    cell, way = found
    assert cell in (clear or cells)
    assert len(way) == steps[cell] == min(steps[each] for each in clear or cells)
    before = (x, y)
    for nx, ny in way.tolist():
        assert (nx, ny) in {each[:2] for each in steps_from(grid, *before)}
        before = nx, ny
    assert before == cell


def test_a_diagonal_step_counts_one_and_a_diagonal_neighbor_counts() -> None:
    grid = drawn("......", "......", "......", "....?.")
    found = first_by_hops(grid, grid, (0, 0), np.empty((0, 2), np.int32), 0.0)
    assert found is not None
    assert found[0] == (3, 2)
    assert len(found[1]) == 3


def test_a_cell_behind_a_corner_of_walls_is_no_frontier() -> None:
    assert not is_wide_frontier(drawn("?#", "#."), 1, 1)
    assert is_wide_frontier(drawn("?.", "#."), 1, 1)
