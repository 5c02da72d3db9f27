"""Decisions of strategies, worked out by hand on small maps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agent.planning.path_planner import PathPlanner
from agent.planning.route import crossed
from agent.strategies.base import Cell, Decision, Pose, Situation, Strategy
from agent.strategies.burgard import Nearest
from agent.strategies.leaders import STALL_STEPS, elect
from agent.strategies.registry import strategy
from agent.strategies.rotating import ShengBid
from agent.strategies.targets import HOME_AFTER
from agent.strategies.team import PLAN_ALONE_AFTER
from protocol.body import Body
from protocol.grid import FREE, UNKNOWN, Grid
from tests.agent.planning.planning_references import drawn, settings_for

# Two frontier cells, (0, 1) and (14, 1), at the ends of a corridor.
CORRIDOR = drawn("###############", "..............." , "###############")  # fmt: skip
CORRIDOR[0, 0] = CORRIDOR[0, 14] = UNKNOWN


SHORTEST = {"costs": "shortest"}


def robot_at(x: int, y: int = 1, grid: Grid = CORRIDOR, **others: Any) -> Situation:
    return Situation(step=1, grid=grid, x=x, y=y, home=(x, y), **others)


def make_strategy(
    name: str, options: dict[str, Any] | None = None, grid: Grid = CORRIDOR, **settings: Any
) -> Strategy:
    return strategy(name)(options or {}, settings_for(grid, **settings))


def decide(
    name: str, situation: Situation, options: dict[str, Any] | None = None, **settings: Any
) -> Decision:
    return make_strategy(name, options, situation.grid, **settings).decide(situation)


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


@pytest.mark.parametrize(
    "name", ["burgard", "burgard-optimal", "greedy", "iterative", "hungarian", "mtsp", "repairmen"]
)
def test_members_of_a_sub_team_compute_one_assignment(name: str) -> None:
    cells = {0: (4, 1), 1: (5, 1)}
    targets = []
    for robot in (0, 1):
        peers = {peer: Pose(*cell, leads=False) for peer, cell in cells.items() if peer != robot}
        situation = robot_at(*cells[robot], peers=tuple(peers), poses=peers)
        targets.append(decide(name, situation, SHORTEST, robot=robot, ranges_cells=[50.0, 50.0]).target)
    assert sorted(targets) == [(0, 1), (14, 1)]  # type: ignore[type-var]


@pytest.mark.parametrize("name", ["greedy", "iterative", "hungarian", "mtsp"])
def test_small_frontier_segments_are_goals_unless_they_are_dropped(name: str) -> None:
    assert decide(name, robot_at(4)).target == (0, 1)
    dropped = decide(name, robot_at(4), {"small_segments": "dropped"})
    assert dropped.target is None and dropped.explored


def test_a_robot_out_of_range_is_no_member_but_its_last_target_is_remembered() -> None:
    away = robot_at(4, poses={1: Pose(5, 1, False)}, targets={1: (0, 1)}, target_steps={1: 1})
    assert decide("burgard", away, SHORTEST | {"beta": 0.5}).target == (14, 1)
    assert decide("hungarian", away).target == (14, 1)


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
    for options in ({"after_steps": 5}, {"after_metres": 0.7}):
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


def test_greedy_draws_the_same_order_of_robots_in_all_members() -> None:
    # The first robot in the order takes the left goal.
    cells = {0: (5, 1), 1: (6, 1)}
    left = []
    for step in range(1, 20):
        targets = {}
        for robot in (0, 1):
            poses = {peer: Pose(*cell, leads=False) for peer, cell in cells.items() if peer != robot}
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
        poses = {peer: Pose(*cell, leads=False) for peer, cell in cells.items() if peer != robot}
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
            poses = {peer: Pose(*at, leads=False) for peer, at in cells.items() if peer != robot}
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
            poses = {peer: Pose(*cell, leads=False) for peer, cell in cells.items() if peer != robot}
            situation = robot_at(*cells[robot], grid=one_frontier, peers=tuple(poses), poses=poses)
            situation = replace(situation, home=(7, 1), homes={0: (7, 1), 1: (7, 1)}, traveled=traveled)
            target = decide("hungarian-depot", situation, robot=robot).target
            assert target == ((0, 1) if robot == expected else None)


def test_of_two_members_with_one_target_the_higher_numbered_chooses_again() -> None:
    for robot, other, expected in ((1, 0, (14, 1)), (0, 1, (0, 1))):
        member = make_strategy("iterative", robot=robot)
        assert member.decide(robot_at(4)).target == (0, 1)
        received = {other: (0, 1)}
        there = {other: Pose(1, 1, leads=False)}
        situation = robot_at(
            4, peers=(other,), poses=there, targets=received, target_steps={other: 2}, new_targets=received
        )
        assert member.decide(replace(situation, step=2)).target == expected


def test_a_member_that_is_done_makes_the_others_choose_again_once() -> None:
    opened = CORRIDOR.copy()
    opened[0, 14] = 2
    opened[2, 14] = UNKNOWN
    teammate: dict[str, Any] = {"targets": {1: (12, 1)}, "target_steps": {1: 2}, "peers": (1,)}
    teammate["poses"] = {1: Pose(12, 1, leads=False)}
    member = make_strategy("iterative")
    assert member.decide(robot_at(4, grid=opened)).target == (0, 1)
    assert member.decide(replace(robot_at(4, grid=opened, **teammate), step=2)).target == (0, 1)
    # Nearer to the other end by now, with the same teammate done with the same target.
    teammate["poses"] = {1: Pose(2, 1, leads=False)}
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
    waits = robot_at(6, grid=one_frontier, peers=(0,), poses={0: Pose(1, 1, leads=False)})
    member = make_strategy("hungarian", {"candidates": "rfe"}, robot=1)
    targets = [member.decide(replace(waits, step=step)).target for step in range(1, 22)]
    assert targets == [None] * 19 + [(0, 1)] * 2


def test_a_robot_without_a_goal_waits_and_is_not_done() -> None:
    one_frontier = CORRIDOR.copy()
    one_frontier[0, 14] = 2
    near = {0: Pose(1, 1, False)}
    situation = robot_at(6, grid=one_frontier, peers=(0,), poses=near)
    decision = decide("hungarian", situation, {"candidates": "rfe"}, robot=1)
    assert decision.target is None
    assert not decision.explored
    assert "teammates have taken all goals" in decision.status


def test_at_goal_a_team_replans_when_a_member_arrives_and_not_when_a_goal_is_opened() -> None:
    team = make_strategy("hungarian", {"replan": "at-goal", "candidates": "cells"}, ranges_cells=[50.0, 50.0])
    there = {1: Pose(10, 1, False)}
    first = team.decide(robot_at(4, peers=(1,), poses=there))
    assert first.target == (0, 1)
    opened = CORRIDOR.copy()
    opened[0, 0] = 2
    teammate: dict[str, Any] = {"targets": {1: (14, 1)}, "target_steps": {1: 2}, "peers": (1,)}
    assert team.decide(robot_at(3, grid=opened, poses=there, **teammate)).target == (0, 1)
    arrived = {1: Pose(14, 1, False)}
    assert team.decide(robot_at(3, grid=opened, poses=arrived, **teammate)).target != (0, 1)


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
    at_home = robot_at(5, grid=known, peers=(1,), poses={1: Pose(2, 1, False)})
    done = [member.decide(replace(at_home, step=step)).explored for step in range(1, 2 * PLAN_ALONE_AFTER)]
    assert all(done)
    left = robot_at(5, peers=(1,), poses={1: Pose(2, 1, False)})
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


def test_stop_scan_replan_stays_for_a_full_turn_and_then_publishes() -> None:
    settings: dict[str, Any] = {"scanner_turn": 72.0, "speed_cells": 1.0}
    swarm = make_strategy("stop-scan-replan", **settings)
    decisions = [swarm.decide(robot_at(4)) for _ in range(5)]
    assert [decision.target for decision in decisions] == [None] * 4 + [(0, 1)]
    assert [decision.publish for decision in decisions] == [True] * 5
    assert not swarm.decide(robot_at(3)).publish
    assert settings_for(CORRIDOR, **settings).body.turn_steps == 5


def test_classical_does_not_scan_on_the_way() -> None:
    swarm = make_strategy("classical", scanner_turn=0.0)
    assert swarm.decide(robot_at(4)).target is not None
    assert not swarm.decide(robot_at(3)).look


def test_classical_scans_where_an_unknown_wall_stops_it() -> None:
    swarm = make_strategy("classical", scanner_turn=0.0)
    assert swarm.decide(robot_at(4)).target is not None
    assert swarm.decide(replace(robot_at(3), blocked="wall")).look


def test_a_robot_stopped_for_long_publishes_its_map() -> None:
    swarm = make_strategy("stop-scan-replan")
    assert swarm.decide(robot_at(4)).target == (0, 1)
    published = [
        swarm.decide(replace(robot_at(3), step=step, blocked="robot")).publish for step in range(2, 14)
    ]
    assert sum(published) == 1


def test_scan_replan_keeps_an_opened_target_and_continuous_replan_does_not() -> None:
    opened = CORRIDOR.copy()
    opened[0, 0] = 2
    for name, expected in (("scan-replan", (0, 1)), ("continuous-replan", (14, 1))):
        swarm = make_strategy(name)
        assert swarm.decide(robot_at(4)).target == (0, 1)
        after = swarm.decide(robot_at(3, grid=opened))
        assert after.target == expected
        assert after.publish == (name == "continuous-replan")


def test_a_bid_is_that_of_equation_1() -> None:
    grid = drawn("??????", "......", "######")
    bids = make_strategy(
        "sheng-bid", {"gain": 2.0, "distance": 0.5, "nearness": 0.25}, grid, ranges_cells=[2.0, 2.0]
    )
    assert isinstance(bids, ShengBid)
    goals = np.array([(0, 1), (3, 1)], np.int32)
    # In a disc of two cells around (0, 1) lie (0, 0) and (1, 0); around (3, 1) three cells.
    expected = [
        2.0 * 2 / (4 * np.pi) - 0.5 * 1 / 2,
        2.0 * 3 / (4 * np.pi) - 0.5 * 2 / 2,
    ]
    situation = robot_at(1, grid=grid)
    np.testing.assert_allclose(bids.bids(situation, goals, PathPlanner(grid)), expected)
    # A teammate at (5, 1) will see all that (3, 1) shows but (2, 0) and (3, 0).
    near = replace(situation, poses={1: Pose(5, 1, False)})
    seen_by_it = 2.0 * (3 - 1) / (4 * np.pi)
    np.testing.assert_allclose(
        bids.bids(near, goals, PathPlanner(grid))[1], seen_by_it - 0.5 * 2 / 2 - 0.25 * 2 / 2
    )
    # So will a teammate that is headed there, at an unknown distance.
    headed = replace(situation, targets={1: (5, 1)})
    np.testing.assert_allclose(bids.bids(headed, goals, PathPlanner(grid))[1], seen_by_it - 0.5 * 2 / 2)


def test_leaders_are_elected_over_a_scripted_sequence_of_meetings() -> None:
    # Robot 2 of a team in which robot 0 leads throughout: (leaders that it senses, whether it leads then).
    script: list[tuple[list[int], bool]] = [
        ([0], False),  # beside the first leader
        ([], True),  # has lost it
        ([], True),  # still alone
        ([3], True),  # meets a leader lower in the hierarchy: that one steps down
        ([1], False),  # meets a higher one
        ([1], False),
        ([], True),  # that one is gone, or dead
        ([0, 3], False),  # meets two
    ]
    leads = False
    for sensed, expected in script:
        leads = elect(2, leads, sensed, first=1)
        assert leads == expected
    assert elect(0, True, [1, 2], first=1)
    assert not elect(2, False, [], first=1, dynamic=False)


def test_a_leader_is_sensed_within_rho_lead_and_radio_range() -> None:
    # Cells of a metre, and rho_lead is 4 m: robot 1 becomes a leader itself if it senses none.
    def leads(x: int, *, leading: bool = True, in_range: bool = True) -> bool:
        trooper = make_strategy("leaders", robot=1, resolution=1.0)
        near = {0: Pose(x, 1, leads=leading)}
        trooper.decide(robot_at(10, peers=(0,) if in_range else (), poses=near))
        return trooper.leads

    assert not leads(6)
    assert leads(5)
    assert leads(6, leading=False)
    assert leads(6, in_range=False)


def test_teammates_in_radio_range_repel_a_trooper() -> None:
    grid = np.full((41, 41), FREE, np.uint8)
    grid[0, 20] = UNKNOWN
    ends = []
    for peers in ((), (0,)):
        beside = robot_at(20, 20, grid=grid, peers=peers, poses={0: Pose(14, 20, leads=False)})
        points = decide("potential-field", beside, robot=1, resolution=0.1, speed_cells=10.0).points
        ends.append(points[-1].tolist())
    assert ends[0][0] == 20000
    assert ends[1][0] > 20500


def end_of_trooper(teammates: str, seen: list[tuple[int, tuple[int, ...]]]) -> list[int]:
    """Where a trooper in cell (20, 20) ends, in thousandths of a cell, after it has seen robot 0 at some columns.

    `seen` has the column and the robots in range, for each step.
    """
    grid = np.full((41, 41), FREE, np.uint8)
    grid[0, 20] = UNKNOWN
    options = {"teammates": teammates}
    trooper = make_strategy("potential-field", options, grid, robot=1, resolution=0.1, speed_cells=10.0)
    for column, peers in seen:
        poses = {0: Pose(column, 20, leads=False)}
        points = trooper.decide(robot_at(20, 20, grid=grid, peers=peers, poses=poses)).points
    end: list[int] = points[-1].tolist()
    return end


def test_a_teammate_that_comes_closer_repels_more_if_it_is_assumed_to_move_on() -> None:
    seen = [(8, (0,)), (12, (0,))]
    assert end_of_trooper("moving", seen)[0] > end_of_trooper("still", seen)[0] + 20


def test_a_teammate_that_comes_into_range_is_not_assumed_to_repeat_its_way_since_the_last_contact() -> None:
    seen: list[tuple[int, tuple[int, ...]]] = [(2, (0,)), (2, ()), (14, (0,))]
    assert end_of_trooper("moving", seen) == end_of_trooper("still", seen)


def test_a_leader_takes_the_shortest_way_and_a_trooper_stops_before_the_wall() -> None:
    grid = drawn(
        "..........",
        "..........",
        "#######...",
        "..........",
        "?.........",
    )
    settings = {"speed_cells": 30.0, "resolution": 1.0}
    leader = make_strategy("leaders", {}, grid, **settings).decide(robot_at(0, 0, grid=grid))
    assert leader.points[-1].tolist() == [0, 3000] or leader.points[-1].tolist() == [1000, 4000]
    assert max(x for x, _ in leader.points.tolist()) >= 6500
    trooper = make_strategy("potential-field", {}, grid, **settings).decide(robot_at(0, 0, grid=grid))
    assert max(y for _, y in trooper.points.tolist()) < 1500


@pytest.mark.parametrize("obstacle", ["robot", "person"])
def test_a_leader_drives_around_a_teammate_or_a_person_that_stops_it(obstacle: str) -> None:
    grid = np.full((9, 12), FREE, np.uint8)
    grid[4, 11] = UNKNOWN
    leader = make_strategy("leaders", {}, grid, speed_cells=1.0, resolution=1.0)
    for step, blocked in enumerate(("", obstacle, obstacle), start=1):
        points = leader.decide(replace(robot_at(3, 4, grid=grid), step=step, blocked=blocked)).points
    around = crossed((3000, 4000), points, 100.0).tolist()
    assert [4, 4] not in around
    assert around[-1] in ([11, 3], [10, 4], [11, 5])


@pytest.mark.parametrize("name", ["leaders", "meier"])
def test_a_robot_on_the_frontier_turns_to_the_unknown_cells(name: str) -> None:
    grid = np.full((9, 9), FREE, np.uint8)
    for (x, y), heading in {(5, 4): 0, (4, 5): 2, (3, 4): 4, (4, 3): 6}.items():
        around = grid.copy()
        around[y, x] = UNKNOWN
        assert decide(name, replace(robot_at(4, 4, grid=around), heading=3)).heading == heading


@pytest.mark.parametrize("name", ["leaders", "meier"])
def test_a_robot_turns_around_where_an_unseen_wall_stops_it(name: str) -> None:
    stopped = replace(robot_at(4), heading=7, blocked="wall")
    assert decide(name, stopped, field_of_view=180.0).heading == 0
    assert decide(name, replace(stopped, heading=0), field_of_view=180.0).heading == 1
    assert decide(name, stopped).heading == 7
    assert decide(name, replace(stopped, blocked="robot"), field_of_view=180.0).heading == 7


def test_a_robot_without_progress_is_stalled() -> None:
    swarm = make_strategy("potential-field", {}, resolution=0.1)
    # Between two frontier points at the same distance, in a closed corridor.
    stalled = [swarm.decide(replace(robot_at(7), step=step)).stalled for step in range(1, 70)]
    assert stalled.index(True) == 60


def test_a_trooper_escapes_from_a_local_minimum_until_it_has_observed_the_frontier() -> None:
    grid = drawn(
        "..........",
        "..........",
        "#######...",
        "..........",
        "?.........",
    )
    seen = np.full_like(grid, FREE)
    seen[0, 9] = UNKNOWN
    reach = {}
    for escape in ("always", "never", "real-sensors"):
        trooper = make_strategy("potential-field", {"escape": escape}, grid, speed_cells=30.0, resolution=1.0)
        held = [trooper.decide(replace(robot_at(0, 0, grid=grid), step=step)) for step in range(1, 14)]
        reach[escape] = [each.points[:, 0].max() >= 6500 for each in held]
        after = trooper.decide(replace(robot_at(0, 3, grid=seen), step=14))
        assert after.status == "drawn to its closest frontier"
    assert reach["always"] == 10 * [False] + 3 * [True]
    assert not any(reach["never"])
    assert not any(reach["real-sensors"]), "lasers and poses are exact"


def test_a_slow_leader_that_drives_is_not_stalled() -> None:
    # A hundredth of a metre a step, in cells of 0.1 m: in 60 steps it does not get away a metre.
    leader = make_strategy("leaders", {}, resolution=0.1, speed_cells=0.1)
    driven = [divmod(100 * step + 500, 1000) for step in range(1, 140)]
    steps = [
        replace(robot_at(13 - cells), step=step, offset=(500 - rest, 0))
        for step, (cells, rest) in enumerate(driven, start=1)
        if cells < 13
    ]
    assert len(steps) > 2 * STALL_STEPS
    assert not any(leader.decide(situation).stalled for situation in steps)


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
