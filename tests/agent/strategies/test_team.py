"""Robots of a team compute one assignment, though their sensors differ."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.planning.path_planner import PathPlanner
from agent.strategies.base import Situation, TeammatePose
from agent.strategies.faigl import cluster_goals
from agent.strategies.registry import strategy
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.planning.planning_references import settings_for

SHARED = ("burgard", "burgard-optimal", "greedy", "iterative", "hungarian", "repairmen")
"""Strategies in which each member computes the whole assignment."""


def half_explored(random: np.random.Generator) -> Grid:
    """A hall with pillars, of which some discs are known."""
    grid = np.full((60, 90), UNKNOWN, np.uint8)
    rows, columns = np.ogrid[:60, :90]
    for x, y in [(45, 30), *zip(random.integers(20, 70, 3), random.integers(15, 45, 3), strict=True)]:
        grid[(columns - x) ** 2 + (rows - y) ** 2 < 18**2] = FREE
    grid[(random.random(grid.shape) < 0.05) & (grid == FREE)] = OCCUPIED
    grid[30, 45] = FREE
    return grid


def views(random: np.random.Generator, grid: Grid, robots: int) -> list[Situation]:
    """The situation of each robot: all in range of each other but the last, which has only sent a target before."""
    free = PathPlanner(grid).costs(45, 30)
    free = np.argwhere(np.isfinite(free))[:, ::-1]
    cells = [(int(x), int(y)) for x, y in free[random.integers(0, len(free), robots + 1)]]
    gone = cells[-1]
    team = range(robots)
    return [
        Situation(
            step=7,
            grid=grid,
            x=cells[robot][0],
            y=cells[robot][1],
            homes=dict.fromkeys(range(robots + 1), cells[0]),
            home=cells[0],
            peers=tuple(peer for peer in team if peer != robot),
            poses={peer: TeammatePose(*cells[peer], leads=False) for peer in team if peer != robot},
            targets={robots: gone},
            target_steps={robots: -99},
        )
        for robot in team
    ]


def tables(name: str, seed: int, ranges: list[float], radii: list[float] | None = None) -> list[Any]:
    """Goals and assignment that each member of a team computes; for tours, the cluster of each goal."""
    random = np.random.default_rng(seed)
    grid = half_explored(random)
    found = []
    for robot, situation in enumerate(views(random, grid, len(ranges) - 1)):
        sizes = {"ranges_cells": ranges, "radii_cells": radii or []}
        planning_robot: Any = strategy(name)({}, settings_for(grid, robot, len(ranges), **sizes))
        planner = PathPlanner(grid, radius_cells=planning_robot.settings.body.radius_cells)
        goals = planning_robot.goals(situation, planner)
        if len(goals):
            table = planning_robot.table(situation, goals, planner)
            share = (
                cluster_goals(table) if name == "mtsp" else planning_robot.assign(table, situation, planner)
            )
            found.append((goals.tolist(), share.tolist()))
    return found


@pytest.mark.parametrize("name", [*SHARED, "mtsp"])
@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1), ranges=st.permutations([25.0, 100.0, 40.0, 60.0]))
def test_robots_with_different_sensors_compute_one_assignment(
    name: str, seed: int, ranges: list[float]
) -> None:
    found = tables(name, seed, ranges)
    assert found
    assert all(each == found[0] for each in found)


@pytest.mark.parametrize("name", [*SHARED, "mtsp"])
@settings(max_examples=4)
@given(seed=st.integers(0, 2**32 - 1), radii=st.permutations([0.0, 2.0, 3.0, 0.0]))
def test_robots_of_different_sizes_compute_one_assignment(name: str, seed: int, radii: list[float]) -> None:
    found = tables(name, seed, [30.0] * 4, radii)
    assert all(each == found[0] for each in found)


def test_the_frontier_of_robots_of_different_sizes_is_what_any_of_them_reaches_row_by_row() -> None:
    random = np.random.default_rng(5)
    grid = half_explored(random)
    radii = [3.0, 0.0, 2.0]
    for robot, situation in enumerate(views(random, grid, 2)):
        planning_robot: Any = strategy("repairmen")(
            {}, settings_for(grid, robot, 3, ranges_cells=[30.0] * 3, radii_cells=radii)
        )
        cells = planning_robot.team(situation)
        reached = {
            tuple(cell)
            for peer, here in cells.items()
            for cell in PathPlanner(grid, radius_cells=radii[peer]).frontier(*here).tolist()
        }
        found = planning_robot.frontier(situation, PathPlanner(grid, radius_cells=radii[robot]))
        assert len(cells) > 1 and found.dtype == np.int32
        assert found.tolist() == [list(cell) for cell in sorted(reached, key=lambda cell: cell[::-1])]


def test_a_wide_robot_is_assigned_reachable_goals() -> None:
    # A hall with a door of one cell; the unknown cells lie in the room behind it and to the right.
    grid = np.full((21, 40), FREE, np.uint8)
    grid[:, 10] = OCCUPIED
    grid[10, 10] = FREE
    grid[10, 0] = grid[10, 39] = UNKNOWN
    view = Situation(
        step=1, grid=grid, x=14, y=10, home=(14, 10), peers=(1,), poses={1: TeammatePose(16, 10, leads=False)}
    )
    for radii, target in (([0.0, 3.0], (1, 10)), ([3.0, 0.0], (38, 10))):
        planning_robot = strategy("burgard")(
            {}, settings_for(grid, radii_cells=radii, ranges_cells=[10.0, 10.0])
        )
        assert planning_robot.decide(view).target == target


def test_a_target_lowers_utilities_within_the_range_of_its_robot() -> None:
    # Three places to go to from (30, 2); a teammate is headed for the one at the left end.
    grid = np.full((5, 80), FREE, np.uint8)
    grid[:, 79] = grid[:, 0] = grid[0, 40] = UNKNOWN
    view = Situation(step=1, grid=grid, x=30, y=2, home=(30, 2), targets={0: (1, 2)}, target_steps={0: 1})
    for ranges, column in (([20.0, 200.0], 40), ([200.0, 20.0], 78)):
        planning_robot = strategy("meier")({"beta": 0.4}, settings_for(grid, robot=1, ranges_cells=ranges))
        target = planning_robot.decide(view).target
        assert target is not None
        assert abs(target[0] - column) <= 1


def targets_in_a_corridor(**options: Any) -> list[Any]:
    """Targets of two robots in a corridor with gaps in its wall at 14, 40, and 45; they stand at 35 and 36."""
    grid = np.full((5, 60), FREE, np.uint8)
    grid[[0, 4]] = OCCUPIED
    grid[:, [0, 59]] = OCCUPIED
    grid[0, [14, 40, 45]] = UNKNOWN
    found = []
    for robot in (0, 1):
        cells = [(35, 2), (36, 2)]
        (x, y), other = cells[robot], cells[1 - robot]
        view = Situation(
            step=1, grid=grid, x=x, y=y, home=(x, y), peers=(1 - robot,),
            poses={1 - robot: TeammatePose(*other, leads=False)},
        )  # fmt: skip
        found.append(
            strategy("burgard")(options, settings_for(grid, robot, ranges_cells=[20.0] * 2))
            .decide(view)
            .target
        )
    return found


def test_where_lasers_see_short_distances_a_target_lowers_utilities_around_it_less() -> None:
    # By Eq. 2, a robot at gap 40 covers gap 45 with probability 0.75. Few beams in the corridor get that far.
    assert targets_in_a_corridor() == [(14, 1), (40, 1)]
    assert targets_in_a_corridor(visibility="learned") == [(45, 1), (40, 1)]


def test_last_targets_out_of_range_count_by_the_learned_probability() -> None:
    # Beside gaps 40 and 45, which the last target of a robot out of range lowers by P(5).
    grid = np.full((5, 60), FREE, np.uint8)
    grid[[0, 4]] = OCCUPIED
    grid[:, [0, 59]] = OCCUPIED
    grid[0, [14, 45]] = UNKNOWN
    view = Situation(step=1, grid=grid, x=35, y=2, home=(35, 2), targets={1: (40, 1)}, target_steps={1: 1})
    for visibility, target in (("linear", (14, 1)), ("learned", (45, 1))):
        robot = strategy("burgard")({"visibility": visibility}, settings_for(grid, ranges_cells=[20.0] * 2))
        assert robot.decide(view).target == target


def test_algorithm_2_has_no_learned_probability() -> None:
    with pytest.raises(ValueError, match="burgard-optimal has no option 'visibility'"):
        strategy("burgard-optimal")({"visibility": "learned"}, settings_for(np.full((5, 5), FREE, np.uint8)))
