"""Escape from local minima: after some steps in a circle, until the frontier has been observed."""

from __future__ import annotations

import numpy as np

from agent.planning.escape import STEPS, Escape
from agent.planning.path_planner import PathPlanner
from protocol.arrays import Cells
from protocol.grid import FREE, UNKNOWN, Grid


def frontier_beside(*unknown: tuple[int, int]) -> tuple[PathPlanner, Cells]:
    grid: Grid = np.full((20, 20), FREE, np.uint8)
    for x, y in unknown:
        grid[y, x] = UNKNOWN
    planner = PathPlanner(grid)
    return planner, planner.frontier(2, 2)


def needed(
    escape: Escape, first: int, steps: int, at: tuple[float, float], *unknown: tuple[int, int]
) -> list[bool]:
    planner, frontier = frontier_beside(*unknown)
    return [escape.is_needed(at, step, planner, frontier) for step in range(first, first + steps)]


def test_a_robot_that_oscillates_escapes_and_one_that_drives_does_not() -> None:
    planner, frontier = frontier_beside((15, 15))
    for width, expected in ((2.0, True), (4.0, False)):
        escape = Escape(3.0, 2.0)
        places = [(2.0 + width * (step % 2), 2.0) for step in range(2 * STEPS)]
        found = [escape.is_needed(at, step, planner, frontier) for step, at in enumerate(places)]
        assert any(found) == expected
        assert not any(found[:STEPS])


def test_an_escape_ends_when_no_frontier_is_left_near_its_goal() -> None:
    escape = Escape(3.0, 2.0)
    assert needed(escape, 0, STEPS + 1, (2.0, 2.0), (9, 9), (16, 16)) == STEPS * [False] + [True]
    assert needed(escape, STEPS + 1, 1, (7.0, 7.0), (10, 9), (16, 16)) == [True], "the frontier flickers"
    after = needed(escape, STEPS + 2, STEPS + 1, (8.0, 8.0), (16, 16))
    assert after == STEPS * [False] + [True], "the next local minimum"
