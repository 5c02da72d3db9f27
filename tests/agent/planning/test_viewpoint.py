"""Where to look from: worked by hand, and against beams followed one by one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.planning.path_planner import PathPlanner
from agent.planning.viewpoint import best_viewpoint, viewpoint_cells
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, ray_table
from tests.agent.planning.planning_references import drawn, grids

BEAMS = ray_table(8.0, 36)

# A corridor with a nook of three cells in its wall, of which only the back wall is not known.
NOOK: Grid = drawn(
    "####?####",
    "####.####",
    "####.####",
    "####.####",
    ".........",
    ".........",
    ".........",
    "#########",
)  # fmt: skip
END = (4, 1)


def seen(cells: np.ndarray[tuple[int, int], np.dtype[np.int32]]) -> set[tuple[int, int]]:
    return {(x, y) for x, y in cells.tolist()}


def test_a_nook_is_visible_from_its_front_and_not_from_its_side() -> None:
    assert seen(viewpoint_cells(NOOK, END, BEAMS, 8.0)) == {(4, y) for y in range(1, 7)}
    assert seen(viewpoint_cells(NOOK, END, BEAMS, 2.0)) == {(4, 1), (4, 2)}


@given(grids(), st.integers(0, 10**6), st.floats(1.0, 8.0))
def test_viewpoints_are_the_cells_with_a_beam_to_an_unknown_neighbor(
    grid: Grid, pick: int, reach: float
) -> None:
    free = np.argwhere(grid == FREE)
    if not len(free):
        return
    y, x = free[pick % len(free)].tolist()
    beside = {(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)}
    expected = {(x, y)}
    for from_y, from_x in free.tolist():
        for beam in range(BEAMS.beams):
            for dx, dy in BEAMS.cells[BEAMS.start[beam] : BEAMS.start[beam + 1]].tolist():
                cell = from_x + dx, from_y + dy
                inside = 0 <= cell[0] < grid.shape[1] and 0 <= cell[1] < grid.shape[0]
                if not inside or dx * dx + dy * dy > reach * reach:
                    break
                if grid[cell[1], cell[0]] == UNKNOWN and cell in beside:
                    expected.add((from_x, from_y))
                if grid[cell[1], cell[0]] != FREE:
                    break
    assert seen(viewpoint_cells(grid, (x, y), BEAMS, reach)) == expected


@given(grids(), st.integers(0, 10**6), st.integers(0, 2**32 - 1))
def test_among_some_cells_the_viewpoints_are_those_of_all_cells_among_them(
    grid: Grid, pick: int, seed: int
) -> None:
    free = np.argwhere(grid == FREE)
    if not len(free):
        return
    y, x = free[pick % len(free)].tolist()
    some = free[np.random.default_rng(seed).random(len(free)) < 0.5, ::-1].astype(np.int32, order="C")
    among = viewpoint_cells(grid, (x, y), BEAMS, 8.0, some)
    assert seen(among) == seen(viewpoint_cells(grid, (x, y), BEAMS, 8.0)) & seen(some)


def look(here: tuple[int, int], tour: list[tuple[int, int]], step: float = 1.0, small: int = 1) -> object:
    goals = np.array(tour, np.int32)
    views = [viewpoint_cells(NOOK, goal, BEAMS, 8.0) if at < small else None for at, goal in enumerate(tour)]
    return best_viewpoint(PathPlanner(NOOK), here, views, goals, step)


def test_the_viewpoint_of_a_passing_robot_is_on_its_way() -> None:
    assert look((0, 6), [END, (8, 6)]) == (4, 6)
    assert look((0, 4), [END, (8, 4)]) == (4, 4)


def test_of_ways_of_equal_steps_the_one_toward_the_next_goal_wins() -> None:
    # In single cells (4, 5) is best for both ways; in steps of six (4, 4) is as near, and nearer to what comes next.
    assert look((0, 6), [END, (8, 4)]) == (4, 5)
    assert look((0, 6), [END, (8, 4)], step=6.0) == (4, 4)


def test_a_goal_in_sight_of_the_viewpoint_needs_no_way() -> None:
    tour = np.array([END, (1, 4), (8, 6)], np.int32)
    views = [viewpoint_cells(NOOK, END, BEAMS, 8.0), np.array([(4, 4), (1, 4)], np.int32), None]
    assert best_viewpoint(PathPlanner(NOOK), (4, 3), views, tour, 6.0) is None
    assert best_viewpoint(PathPlanner(NOOK), (5, 6), views, tour, 6.0) == (4, 4)
    assert best_viewpoint(PathPlanner(NOOK), (5, 6), [views[0], None, None], tour, 6.0) == (4, 4)
    tour[1] = 1, 6
    assert best_viewpoint(PathPlanner(NOOK), (5, 6), views, tour, 6.0) == (4, 4)
    assert best_viewpoint(PathPlanner(NOOK), (5, 6), [views[0], None, None], tour, 6.0) == (4, 6)


@pytest.mark.parametrize("here", [(4, 2), (4, 4), END])
def test_a_robot_at_a_viewpoint_gets_no_second_viewpoint(here: tuple[int, int]) -> None:
    assert look(here, [END, (8, 4)]) is None


def test_without_a_way_there_is_no_viewpoint() -> None:
    grid = NOOK.copy()
    grid[:, 2] = OCCUPIED
    views = [viewpoint_cells(grid, END, BEAMS, 8.0)]
    assert best_viewpoint(PathPlanner(grid), (0, 4), views, np.array([END], np.int32), 1.0) is None
