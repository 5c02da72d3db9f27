"""Planning grids of noisy lasers: narrow gaps are no frontiers, and false walls do not enclose a robot."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.planning.noisy_grid import LONGEST_SPECK, NoisyGrid, shortest_frontier
from agent.planning.path_planner import PathPlanner
from protocol.body import Body
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.range_scans import TURN, Laser


def in_squares(cells: NDArray[np.bool_], narrow: int) -> NDArray[np.bool_]:
    """Return the cells that lie in a square of `narrow` by `narrow` of these cells."""
    found = np.zeros_like(cells)
    for y in range(cells.shape[0] - narrow + 1):
        for x in range(cells.shape[1] - narrow + 1):
            if cells[y : y + narrow, x : x + narrow].all():
                found[y : y + narrow, x : x + narrow] = True
    return found


def plain_clean(grid: Grid, narrow: int) -> Grid:
    """Remove narrow gaps and openings, cell by cell."""
    is_wide, is_open = in_squares(grid == UNKNOWN, narrow), in_squares(grid != OCCUPIED, narrow)
    cleaned = grid.copy()
    for y, x in np.ndindex(grid.shape):
        around = grid[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2]
        if grid[y, x] == UNKNOWN and not is_wide[y, x]:
            cleaned[y, x] = OCCUPIED if (around == OCCUPIED).any() else FREE
        if grid[y, x] == FREE and not is_open[y, x] and (around == UNKNOWN).any():
            cleaned[y, x] = OCCUPIED
    return cleaned


@given(st.integers(0, 2**32 - 1), st.sampled_from((0.1, 0.5, 0.8)), st.integers(1, 4))
def test_gaps_disappear_as_in_a_plain_implementation_at_every_call(
    seed: int, unknown: float, narrow: int
) -> None:
    random = np.random.default_rng(seed)
    shape = tuple(random.integers(1, 20, 2).tolist())
    noisy = NoisyGrid(*shape, narrow)
    for _ in range(2):
        states = np.array([UNKNOWN, FREE, OCCUPIED], np.uint8)
        grid = random.choice(states, shape, p=[unknown, (1 - unknown) / 2, (1 - unknown) / 2])
        assert np.array_equal(noisy.clean(grid), plain_clean(grid, narrow))


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_changes_of_a_few_rows_have_the_same_result_as_a_new_grid(seed: int, narrow: int) -> None:
    random = np.random.default_rng(seed)
    noisy = NoisyGrid(40, 12, narrow, 3)
    grid = random.choice(np.array([UNKNOWN, FREE, OCCUPIED], np.uint8), (40, 12), p=[0.6, 0.3, 0.1])
    for _ in range(4):
        assert np.array_equal(noisy.clean(grid), NoisyGrid(40, 12, narrow, 3).clean(grid))
        row, column = random.integers(40), random.integers(12)
        grid[row : row + 3, column : column + 4] = random.integers(3)


def test_the_way_that_a_robot_has_driven_stays_open() -> None:
    grid = np.full((20, 20), OCCUPIED, np.uint8)
    noisy = NoisyGrid(20, 20, 2)
    noisy.drive(2, 3)
    noisy.drive(9, 6)
    free = np.argwhere(noisy.clean(grid) == FREE).tolist()
    assert [3, 2] in free
    assert [6, 9] in free
    assert len(free) == 1 + 7 + 3, "cells are 4-neighbors of each other"


def test_an_obstacle_on_the_way_closes_it() -> None:
    grid = np.full((5, 20), OCCUPIED, np.uint8)
    noisy = NoisyGrid(5, 20, 2)
    noisy.drive(2, 3)
    noisy.drive(9, 3)
    noisy.bump(8, 3)
    noisy.bump(9, 3)
    noisy.bump(-1, 40)
    cleaned = noisy.clean(grid)
    assert cleaned[3, 8] == OCCUPIED
    assert cleaned[3, 9] == FREE, "the robot's own cell"


@pytest.mark.parametrize(("shortest", "state"), [(1, UNKNOWN), (3, UNKNOWN), (4, OCCUPIED)])
def test_frontiers_that_are_too_short_do_not_count(shortest: int, state: int) -> None:
    grid = np.full((20, 20), UNKNOWN, np.uint8)
    grid[12:], grid[11] = FREE, OCCUPIED
    grid[11, 6:9] = FREE
    cleaned = NoisyGrid(20, 20, 3, shortest).clean(grid)
    assert (cleaned[10, 6:9] == state).all()
    assert (cleaned[:10] == UNKNOWN).all()


def test_the_shortest_frontier_depends_on_how_far_beams_are_apart() -> None:
    fine, coarse, poor = (
        Body(50.0, 270.0, 5.0, laser=Laser(beams, 0, TURN * 3 // 4, 5000)) for beams in (1081, 271, 4)
    )
    assert shortest_frontier([fine]) == 2
    assert shortest_frontier([coarse]) == 3
    assert shortest_frontier([poor]) == LONGEST_SPECK
    assert shortest_frontier([fine, coarse, fine]) == 3, "scans of the coarsest laser are on all maps"


def test_the_optimistic_grid_shows_what_doubtful_walls_may_hide() -> None:
    """A wall of cells in doubt hides a frontier if it is as long as an opening; a shorter one hides nothing."""
    grid = np.full((20, 20), UNKNOWN, np.uint8)
    grid[12:], grid[11] = FREE, OCCUPIED
    noisy = NoisyGrid(20, 20, 3)
    for width, is_frontier in ((2, False), (3, True)):
        doubtful = np.zeros(grid.shape, np.bool_)
        doubtful[11, 6 : 6 + width] = True
        optimistic = noisy.clean_optimistic(grid, doubtful)
        assert bool((optimistic[11, 6 : 6 + width] == FREE).all()) == is_frontier
    assert (grid[11] == OCCUPIED).all()


HERE = 8, 5


def beside_a_wall() -> tuple[Grid, Grid]:
    """Return a planning grid and a self-explored grid, in which the robot stands beside a wall at `HERE`.

    Its own map has the wall in column 7, and a frontier in column 19. A copy has the wall in columns 8 and 9.
    """
    own = np.full((11, 30), UNKNOWN, np.uint8)
    own[:, 7], own[:, 8:20] = OCCUPIED, FREE
    planning = own.copy()
    planning[:, 8:10] = OCCUPIED
    return planning, own


def frontier_after(noisy: NoisyGrid, planning: Grid, own: Grid) -> list[list[int]]:
    """Let the robot stand at `HERE`; return the frontier cells that it reaches."""
    noisy.drive(*HERE)
    return PathPlanner(noisy.explorable(planning, own)).frontier(*HERE).tolist()


def test_walls_of_copies_do_not_enclose_a_robot_where_it_has_seen_free_cells() -> None:
    planning, own = beside_a_wall()
    assert frontier_after(NoisyGrid(11, 30, 3), planning, own) == [[19, row] for row in range(11)]


@pytest.mark.parametrize("state", [OCCUPIED, UNKNOWN])
def test_walls_of_copies_enclose_a_robot_that_has_not_seen_these_cells_free(state: int) -> None:
    planning, own = beside_a_wall()
    own[:, 9] = state
    assert frontier_after(NoisyGrid(11, 30, 3), planning, own) == []


def test_walls_of_copies_count_that_are_farther_away_than_the_width_of_an_opening() -> None:
    planning, own = beside_a_wall()
    planning[:, 8:11], planning[:, 11:13] = FREE, OCCUPIED
    assert frontier_after(NoisyGrid(11, 30, 4), planning, own) == [[19, row] for row in range(11)]
    assert frontier_after(NoisyGrid(11, 30, 3), planning, own) == []


def test_walls_of_copies_count_as_long_as_the_robot_reaches_a_frontier() -> None:
    planning, own = beside_a_wall()
    own[4:7, 7] = planning[4:7, 7] = UNKNOWN
    assert frontier_after(NoisyGrid(11, 30, 3), planning, own) == [list(HERE)]


def test_avoided_targets_are_no_reason_to_doubt_walls_of_copies() -> None:
    planning, own = beside_a_wall()
    noisy = NoisyGrid(11, 30, 3)
    noisy.avoided.add((19, 5), 2)
    assert [len(frontier_after(noisy, planning, own)) for _ in range(3)] == [0, 0, 11]
