"""Simulated robots that ROS drives: goals, velocities, collisions, poses, scans, and own maps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import maximum_filter

from deploy.serve.navigator import MOST_RECOVERIES, POSITION_M, WAIT_S, Outcome
from deploy.serve.robot import COMMAND_NS, SimulatedRobot
from deploy.serve.swarm import LATEST, Swarm
from protocol.grid import FREE, OCCUPIED, UNKNOWN
from protocol.range_scans import NO_MEASUREMENT, NOTHING, TURN
from protocol.transforms import Pose
from tests.deploy.serve.small_house import (
    CELL,
    CLOSED_ROOM,
    FIRST_ROOM,
    SECOND_ROOM,
    STEP_NS,
    corridor_plan,
    goal_at,
    house,
    house_plan,
    run,
    swarm,
)
from worldsim.velocity_world import Velocity

NOISY: dict[str, Any] = {"laser": {"preset": "rplidar-a1"}, "pose": {"preset": "particle-filter"}}

EDGE = 10
"""Cells around the house in which noise may put walls."""


@pytest.mark.parametrize("settings", [{}, NOISY], ids=["exact", "noisy"])
def test_a_robot_drives_through_a_door_to_its_goal_and_turns_as_the_goal_says(
    settings: dict[str, Any],
) -> None:
    team = swarm(FIRST_ROOM, **settings)
    robot = team.robots[0]
    goal = goal_at(robot, SECOND_ROOM, 2.0)
    task = robot.go(goal, 0)
    while task.outcome is None:
        run(team, 0.1)
    assert task.outcome is Outcome.REACHED
    assert team.time_ns < 15 * 10**9
    assert math.dist(robot.pose[:2], goal[:2]) <= 2 * POSITION_M, "by its own belief"
    assert abs(math.remainder(robot.pose.yaw - goal.yaw, math.tau)) < 0.1
    assert math.dist(robot.true[:2], SECOND_ROOM) < 0.3
    assert robot.velocity == (0.0, 0.0)


def test_a_robot_leaves_the_corner_of_a_cell_beside_a_wall() -> None:
    robots = swarm(FIRST_ROOM, speed=1.0)
    for place in ((1.0, 1.9), (1.7, 0.7), (1.0, 1.9), (3.3, 1.6), (0.6, 0.6)):
        task = robots.robots[0].go(goal_at(robots.robots[0], place), robots.now_ns)
        run(robots, 25)
        assert task.outcome is Outcome.REACHED


def test_the_goal_of_a_closed_room_is_unreachable() -> None:
    team = swarm(FIRST_ROOM)
    robot = team.robots[0]
    task = robot.go(goal_at(robot, CLOSED_ROOM), 0)
    assert task.outcome is Outcome.UNREACHABLE
    run(team, 1)
    assert robot.true[:2] == robot.start[:2]
    for outside in ((-3.0, 1.0), (1.0, 99.0)):
        assert robot.go(goal_at(robot, outside), 0).outcome is Outcome.UNREACHABLE


def test_a_goal_in_a_wall_is_reached_beside_it() -> None:
    team = swarm(FIRST_ROOM)
    robot = team.robots[0]
    task = robot.go(goal_at(robot, (1.5, 0.05)), 0)
    run(team, 15)
    assert task.outcome is Outcome.REACHED
    assert 0.3 <= robot.true.y < 0.5


def test_a_new_goal_replaces_the_last_one_and_a_canceled_one_ends() -> None:
    team = swarm(FIRST_ROOM)
    robot = team.robots[0]
    first = robot.go(goal_at(robot, SECOND_ROOM), 0)
    second = robot.go(goal_at(robot, (2.5, 3.0)), 0)
    assert first.outcome is Outcome.REPLACED
    run(team, 1)
    robot.cancel(second)
    run(team, 1)
    here = robot.true
    run(team, 1)
    assert (second.outcome, robot.true) == (Outcome.CANCELED, here)


def test_a_velocity_holds_for_half_a_second_and_is_limited() -> None:
    team = swarm(FIRST_ROOM, speed=0.5)
    robot = team.robots[0]
    robot.command(Velocity(9.0, 0.0), 0)
    run(team, 3)
    driven = robot.true.x - robot.start.x
    assert driven == pytest.approx(0.5 * (COMMAND_NS - STEP_NS) / 10**9, abs=0.01)
    robot.command(Velocity(0.0, 1.0), team.now_ns)
    run(team, 0.2)
    assert robot.true.yaw == pytest.approx(0.2)
    with pytest.raises(ValueError, match="not a number"):
        robot.command(Velocity(math.nan, 0.0), team.now_ns)


def test_a_velocity_comes_before_the_goal() -> None:
    team = swarm(FIRST_ROOM)
    robot = team.robots[0]
    task = robot.go(goal_at(robot, (2.5, 2.0)), 0)
    robot.command(Velocity(-0.2, 0.0), 0)
    run(team, 0.4)
    assert robot.true.x < robot.start.x
    run(team, 10)
    assert task.outcome is Outcome.REACHED


def test_a_robot_stops_before_a_wall_whatever_the_velocity() -> None:
    team = swarm(FIRST_ROOM)
    robot = team.robots[0]
    for turn in (0.0, 0.7, -1.3):
        for _ in range(60):
            robot.command(Velocity(0.5, turn), team.now_ns)
            run(team, 0.1)
            assert team.world.floors[0][team.world.cell(0)[::-1]] == FREE


def test_robots_do_not_drive_into_each_other() -> None:
    team = swarm((1.0, 2.0), (2.5, 2.0))
    first, second = team.robots
    nearest = math.inf
    for _ in range(60):
        first.command(Velocity(0.5, 0.0), team.now_ns)
        run(team, 0.1)
        nearest = min(nearest, math.dist(first.true[:2], second.true[:2]))
    assert first.blocked == "robot"
    assert 0.4 - CELL <= nearest < 0.4 + CELL, "two radii, up to a cell"


def test_a_robot_drives_around_one_in_its_way() -> None:
    team = swarm((0.5, 2.0), (1.5, 2.0))
    robot = team.robots[0]
    task = robot.go(goal_at(robot, (2.5, 2.0)), 0)
    run(team, 20)
    assert task.outcome is Outcome.REACHED
    assert robot.navigator.recoveries >= 1


@pytest.mark.parametrize(("first", "second"), [(1.3, 4.5), (4.5, 1.3)])
def test_robots_that_meet_in_a_door_pass_one_after_the_other(first: float, second: float) -> None:
    team = swarm((first, 1.3), (second, 1.3))
    one, other = team.robots
    tasks = [one.go(goal_at(one, (second, 1.0)), 0), other.go(goal_at(other, (first, 1.6)), 0)]
    run(team, 40)
    assert [task.outcome for task in tasks] == [Outcome.REACHED, Outcome.REACHED]


@pytest.mark.parametrize(("room", "end_m"), [(18, 5.9), (0, 4.7)], ids=["two rooms", "dead end"])
@pytest.mark.parametrize("swapped", [False, True])
def test_robots_that_meet_in_a_corridor_back_off_to_a_room(room: int, end_m: float, swapped: bool) -> None:
    """Before a dead end, only the robot on the side of the room can back off, whatever its number."""
    places = [(1.0, 1.2), (end_m, 1.2)]
    starts = places[::-1] if swapped else places
    team = Swarm(corridor_plan(30, room, *starts), 0)
    tasks = [
        robot.go(goal_at(robot, place), 0) for robot, place in zip(team.robots, starts[::-1], strict=True)
    ]
    run(team, 90)
    assert [task.outcome for task in tasks] == [Outcome.REACHED, Outcome.REACHED]


def test_a_robot_before_a_blocked_door_gives_up() -> None:
    team = swarm((1.5, 1.3), (3.0, 1.3))
    robot = team.robots[0]
    task = robot.go(goal_at(robot, SECOND_ROOM), 0)
    run(team, 5)
    assert task.outcome is None
    run(team, WAIT_S * (MOST_RECOVERIES + 2))
    assert task.outcome is Outcome.STUCK


def test_a_goal_that_is_sent_again_and_again_does_not_keep_a_robot_from_planning_anew() -> None:
    team = swarm((0.5, 2.0), (1.5, 2.0))
    robot = team.robots[0]
    for _ in range(40):
        task = robot.go(goal_at(robot, (2.5, 2.0)), team.now_ns)
        run(team, 0.5)
    assert task.outcome is Outcome.REACHED


def test_beams_of_an_exact_laser_end_in_walls_of_the_true_map() -> None:
    team = swarm(FIRST_ROOM, robots=1)
    robot = team.robots[0]
    robot.command(Velocity(0.5, 1.9), 0)
    run(team, 0.5)
    laser, frame = robot.laser, team.world.frame
    place = robot.true.then(robot.laser_pose)
    assert robot.true.yaw > 0.5
    angles = place.yaw - laser.angles * math.tau / TURN
    measured = (robot.ranges != NOTHING) & (robot.ranges != NO_MEASUREMENT)
    assert measured.sum() > 300

    def states(share: float) -> np.ndarray:
        meters = robot.ranges[measured] / 1000 * share
        x, y = place.x + meters * np.cos(angles[measured]), place.y + meters * np.sin(angles[measured])
        columns, rows = (x - frame.x) / CELL, frame.height - (y - frame.y) / CELL
        return house()[np.floor(rows).astype(int), np.floor(columns).astype(int)]

    assert np.mean(states(1.0) == OCCUPIED) > 0.98  # some beams only touch the corner of a cell
    assert (states(0.7) == FREE).all()


def test_lasers_filter_other_robots_out_unless_they_should_see_them() -> None:
    for sees_robots, expected in ((False, NO_MEASUREMENT), (True, 1200)):
        team = Swarm(house_plan((1.05, 2.05), (2.55, 2.05)), 0, sees_robots=sees_robots)
        ahead = team.robots[0].ranges[len(team.robots[0].ranges) // 2]
        assert ahead == pytest.approx(
            expected, abs=15
        )  # from 0.1 m ahead of one center to 0.2 m before the other


def wall_cells(robot: SimulatedRobot) -> tuple[np.ndarray, np.ndarray]:
    """The cells of the true map in which the walls of a robot's own map lie, through its start pose."""
    grid, where = robot.own_map()
    rows, columns = np.nonzero(grid == OCCUPIED)
    points = [where.position(column + 0.5, row + 0.5) for column, row in zip(columns, rows, strict=True)]
    common = [robot.start.then(Pose(x, y, 0.0)) for x, y in points]
    x, y = np.array([pose[:2] for pose in common]).T
    return np.floor(42 - y / CELL).astype(int), np.floor(x / CELL).astype(int)


@pytest.mark.parametrize(("settings", "off"), [({}, 0), (NOISY, 2)], ids=["exact", "noisy"])
def test_walls_of_a_robots_own_map_are_those_of_the_house(settings: dict[str, Any], off: int) -> None:
    team = swarm((0.8, 2.0), (2.0, 3.0), **settings)
    first, second = team.robots
    assert second.start.yaw == pytest.approx(math.pi / 2)
    for robot in (first, second):
        robot.go(goal_at(robot, SECOND_ROOM), 0)
    run(team, 15)
    near = maximum_filter(np.pad(house() == OCCUPIED, EDGE), 2 * off + 1)
    for robot in (first, second):
        rows, columns = wall_cells(robot)
        assert len(rows) > 150
        assert np.mean(near[rows + EDGE, columns + EDGE]) > 0.97


def test_a_robots_own_map_contains_what_it_has_seen_only() -> None:
    team = swarm((0.8, 3.5))
    grid, _ = team.robots[0].own_map()
    assert 200 < np.count_nonzero(grid != UNKNOWN) < 0.6 * house().size
    before = team.world.coverage
    team.robots[0].go(goal_at(team.robots[0], SECOND_ROOM), 0)
    run(team, 25)
    assert before < 0.7
    assert team.world.coverage > 0.98


def test_equal_goals_at_equal_times_have_equal_results() -> None:
    def drive() -> list[Any]:
        team = swarm((0.8, 2.0), (2.0, 3.0), people={"number": 2}, **NOISY)
        for robot in team.robots:
            robot.go(goal_at(robot, SECOND_ROOM), 0)
        run(team, 6)
        return [
            (robot.true, robot.pose, robot.localization.odometry, robot.ranges.tolist())
            for robot in team.robots
        ]

    assert drive() == drive()


def test_a_simulation_that_is_late_catches_up_a_second_at_most() -> None:
    team = swarm(FIRST_ROOM)
    assert team.advance(STEP_NS - 1) == 0
    assert team.advance(3 * STEP_NS) == 3
    assert team.advance(60 * STEP_NS) == LATEST
    assert team.now_ns == 60 * STEP_NS
    assert team.time_ns == (3 + LATEST) * STEP_NS
