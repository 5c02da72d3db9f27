"""Decisions of strategies, worked out by hand on small maps: targets, routes, and the end of a mission."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agent.planning.path_planner import PathPlanner
from agent.strategies.base import Situation, TeammatePose
from agent.strategies.burgard import Nearest
from agent.strategies.homing import HOME_AFTER
from agent.strategies.registry import strategy
from agent.strategies.team import PLAN_ALONE_AFTER
from protocol.body import Body
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid
from tests.agent.planning.planning_references import drawn, settings_for
from tests.agent.strategies.deciding import CORRIDOR, decide, make_strategy, robot_at


def test_alone_meier_takes_the_nearest_frontier() -> None:
    assert decide("meier", robot_at(4)).target == (0, 1)
    assert decide("meier", robot_at(11)).target == (14, 1)


def test_meier_avoids_targets_of_teammates_and_beta_weighs_the_cost() -> None:
    # U: 0 and 1; V: 4 / 5 and 10 / 5 sensor ranges.
    taken = robot_at(4, targets={1: (0, 1)}, target_steps={1: 1})
    assert decide("meier", taken, {"beta": 0.5}).target == (14, 1)
    assert decide("meier", taken, {"beta": 1.0}).target == (0, 1)


def test_an_old_target_counts_less_if_targets_age() -> None:
    old = robot_at(4, targets={1: (0, 1)}, target_steps={1: -99})
    assert decide("meier", old, {"beta": 0.5}).target == (14, 1)
    assert decide("meier", old, {"beta": 0.5, "half_life": 20.0}).target == (0, 1)
    assert decide("meier", old, {"beta": 0.5, "forget": 100}).target == (0, 1)
    assert decide("meier", old, {"beta": 0.5, "forget": 1000}).target == (14, 1)


@pytest.mark.parametrize("candidates", ["cells", "rfe"])
def test_a_past_target_counts_until_the_map_shows_it(candidates: str) -> None:
    first = CORRIDOR.copy()
    first[0, 7] = UNKNOWN  # a third frontier cell, on which the robot stands
    hidden = CORRIDOR.copy()
    hidden[0, 2] = UNKNOWN
    shown = hidden.copy()
    shown[0, 0] = FREE

    def next_target(grid: Grid, past_targets: int) -> Cell | None:
        options = {"candidates": candidates, "beta": 0.1, "past_targets": past_targets}
        robot = make_strategy("meier", options)
        for target, x, now in (((0, 1), 7, first), ((7, 1), 4, grid)):
            new = {1: target}
            seen = robot_at(x, grid=now, targets=new, target_steps={1: 1}, new_targets=new)
            decision = robot.decide(seen)
        return decision.target

    # U of (2, 1) is 1, or 0.4 beside the past target (0, 1); U of (14, 1) is 1; V: 2 / 5 and 10 / 5 sensor ranges.
    assert next_target(hidden, 0) == (2, 1)
    assert next_target(hidden, 1) == (14, 1)
    assert next_target(shown, 1) == (2, 1)


@pytest.mark.parametrize(
    ("name", "options"),
    [("meier", {"beta": 0.1}), ("scan-replan", {"herding": True}), ("continuous-replan", {"herding": True})],
)
def test_of_two_robots_with_close_targets_the_higher_numbered_chooses_again_once(
    name: str, options: dict[str, Any]
) -> None:
    for robot, other, expected in ((1, 0, (14, 1)), (0, 1, (0, 1))):
        swarm = make_strategy(name, options, robot=robot)
        assert swarm.decide(robot_at(4)).target == (0, 1)
        received = {other: (0, 1)}
        news = robot_at(4, targets=received, target_steps={other: 2}, new_targets=received)
        assert swarm.decide(news).target == expected


def test_a_target_behind_a_wall_is_no_herding() -> None:
    # Two corridors, each with frontier cells at both ends.
    grid = drawn("?...............?", "#################", "?...............?")
    for cell, expected in (((1, 2), (1, 0)), ((2, 0), (15, 0))):
        swarm = make_strategy("meier", {"beta": 0.1}, grid, robot=1)
        assert swarm.decide(robot_at(5, 0, grid=grid)).target == (1, 0)
        received = {0: cell}
        later = robot_at(12, 0, grid=grid, targets=received, target_steps={0: 2}, new_targets=received)
        assert swarm.decide(later).target == expected


def test_nearest_ignores_teammates_and_publishes_no_target() -> None:
    kind = strategy("nearest")
    assert not kind.publishes_target
    assert decide("nearest", robot_at(4, targets={1: (0, 1)}, target_steps={1: 1})).target == (0, 1)


def test_algorithm_2_counts_costs_squared() -> None:
    # U: 0 and 1; V: 1 and 1.8 sensor ranges. U - V is larger on the right, U - V squared on the left.
    away = robot_at(5, targets={1: (0, 1)}, target_steps={1: 1})
    assert decide("burgard", away).target == (14, 1)
    assert decide("burgard-optimal", away).target == (0, 1)


def test_burgard_replans_periodically_with_every() -> None:
    for every, expected in ((0, (0, 1)), (5, (14, 1))):
        team = make_strategy("burgard", {"every": every})
        assert team.decide(robot_at(4)).target == (0, 1)
        assert team.decide(replace(robot_at(11), step=4)).target == (0, 1)
        assert team.decide(replace(robot_at(11), step=5)).target == expected


def test_burgard_replans_after_a_time_and_after_a_distance() -> None:
    for options in ({"after_steps": 5}, {"after_meters": 0.7}):
        team = make_strategy("burgard", options)
        assert team.decide(replace(robot_at(4), step=3)).target == (0, 1)
        soon = replace(robot_at(11), step=7, traveled={0: 6.0})
        assert team.decide(soon).target == (0, 1)
        assert team.decide(replace(soon, step=8, traveled={0: 7.0})).target == (14, 1)


@pytest.mark.parametrize("costs", ["shortest", "weighted"])
@pytest.mark.parametrize("name", ["meier", "burgard", "burgard-optimal"])
def test_cells_of_high_occupancy_are_obstacles_with_occ_max(name: str, costs: str) -> None:
    # A corridor of one cell leads to the left, one of five to the right.
    grid = drawn(*2 * ["######........."], "?.............?", *2 * ["######........."])
    options = {"costs": costs}
    left = 1 if costs == "shortest" else 13
    for occ_max, column in ((1.0, left), (0.5, 13)):
        target = decide(name, robot_at(6, 2, grid=grid), options | {"occ_max": occ_max}).target
        assert target is not None
        assert abs(target[0] - column) <= 1


def test_a_disc_keeps_its_radius_from_obstacles() -> None:
    grid = np.full((15, 15), FREE, np.uint8)
    grid[7, 5:10] = 2
    grid[0, 7] = UNKNOWN
    path = decide("meier", robot_at(7, 12, grid=grid), radii_cells=[2.0, 2.0], speed_cells=20.0).path
    assert all(abs(x - 7) > 4 or abs(y - 7) > 2 for x, y in path.tolist())


def test_without_frontiers_an_open_mission_is_done_and_a_returning_robot_drives_home() -> None:
    known = drawn("#######", ".......", "#######")
    assert decide("meier", robot_at(5, grid=known)).explored
    swarm = make_strategy("meier", {"mission": "return"}, known)
    on_the_way = swarm.decide(replace(robot_at(5, grid=known), home=(1, 1)))
    assert not on_the_way.explored
    assert on_the_way.path[-1].tolist() == [1, 1]
    assert swarm.decide(replace(robot_at(1, grid=known), home=(1, 1))).explored


@pytest.mark.parametrize("mission", ["open", "return"])
@pytest.mark.parametrize("name", ["burgard", "hungarian", "mtsp"])
def test_a_member_of_a_team_is_done_in_every_step_without_frontiers(name: str, mission: str) -> None:
    known = drawn("#######", ".......", "#######")
    member = make_strategy(name, {"mission": mission}, known)
    at_home = robot_at(5, grid=known, peers=(1,), poses={1: TeammatePose(2, 1, False)})
    done = [member.decide(replace(at_home, step=step)).explored for step in range(1, 2 * PLAN_ALONE_AFTER)]
    assert all(done)
    left = robot_at(5, peers=(1,), poses={1: TeammatePose(2, 1, False)})
    assert not member.decide(replace(left, step=2 * PLAN_ALONE_AFTER)).explored


def test_a_returning_robot_near_home_is_done_once_returned_teammates_block_it_for_long() -> None:
    known = np.repeat(drawn("#######", ".......", "#######"), 10, axis=1)
    for start, near in ((3, True), (60, False)):
        swarm = make_strategy("meier", {"mission": "return"}, known)
        at = replace(robot_at(start, grid=known), home=(0, 1), blocked="robot")
        after = [swarm.decide(replace(at, step=step)) for step in range(1, 20)]
        assert [decision.explored for decision in after] == [False] * 9 + [near] * 10
        assert not near or not len(after[-1].path)


CUT_OFF = drawn("?..............?", "................", "################", "................")
"""A depot at (0, 3) cannot be reached from above the wall."""


@pytest.mark.parametrize("name", ["hungarian-depot", "mtsp-depot", "meier"])
def test_a_robot_without_a_known_way_home_still_explores(name: str) -> None:
    cut_off = replace(robot_at(7, grid=CUT_OFF), home=(0, 3), homes={0: (0, 3)})
    assert decide(name, cut_off, {"mission": "return"}).target is not None


@pytest.mark.parametrize("name", ["hungarian-depot", "mtsp-depot", "meier"])
def test_a_robot_without_a_way_home_for_long_ends_its_mission(name: str) -> None:
    known = np.where(CUT_OFF == UNKNOWN, FREE, CUT_OFF).astype(np.uint8)
    cut_off = replace(robot_at(7, grid=known), home=(0, 3), homes={0: (0, 3)})
    swarm = make_strategy(name, {"mission": "return"}, known, robots=1)
    after = [swarm.decide(replace(cut_off, step=step)) for step in range(1, 20)]
    assert [decision.explored for decision in after] == [False] * (HOME_AFTER - 1) + [True] * 10
    assert {decision.status for decision in after} == {"idle: the map shows no way home"}
    opened = known.copy()
    opened[2, 9] = FREE
    on_the_way = swarm.decide(replace(cut_off, grid=opened, step=20))
    assert not on_the_way.explored
    assert len(on_the_way.path)


@pytest.mark.parametrize("name", ["leaders", "meier"])
def test_a_robot_on_the_frontier_turns_to_the_unknown_cells(name: str) -> None:
    grid = np.full((9, 9), FREE, np.uint8)
    for (x, y), heading in {(5, 4): 0, (4, 5): 2, (3, 4): 4, (4, 3): 6}.items():
        around = grid.copy()
        around[y, x] = UNKNOWN
        assert decide(name, replace(robot_at(4, 4, grid=around), heading=3)).heading == heading


def test_a_robot_on_a_diagonal_frontier_turns_to_the_unknown_cell_if_such_cells_are_goals() -> None:
    grid = np.full((9, 9), FREE, np.uint8)
    for (x, y), heading in {(5, 5): 1, (3, 5): 3, (3, 3): 5, (5, 3): 7}.items():
        around = grid.copy()
        around[y, x] = UNKNOWN
        here = replace(robot_at(4, 4, grid=around), heading=2)
        for candidates, expected in (("hops", heading), ("breadth-first", 2)):
            assert decide("nearest", here, {"candidates": candidates}).heading == expected
    around[3, 4] = around[4, 5] = OCCUPIED  # it cannot be seen between two walls
    around[5, 3] = UNKNOWN
    here = replace(robot_at(4, 4, grid=around), heading=2)
    assert decide("nearest", here, {"candidates": "hops"}).heading == 3


@pytest.mark.parametrize("name", ["leaders", "meier"])
def test_a_robot_turns_around_where_an_unseen_wall_stops_it(name: str) -> None:
    stopped = replace(robot_at(4), heading=7, blocked="wall")
    assert decide(name, stopped, field_of_view=180.0).heading == 0
    assert decide(name, replace(stopped, heading=0), field_of_view=180.0).heading == 1
    assert decide(name, stopped).heading == 7
    assert decide(name, replace(stopped, blocked="robot"), field_of_view=180.0).heading == 7


def test_the_angle_of_a_scanner_defines_the_steps_of_a_full_turn() -> None:
    turns = {0.0: 1, 72.0: 5, 18.0: 20, 100.0: 4, 360.0: 1}
    for degrees, steps in turns.items():
        assert Body(5.0, 360.0, 3.0, degrees).turn_steps == steps


def test_a_strategy_may_choose_any_goal_and_nothing_else() -> None:
    class Own(Nearest):
        chosen: Any = None

        def choose(self, situation: Situation, goals: Any, planner: PathPlanner) -> Cell | None:
            row: Cell | None = self.chosen
            return row

    for chosen in ((14, 1), np.array([14, 1], np.int32)):
        own = Own({}, settings_for(CORRIDOR))
        own.chosen = chosen
        assert own.decide(robot_at(4)).target == (14, 1)
    for wrong in ((7, 1), (10**6, -1)):
        own = Own({}, settings_for(CORRIDOR))
        own.chosen = wrong
        with pytest.raises(ValueError, match=r"strategy nearest chose .*, which is not one of its goals"):
            own.decide(robot_at(4))
    for wrong in (3, (7, 1, 2), "14,1"):
        own = Own({}, settings_for(CORRIDOR))
        own.chosen = wrong
        with pytest.raises(TypeError, match=r"choose must return a goal \(x, y\), or None; it returned"):
            own.decide(robot_at(4))
