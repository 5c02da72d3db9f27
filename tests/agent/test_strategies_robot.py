"""What of a strategy's work travels: poses, targets, and news that wait for a target."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agent.robot import REPEAT_POSE, SURE_AFTER, Robot
from protocol import packets
from protocol.grid import fan
from protocol.messages import Outcome, Sense
from protocol.scans import NONE
from tests.agent.planning_references import drawn, settings_for

GRID = drawn(*["." * 30] * 30)


def robot(strategy: str, number: int = 0, **others: Any) -> Robot:
    return Robot(settings_for(GRID, robot=number, strategy=strategy, exchange="laser", **others))


def sense(step: int, x: int = 10, y: int = 10, *, look: bool = True) -> Sense:
    lengths = np.diff(fan(5.0, 360).start).astype(np.uint16)
    readings = lengths if look else np.full(360, NONE, np.uint16)
    return Sense(step, x, y, 0, b"", readings.tobytes(), "")


def carried(step: int) -> Outcome:
    return Outcome(step, 0, [], [], [], [], [], True)


def said(mind: Robot, peers: list[int]) -> list[str]:
    frame = mind.announce(peers)
    return [] if frame is None else [packet.name for packet in packets.decode(frame)]


def test_only_robots_that_assign_together_tell_their_poses() -> None:
    for strategy, expected in (("burgard", ["pose"]), ("leaders", ["pose"]), ("meier", []), ("nearest", [])):
        mind = robot(strategy)
        mind.perceive(sense(1))
        assert said(mind, [1]) == expected


def test_a_pose_that_all_have_heard_is_repeated_only_after_a_while_or_for_a_newcomer() -> None:
    mind = robot("burgard", robots=3)
    told = []
    for step in range(1, REPEAT_POSE + 2):
        mind.perceive(sense(step))
        told.append("pose" in said(mind, [1]))
        if told[-1]:
            mind.settle(carried(step), [])
    assert told == [True] + [False] * (REPEAT_POSE - 1) + [True]
    mind.perceive(sense(20))
    assert said(mind, [1, 2]) == ["pose"]


def test_a_pose_that_was_not_carried_is_said_again() -> None:
    mind = robot("burgard")
    mind.perceive(sense(1))
    assert said(mind, [1]) == ["pose"]
    mind.perceive(sense(2))
    assert said(mind, [1]) == ["pose"]


def test_a_pose_and_a_target_go_in_one_broadcast_and_are_understood() -> None:
    one, other = robot("burgard"), robot("burgard", 1)
    one.perceive(sense(1))
    one.decide()
    one.perceive(sense(2))
    frame = one.announce([1])
    assert frame is not None
    assert [packet.name for packet in packets.decode(frame)] == ["pose", "targ"]
    assert len(frame) == 7
    other.hear_broadcast(0, frame)
    assert not other.faults


def test_a_broadcast_that_makes_no_sense_is_a_fault_and_nothing_more() -> None:
    mind = robot("burgard")
    for frame in (packets.encode([packets.Pose(500, 3, 0)]), packets.encode([packets.Save()]), b"\xff"):
        mind.hear_broadcast(1, frame)
    assert len(mind.faults) == 3
    mind.perceive(sense(1))
    mind.decide()


def test_news_wait_until_the_target_is_replaced_where_the_strategy_says_so() -> None:
    mind = robot("scan-replan")
    mind.perceive(sense(1))
    mind.decide()
    first = len(mind.session.logs[0])
    assert first > 0
    mind.perceive(sense(2, 11))
    mind.decide()
    assert len(mind.session.logs[0]) == first
    assert mind.target is not None
    mind.perceive(sense(3, *mind.target))
    mind.decide()
    assert len(mind.session.logs[0]) > first


def test_a_scanner_that_rests_has_nothing_to_tell() -> None:
    mind = robot("classical")
    mind.perceive(sense(1))
    mind.decide()
    before = len(mind.session.logs[0])
    mind.perceive(sense(2, 11, look=False))
    mind.decide()
    assert len(mind.session.logs[0]) == before


@pytest.mark.parametrize(
    ("robots", "exchange", "first"), [(2, "laser", 1), (2, "polygon", 1 + SURE_AFTER), (1, "polygon", 1)]
)
def test_on_a_map_that_holds_guesses_nothing_must_be_left_for_a_while(
    robots: int, exchange: str, first: int
) -> None:
    mind = Robot(settings_for(drawn(*["." * 5] * 5), robots=robots, exchange=exchange, strategy="meier"))
    explored = []
    for step in range(1, SURE_AFTER + 3):
        mind.perceive(sense(step, 2, 2))
        explored.append(mind.decide().explored)
    assert explored.index(True) + 1 == first
    assert all(explored[first - 1 :])
