"""Decisions of leaders and troopers, worked out by hand on small maps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agent.planning.route import crossed
from agent.strategies.base import TeammatePose
from agent.strategies.leaders import STALL_STEPS, elect
from protocol.grid import FREE, UNKNOWN
from tests.agent.planning.planning_references import drawn
from tests.agent.strategies.deciding import CORRIDOR, decide, make_strategy, robot_at

BEHIND_A_WALL = drawn(
    "..........",
    "..........",
    "#######...",
    "..........",
    "?.........",
)
"""The only unknown cell is behind a wall."""


def test_leaders_are_elected_over_a_scripted_sequence_of_meetings() -> None:
    # Robot 2 of a team in which robot 0 leads throughout: (leaders that it senses, whether it leads then).
    script: list[tuple[list[int], bool]] = [
        ([0], False),  # beside the first leader
        ([], True),  # has lost it
        ([], True),  # still alone
        ([3], True),  # meets a leader lower in the hierarchy: that one steps down
        ([1], False),  # meets a higher one
        ([1], False),
        ([], True),  # the higher one is out of range, or has failed
        ([0, 3], False),  # meets two
    ]
    leads = False
    for sensed, expected in script:
        leads = elect(2, leads, sensed, first=1)
        assert leads == expected
    assert elect(0, True, [1, 2], first=1)
    assert not elect(2, False, [], first=1, dynamic=False)


def test_a_leader_is_sensed_within_rho_lead_and_radio_range() -> None:
    # Cells of a meter, and rho_lead is 4 m: robot 1 becomes a leader itself if it senses none.
    def leads(x: int, *, leading: bool = True, in_range: bool = True) -> bool:
        trooper = make_strategy("leaders", robot=1, resolution=1.0)
        near = {0: TeammatePose(x, 1, leads=leading)}
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
        beside = robot_at(20, 20, grid=grid, peers=peers, poses={0: TeammatePose(14, 20, leads=False)})
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
        poses = {0: TeammatePose(column, 20, leads=False)}
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
    grid = BEHIND_A_WALL
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


def test_a_robot_without_progress_is_stalled() -> None:
    swarm = make_strategy("potential-field", {}, resolution=0.1)
    # Between two frontier points at the same distance, in a closed corridor.
    stalled = [swarm.decide(replace(robot_at(7), step=step)).stalled for step in range(1, 70)]
    assert stalled.index(True) == 60


def test_a_robot_that_is_too_large_for_what_is_left_stalls_like_its_teammates() -> None:
    # The run of a large robot and of a small one, which is stalled, ends only if both are.
    known = np.full_like(CORRIDOR, FREE)
    for name in ("leaders", "potential-field"):
        swarm = make_strategy(name, {}, known, resolution=0.1)
        found = [swarm.decide(replace(robot_at(7, grid=known), step=step)) for step in range(1, 70)]
        assert all(decision.explored for decision in found)
        assert [decision.stalled for decision in found].index(True) == 60


def test_a_trooper_escapes_from_a_local_minimum_until_it_has_observed_the_frontier() -> None:
    grid = BEHIND_A_WALL
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
    # A hundredth of a meter a step, in cells of 0.1 m: in 60 steps it does not get away a meter.
    leader = make_strategy("leaders", {}, resolution=0.1, speed_cells=0.1)
    driven = [divmod(100 * step + 500, 1000) for step in range(1, 140)]
    steps = [
        replace(robot_at(13 - cells), step=step, offset=(500 - rest, 0))
        for step, (cells, rest) in enumerate(driven, start=1)
        if cells < 13
    ]
    assert len(steps) > 2 * STALL_STEPS
    assert not any(leader.decide(situation).stalled for situation in steps)
