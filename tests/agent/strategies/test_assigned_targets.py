"""Decisions of strategies that assign targets to the whole team, worked out by hand on small maps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agent.strategies.base import TeammatePose
from protocol.grid import FREE, OCCUPIED, UNKNOWN
from tests.agent.planning.planning_references import drawn
from tests.agent.strategies.deciding import CORRIDOR, SHORTEST, decide, make_strategy, robot_at


@pytest.mark.parametrize(
    "name", ["burgard", "burgard-optimal", "greedy", "iterative", "hungarian", "mtsp", "repairmen"]
)
def test_members_of_a_sub_team_compute_one_assignment(name: str) -> None:
    cells = {0: (4, 1), 1: (5, 1)}
    targets = []
    for robot in (0, 1):
        peers = {peer: TeammatePose(*cell, leads=False) for peer, cell in cells.items() if peer != robot}
        situation = robot_at(*cells[robot], peers=tuple(peers), poses=peers)
        targets.append(decide(name, situation, SHORTEST, robot=robot, ranges_cells=[50.0, 50.0]).target)
    assert sorted(targets) == [(0, 1), (14, 1)]  # type: ignore[type-var]


@pytest.mark.parametrize("name", ["greedy", "iterative", "hungarian", "mtsp"])
def test_small_frontier_segments_are_goals_unless_they_are_dropped(name: str) -> None:
    assert decide(name, robot_at(4)).target == (0, 1)
    dropped = decide(name, robot_at(4), {"small_segments": "dropped"})
    assert dropped.target is None and dropped.explored


def test_a_robot_out_of_range_is_no_member_but_its_last_target_is_remembered() -> None:
    away = robot_at(4, poses={1: TeammatePose(5, 1, False)}, targets={1: (0, 1)}, target_steps={1: 1})
    assert decide("burgard", away, SHORTEST | {"beta": 0.5}).target == (14, 1)
    assert decide("hungarian", away).target == (14, 1)


@pytest.mark.parametrize("name", ["burgard", "burgard-optimal"])
def test_without_a_weight_of_costs_goals_that_a_teammate_cannot_reach_are_no_hindrance(name: str) -> None:
    walled = CORRIDOR.copy()
    walled[1, 10] = OCCUPIED
    away = robot_at(4, grid=walled, peers=(1,), poses={1: TeammatePose(12, 1, leads=False)})
    assert decide(name, away, SHORTEST | {"beta": 0.0}).target == (0, 1)


def test_greedy_draws_the_same_order_of_robots_in_all_members() -> None:
    # The first robot in the order takes the left goal.
    cells = {0: (5, 1), 1: (6, 1)}
    left = []
    for step in range(1, 20):
        targets = {}
        for robot in (0, 1):
            poses = {peer: TeammatePose(*cell, leads=False) for peer, cell in cells.items() if peer != robot}
            situation = replace(robot_at(*cells[robot], peers=tuple(poses), poses=poses), step=step)
            targets[robot] = decide("greedy", situation, robot=robot).target
        assert set(targets.values()) == {(0, 1), (14, 1)}
        left.append(targets[0] == (0, 1))
    assert set(left) == {True, False}


def test_hungarian_depot_counts_the_way_back_and_mtsp_depot_ends_its_tour_there() -> None:
    # The left frontier cell is 6 away, the right one 8. One goes where the depot is, the other there last.
    for name, depot in (("hungarian", (13, 1)), ("mtsp", (1, 1))):
        situation = replace(robot_at(6), home=depot, homes={0: depot})
        assert decide(name, situation).target == (0, 1)
        assert decide(f"{name}-depot", situation).target == (14, 1)


def test_mtsp_with_fewer_goals_than_robots_takes_the_cheapest_pair_first() -> None:
    one_frontier = CORRIDOR.copy()
    one_frontier[0, 14] = 2
    cells = {0: (6, 1), 1: (4, 1)}
    for robot, expected in ((0, None), (1, (0, 1))):
        poses = {peer: TeammatePose(*cell, leads=False) for peer, cell in cells.items() if peer != robot}
        situation = robot_at(*cells[robot], grid=one_frontier, peers=tuple(poses), poses=poses)
        assert decide("mtsp", situation, {"candidates": "rfe"}, robot=robot).target == expected


@pytest.mark.parametrize("robots", [2, 3])
def test_mtsp_leaves_robots_with_empty_clusters_idle_if_told_to(robots: int) -> None:
    # Both goals are nearest to robot 0: fewer goals than robots, or as many.
    grid = drawn("?####", ".####", *3 * ["....."], ".####", "?####")
    cells = dict(enumerate([(2, 3), (3, 3), (4, 3)][:robots]))
    for empty_clusters, with_goal in (("filled", {0, 1}), ("idle", {0})):
        targets = {}
        for robot, cell in cells.items():
            poses = {peer: TeammatePose(*at, leads=False) for peer, at in cells.items() if peer != robot}
            situation = robot_at(*cell, grid=grid, peers=tuple(poses), poses=poses)
            options = {"empty_clusters": empty_clusters}
            targets[robot] = decide("mtsp", situation, options, robot=robot, robots=robots).target
        assert {robot for robot, target in targets.items() if target} == with_goal


@pytest.mark.parametrize("name", ["greedy", "iterative", "hungarian", "mtsp"])
def test_goals_are_means_of_clusters_if_told_to_unless_these_are_occupied(name: str) -> None:
    # A frontier like an L: the mean of its cells lies inside.
    options = {"candidates": "rfe", "replan": "at-goal"}
    for sign, on_frontier, mean in ((".", (3, 1), (3, 2)), ("#", (3, 1), (3, 1))):
        grid = drawn("??????", ".....?", f"...{sign}.?", *3 * [".....?"])
        for goals, target in (("cell", on_frontier), ("mean", mean)):
            chosen = decide(
                name, robot_at(0, 5, grid=grid), options | {"goals": goals}, ranges_cells=[50.0] * 2
            )
            assert chosen.target == target


def test_mtsp_tours_all_goals_of_its_cluster_if_told_to() -> None:
    # Goals up to 24 cells and at 28 cells to the right, and at 26 to the left: the shorter side is the first of a tour,
    # but it is not among the 12 nearest goals.
    grid = drawn("#" * 60, "." * 60, "#" * 60)
    grid[0, [4, *range(32, 55, 2), 58]] = UNKNOWN
    for tours, first in (("nearest-12", (32, 1)), ("whole", (4, 1))):
        options = {"candidates": "rfe", "tours": tours}
        assert decide("mtsp", robot_at(30, grid=grid), options).target == first


@pytest.mark.parametrize("tours", ["nearest-12", "whole"])
@pytest.mark.parametrize("costs", ["shortest", "weighted"])
def test_mtsp_plans_where_only_its_own_cell_joins_two_parts_of_the_floor(tours: str, costs: str) -> None:
    # The map bars the robot's cell, as a wrong reading may do: there is no way between the goals on its two sides.
    grid = drawn("#" * 41, "." * 20 + "#" + "." * 20, "#" * 41)
    grid[0, [2, 6, 35, 38]] = UNKNOWN
    options = {"candidates": "rfe", "tours": tours, "costs": costs}
    assert decide("mtsp", robot_at(20, grid=grid), options).target == (6, 1)


def test_hungarian_depot_assigns_near_goals_to_robots_that_traveled_far() -> None:
    one_frontier = CORRIDOR.copy()
    one_frontier[0, 14] = 2
    cells = {0: (4, 1), 1: (6, 1)}
    for traveled, expected in (({0: 0.0, 1: 0.0}, 0), ({0: 9.0, 1: 1.0}, 1), ({0: 2.0, 1: 1.0}, 0)):
        for robot in (0, 1):
            poses = {peer: TeammatePose(*cell, leads=False) for peer, cell in cells.items() if peer != robot}
            situation = robot_at(*cells[robot], grid=one_frontier, peers=tuple(poses), poses=poses)
            situation = replace(situation, home=(7, 1), homes={0: (7, 1), 1: (7, 1)}, traveled=traveled)
            target = decide("hungarian-depot", situation, robot=robot).target
            assert target == ((0, 1) if robot == expected else None)


def test_of_two_members_with_one_target_the_higher_numbered_chooses_again() -> None:
    for robot, other, expected in ((1, 0, (14, 1)), (0, 1, (0, 1))):
        member = make_strategy("iterative", robot=robot)
        assert member.decide(robot_at(4)).target == (0, 1)
        received = {other: (0, 1)}
        there = {other: TeammatePose(1, 1, leads=False)}
        situation = robot_at(
            4, peers=(other,), poses=there, targets=received, target_steps={other: 2}, new_targets=received
        )
        assert member.decide(replace(situation, step=2)).target == expected


def test_a_member_that_is_done_makes_the_others_choose_again_once() -> None:
    opened = CORRIDOR.copy()
    opened[0, 14] = 2
    opened[2, 14] = UNKNOWN
    teammate: dict[str, Any] = {"targets": {1: (12, 1)}, "target_steps": {1: 2}, "peers": (1,)}
    teammate["poses"] = {1: TeammatePose(12, 1, leads=False)}
    member = make_strategy("iterative")
    assert member.decide(robot_at(4, grid=opened)).target == (0, 1)
    assert member.decide(replace(robot_at(4, grid=opened, **teammate), step=2)).target == (0, 1)
    # Nearer to the other end by now, with the same teammate done with the same target.
    teammate["poses"] = {1: TeammatePose(2, 1, leads=False)}
    assert member.decide(replace(robot_at(11, grid=opened, **teammate), step=3)).target == (0, 1)
    teammate["targets"] = {1: (2, 1)}
    assert member.decide(replace(robot_at(11, grid=opened, **teammate), step=4)).target == (14, 1)


def test_allocation_strategies_straighten_their_routes() -> None:
    grid = np.full((12, 31), FREE, np.uint8)
    grid[10, 30] = UNKNOWN
    path = decide("greedy", robot_at(0, 0, grid=grid), {"candidates": "cells"}, speed_cells=60.0).path
    end_x, end_y = path[-1]
    off_line = [abs(y - x * end_y / end_x) for x, y in path.tolist()]
    assert max(off_line) <= 0.5


def test_a_robot_without_a_goal_relies_on_its_teammates_for_a_limited_time() -> None:
    one_frontier = CORRIDOR.copy()
    one_frontier[0, 14] = 2
    waits = robot_at(6, grid=one_frontier, peers=(0,), poses={0: TeammatePose(1, 1, leads=False)})
    member = make_strategy("hungarian", {"candidates": "rfe"}, robot=1)
    targets = [member.decide(replace(waits, step=step)).target for step in range(1, 22)]
    assert targets == [None] * 19 + [(0, 1)] * 2


def test_a_robot_without_a_goal_waits_and_is_not_done() -> None:
    one_frontier = CORRIDOR.copy()
    one_frontier[0, 14] = 2
    near = {0: TeammatePose(1, 1, False)}
    situation = robot_at(6, grid=one_frontier, peers=(0,), poses=near)
    decision = decide("hungarian", situation, {"candidates": "rfe"}, robot=1)
    assert decision.target is None
    assert not decision.explored
    assert "teammates have taken all goals" in decision.status


def test_at_goal_a_team_replans_when_a_member_arrives_and_not_when_a_goal_is_opened() -> None:
    team = make_strategy("hungarian", {"replan": "at-goal", "candidates": "cells"}, ranges_cells=[50.0, 50.0])
    there = {1: TeammatePose(10, 1, False)}
    first = team.decide(robot_at(4, peers=(1,), poses=there))
    assert first.target == (0, 1)
    opened = CORRIDOR.copy()
    opened[0, 0] = 2
    teammate: dict[str, Any] = {"targets": {1: (14, 1)}, "target_steps": {1: 2}, "peers": (1,)}
    assert team.decide(robot_at(3, grid=opened, poses=there, **teammate)).target == (0, 1)
    arrived = {1: TeammatePose(14, 1, False)}
    assert team.decide(robot_at(3, grid=opened, poses=arrived, **teammate)).target != (0, 1)
