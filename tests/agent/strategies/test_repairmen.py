"""Decisions of `repairmen`, worked by hand on small maps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agent.planning.path_planner import PathPlanner
from agent.settings import Settings
from agent.strategies.base import Decision, Situation, TeammatePose
from agent.strategies.repairmen import RECALL, STILL, Repairmen
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.planning.planning_references import settings_for

# A hall of which the left end is a wall with one gap, a cell wide, and the right end is not known yet.
HALL: Grid = np.full((9, 60), FREE, np.uint8)
HALL[[0, -1]] = OCCUPIED
HALL[:, 0] = OCCUPIED
HALL[4, 0] = UNKNOWN
HALL[1:-1, 50:] = UNKNOWN
GAP, END = (1, 4), (49, 4)


def make_strategy(robot: int = 0, options: dict[str, Any] | None = None, grid: Grid = HALL) -> Repairmen:
    task: Settings = settings_for(grid, robot, 2, ranges_cells=[10.0, 10.0])
    return Repairmen(options or {}, task)


def robot_at(x: int, y: int, grid: Grid = HALL, **others: Any) -> Situation:
    return Situation(step=1, grid=grid, x=x, y=y, home=(x, y), **others)


def target(x: int, options: dict[str, Any] | None = None) -> Any:
    return make_strategy(0, options).decide(robot_at(x, 4)).target


def test_a_goal_of_large_gain_comes_first_unless_a_small_frontier_is_near() -> None:
    assert target(5) == GAP
    assert target(35) == END


@pytest.mark.parametrize(("small_frontier", "first"), [(0.0, END), (1.0, GAP)])
def test_the_weight_of_small_frontiers_decides_how_near(
    small_frontier: float, first: tuple[int, int]
) -> None:
    assert (
        target(
            15,
            {
                "small_frontier": small_frontier,
                "latency_weight": 0.0,
                "longest_tour": 0.0,
                "total_length": 0.0,
            },
        )
        == first
    )


def test_latency_longest_tour_and_total_length_pull_in_small_frontiers() -> None:
    alone = {"small_frontier": 0.01, "latency_weight": 0.0, "longest_tour": 0.0, "total_length": 0.0}
    assert target(12, alone) == END
    assert target(12, alone | {"latency_weight": 1.0}) == GAP
    assert target(12, alone | {"longest_tour": 5.0}) == GAP
    assert target(12, alone | {"total_length": 5.0}) == GAP


@pytest.mark.parametrize(("x", "first"), [(23, GAP), (27, END)])
def test_a_single_robot_drives_the_shortest_tour_whatever_the_gain(x: int, first: tuple[int, int]) -> None:
    robot = Repairmen({"small_frontier": 0.0}, settings_for(HALL, 0, 1, ranges_cells=[10.0]))
    assert robot.decide(robot_at(x, 4)).target == first
    assert target(23, {"small_frontier": 0.0, "longest_tour": 0.0, "total_length": 0.0}) == END


def both(situations: list[Situation]) -> list[Decision]:
    return [make_strategy(robot).decide(situation) for robot, situation in enumerate(situations)]


def test_two_robots_in_range_divide_the_goals() -> None:
    poses = [TeammatePose(20, 4, leads=False), TeammatePose(22, 4, leads=False)]
    found = both([
        robot_at(*poses[robot][:2], peers=(1 - robot,), poses={1 - robot: poses[1 - robot]})
        for robot in (0, 1)
    ])  # fmt: skip
    assert [each.target for each in found] == [GAP, END]


def test_a_teammate_out_of_range_is_assumed_at_its_target_for_some_time() -> None:
    away = robot_at(35, 4, targets={1: (45, 4)}, target_steps={1: 1})
    assert make_strategy().decide(away).target == GAP
    assert make_strategy().decide(replace(away, step=1 + RECALL)).target == GAP
    assert make_strategy().decide(replace(away, step=2 + RECALL)).target == END


# The hall with a wall instead of its unknown end: only the gap is left.
CLOSED: Grid = HALL.copy()
CLOSED[1:-1, 50] = OCCUPIED


@pytest.mark.parametrize(("resolution", "end"), [(0.1, 18), (0.5, 1)])
def test_a_frontier_as_wide_as_a_door_is_observed_from_afar_and_a_wider_one_from_nearby(
    resolution: float, end: int
) -> None:
    # Three cells are 0.3 or 1.5 m. A viewpoint is at most 0.9 of the sensor range, 18 cells, from the unknown cells.
    grid = CLOSED.copy()
    grid[3:6, 0] = UNKNOWN
    task = settings_for(grid, 0, 2, ranges_cells=[20.0, 20.0], speed_cells=60.0, resolution=resolution)
    decision = Repairmen({}, task).decide(robot_at(45, 4, grid))
    assert decision.target == GAP
    assert decision.path[-1].tolist() == [end, 4]


@pytest.mark.parametrize(("mission", "first"), [("open", GAP), ("return", None)])
def test_two_robots_that_leave_the_last_goal_to_each_other_both_drive_there(
    mission: str, first: tuple[int, int] | None
) -> None:
    # Each of them knows an old pose of the other one, nearer to the gap than its own.
    here, known = (20, 25), (15, 10)
    found = [
        make_strategy(robot, {"mission": mission}, CLOSED).decide(
            robot_at(
                here[robot],
                4,
                CLOSED,
                peers=(1 - robot,),
                poses={1 - robot: TeammatePose(known[1 - robot], 4, leads=False)},
            )
        )
        for robot in (0, 1)
    ]
    assert [each.target for each in found] == [first] * 2


def test_a_waiting_robot_takes_over_the_goal_of_a_teammate_that_stands_still() -> None:
    # Robot 1 is the nearer to the gap, but sees nothing to do. Robots that must return wait for their teammates.
    grid = CLOSED
    robot = make_strategy(0, {"mission": "return"}, grid)
    seen = [
        robot.decide(
            replace(
                robot_at(9, 4, grid),
                step=step,
                peers=(1,),
                poses={1: TeammatePose(5, 4, leads=False)},
                targets={1: (30, 4)},
                target_steps={1: 1},
                last_moved={1: 1},
            )
        ).target
        for step in range(1, STILL + 3)
    ]
    assert seen == [None] * STILL + [GAP] * 2


def test_a_robot_without_other_goals_takes_one_of_a_teammate_on_a_longer_way() -> None:
    # Two gaps in the upper wall, to the left and to the right of robot 0. Robot 1 is far away on the right.
    grid = np.full((9, 100), OCCUPIED, np.uint8)
    grid[1:-1, 1:-1] = FREE
    grid[0, 10] = grid[0, 40] = UNKNOWN
    poses = [TeammatePose(20, 4, leads=False), TeammatePose(74, 4, leads=False)]
    found = [
        make_strategy(robot, grid=grid)
        .decide(robot_at(*poses[robot][:2], grid, peers=(1 - robot,), poses={1 - robot: poses[1 - robot]}))
        .target
        for robot in (0, 1)
    ]
    assert found == [(10, 1), (40, 1)]


@pytest.mark.parametrize("radius_cells", [0.0, 1.2])
def test_a_large_robot_without_a_tour_follows_its_teammate_to_a_goal_that_it_reaches(
    radius_cells: float,
) -> None:
    # Robot 1 will visit two halls. Robot 0 is too large for the door to the lower one, a cell wide.
    grid = np.full((17, 60), OCCUPIED, np.uint8)
    grid[1:8, 1:50] = grid[9:16, 41:50] = grid[8, 47] = FREE
    grid[1:8, 50:] = grid[9:16, 50:] = UNKNOWN
    task = settings_for(grid, 0, 2, ranges_cells=[10.0, 10.0], radii_cells=[radius_cells, 0.0])
    here = robot_at(25, 4, grid, peers=(1,), poses={1: TeammatePose(45, 4, leads=False)})
    assert Repairmen({}, task).decide(here).target == ((49, 4) if radius_cells else (49, 12))


@pytest.mark.parametrize("width", [3, 7])
def test_a_robot_without_a_tour_follows_its_teammate_also_in_a_narrow_corridor(width: int) -> None:
    grid = np.full((width + 2, 60), OCCUPIED, np.uint8)
    grid[1:-1, 1:50] = FREE
    grid[1:-1, 50:] = UNKNOWN
    middle = (width + 1) // 2
    here = robot_at(20, middle, grid, peers=(1,), poses={1: TeammatePose(30, middle, leads=False)})
    assert make_strategy(grid=grid).decide(here).target == (49, middle)


@pytest.mark.parametrize(("work", "first"), [(0.0, GAP), (3.0, (32, 1))])
def test_a_robot_with_much_expected_work_gets_fewer_other_goals(work: float, first: tuple[int, int]) -> None:
    # A small frontier is a short detour on robot 1's way to the end, a longer one on robot 0's way to the gap.
    grid = HALL.copy()
    grid[0, 32] = UNKNOWN
    here = robot_at(28, 4, grid, peers=(1,), poses={1: TeammatePose(31, 7, leads=False)})
    assert (
        make_strategy(grid=grid, options={"expected_work": work, "total_length": 0.0}).decide(here).target
        == first
    )


def test_repairmen_replans_after_every_map_change_by_default() -> None:
    opened = HALL.copy()
    opened[4, 0] = OCCUPIED
    opened[0, 12] = UNKNOWN
    for options, expected in (({}, (12, 1)), ({"replan": "at-goal"}, GAP)):
        robot = make_strategy(options=options)
        assert robot.decide(robot_at(5, 4)).target == GAP
        assert robot.decide(replace(robot_at(5, 4, opened), step=2)).target == expected


def test_close_small_frontiers_are_one_goal_unless_a_wall_is_between() -> None:
    for wall, goals in ((FREE, 2), (OCCUPIED, 3)):
        grid = HALL.copy()
        grid[0, 20] = grid[0, 24] = UNKNOWN
        grid[1:-2, 22] = wall
        grid[1:-1, 50:] = OCCUPIED
        robot, situation = make_strategy(grid=grid), robot_at(22, 7, grid)
        robot.settings = settings_for(grid, 0, 2, ranges_cells=[50.0, 50.0])
        assert len(robot.goals(situation, PathPlanner(grid))) == goals


@pytest.mark.parametrize(("team", "goals"), [(1, 5), (5, 5), (8, 8), (12, 11)])
def test_an_open_field_has_as_many_goals_as_robots_unless_they_would_be_too_close(
    team: int, goals: int
) -> None:
    # 80 frontier cells around a square are goals of at most 7.5 cells if there are 11 of them.
    grid = np.full((41, 41), UNKNOWN, np.uint8)
    grid[10:31, 10:31] = FREE
    poses = {robot: TeammatePose(20, 20, leads=False) for robot in range(1, team)}
    robot = Repairmen({}, settings_for(grid, 0, team, ranges_cells=[10.0] * team))
    situation = robot_at(20, 20, grid, peers=tuple(poses), poses=poses)
    assert len(robot.goals(situation, PathPlanner(grid))) == goals


@pytest.mark.parametrize("gap", [[], [(24, 5), (24, 6), (24, 7)]])
def test_a_robot_drives_straight_to_a_target_that_it_reaches_on_a_free_line(
    gap: list[tuple[int, int]],
) -> None:
    # The way goes 45 cells to the right and 25 down, to the middle of a frontier segment.
    grid = np.full((60, 60), OCCUPIED, np.uint8)
    grid[1:-1, 1:51] = FREE
    grid[27:34, 51] = UNKNOWN
    grid[1:-1, 24] = OCCUPIED if gap else FREE
    for x, y in gap:
        grid[y, x] = FREE
    decision = make_strategy(grid=grid).decide(robot_at(5, 5, grid))
    assert decision.target == (50, 30)
    off = [abs(25 * (x - 5) - 45 * (y - 5)) / 45 for x, y in decision.path.tolist()]
    assert (max(off) <= 0.5) == (not gap)


@pytest.mark.parametrize("obstacle", ["robot", "person"])
def test_a_robot_that_drives_around_a_teammate_or_a_person_does_not_turn_back(obstacle: str) -> None:
    robot = make_strategy()
    straight = robot.decide(robot_at(35, 4)).path[0].tolist()
    for step in (2, 3):
        around = robot.decide(replace(robot_at(35, 4, blocked=obstacle), step=step)).path
    assert around[0].tolist() != straight
    x, y = around[0].tolist()
    later = robot.decide(replace(robot_at(x, y), step=4))
    assert later.path[: len(around) - 1].tolist() == around[1:].tolist()


def test_target_hysteresis_prevents_turns_for_small_gains_or_without_map_changes() -> None:
    # Two gaps in the walls above and below, at the same way from the middle but for a cell.
    grid = HALL.copy()
    grid[4, 0] = OCCUPIED
    grid[1:-1, 50:] = OCCUPIED
    grid[0, 0] = grid[0, 10] = grid[0, 31] = UNKNOWN
    news = grid.copy()
    news[0, 0] = OCCUPIED
    for target_hysteresis, later, expected in (
        (0.0, news, (10, 1)),
        (0.5, news, (31, 1)),
        (0.0, grid, (31, 1)),
    ):
        robot = make_strategy(options={"target_hysteresis": target_hysteresis}, grid=grid)
        assert robot.decide(robot_at(22, 1, grid)).target == (31, 1)
        assert robot.decide(replace(robot_at(20, 1, later), step=2)).target == expected


def ends(robot: Repairmen, situation: Situation) -> tuple[int, int]:
    x, y = robot.decide(situation).path[-1].tolist()
    return x, y


def test_small_frontiers_are_observed_from_viewpoints_unless_an_earlier_scan_showed_nothing_new() -> None:
    # A hall with a nook of unknown depth in its upper wall.
    grid = np.full((12, 30), OCCUPIED, np.uint8)
    grid[6:-1, 1:-1] = FREE
    grid[2:6, 20] = FREE
    grid[1, 20] = UNKNOWN
    alone = settings_for(grid, 0, 1, ranges_cells=[12.0], speed_cells=40.0)
    here = robot_at(10, 9, grid)
    robot = Repairmen({}, alone)
    decided = robot.decide(here)
    x, y = decided.path[-1].tolist()
    assert decided.target == (20, 2)
    assert (x, y) in {(19, 9), (20, 9)}
    assert ends(Repairmen({"viewpoint_range": 0.0}, alone), here) == (20, 2)
    narrow = settings_for(grid, 0, 1, ranges_cells=[12.0], speed_cells=40.0, field_of_view=90.0)
    assert ends(Repairmen({}, narrow), here) == (20, 2)
    # A teammate blocked the view, so the scan changed no cell: the robot drives in, whatever it sees on the way.
    assert ends(robot, replace(robot_at(x, y, grid), step=2)) == (20, 2)
    grid[9, 1] = OCCUPIED
    assert ends(robot, replace(robot_at(x - 2, y, grid), step=3)) == (20, 2)
    # A wide nook is no small frontier.
    grid[7:10, 20:24] = OCCUPIED
    grid[1, 20:24] = UNKNOWN
    grid[2:7, 20:24] = FREE
    assert ends(Repairmen({}, alone), here) in {(21, 2), (22, 2)}
