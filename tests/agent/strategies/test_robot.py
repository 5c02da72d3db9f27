"""What of a strategy's work travels: poses, targets, and news that wait for a target."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pytest

from agent.announcements import REPEAT_POSE
from agent.robot import SURE_AFTER, Robot
from agent.strategies.base import Decision, Pose, Situation, Strategy
from protocol import packets
from protocol.grid import ray_table
from protocol.messages import Delivery, RoundReport, SendReport, Sense
from protocol.scans import NONE
from tests.agent.planning.planning_references import drawn, settings_for

GRID = drawn(*["." * 30] * 30)


def robot(strategy: str, number: int = 0, **others: Any) -> Robot:
    return Robot(settings_for(GRID, robot=number, strategy=strategy, map_encoding="scans", **others))


def sense(step: int, x: int = 10, y: int = 10, *, look: bool = True) -> Sense:
    lengths = np.diff(ray_table(5.0, 360).start).astype(np.uint16)
    readings = lengths if look else np.full(360, NONE, np.uint16)
    return Sense(step, x, y, 0, b"", readings.tobytes(), "")


def carried(step: int) -> RoundReport:
    return RoundReport(step, 0, [], [], [], True)


def said(mind: Robot, peers: list[int]) -> list[str]:
    frame = mind.announce(peers)
    return [] if frame is None else [packet.name for packet in packets.decode(frame)]


def test_only_team_strategies_publish_poses() -> None:
    for strategy, expected in (("burgard", ["pose"]), ("leaders", ["pose"]), ("meier", []), ("nearest", [])):
        mind = robot(strategy)
        mind.perceive(sense(1))
        assert said(mind, [1]) == expected


def test_a_received_pose_is_repeated_after_a_while_or_for_a_new_peer() -> None:
    mind = robot("burgard", robots=3)
    told = []
    for step in range(1, REPEAT_POSE + 2):
        mind.perceive(sense(step))
        told.append("pose" in said(mind, [1]))
        if told[-1]:
            mind.close_round(carried(step))
    assert told == [True] + [False] * (REPEAT_POSE - 1) + [True]
    mind.perceive(sense(20))
    assert said(mind, [1, 2]) == ["pose"]


def test_a_pose_that_was_not_transmitted_is_sent_again() -> None:
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
    other.receive_broadcast(0, frame)
    assert not other.faults


def test_a_pose_contains_whether_the_robot_leads() -> None:
    for number, leads in ((0, 1), (1, 0)):
        mind = robot("leaders", number)
        mind.perceive(sense(1))
        frame = mind.announce([1 - number])
        assert frame is not None
        (pose,) = packets.decode(frame)
        assert pose == packets.Pose(10, 10, leads)


class Witness(Strategy):
    """Remembers the last situation that it was given."""

    name = "witness"
    summary = "stays, and remembers what it was told"
    source = "an example"
    publishes_pose = True
    told: ClassVar[Situation]

    def decide(self, situation: Situation) -> Decision:
        Witness.told = situation
        return Decision()


def test_a_depot_is_the_first_received_pose_and_distances_add_up_from_pose_to_pose() -> None:
    mind = robot(f"{__name__}:Witness")
    for step, x, heard in ((1, 10, (3, 4)), (2, 13, (6, 8)), (3, 13, (6, 10))):
        mind.perceive(sense(step, x))
        mind.announce([1])
        mind.receive_broadcast(1, packets.encode([packets.Pose(*heard, 0)]))
        mind.decide()
    told = Witness.told
    assert told.homes == {0: (10, 10), 1: (3, 4)}
    assert told.home == (10, 10)
    assert told.poses == {1: Pose(6, 10, leads=False)}
    assert told.traveled == {0: 3.0, 1: 5.0 + 2.0}


def test_a_malformed_broadcast_is_a_fault_and_nothing_more() -> None:
    mind = robot("burgard")
    for frame in (packets.encode([packets.Pose(500, 3, 0)]), packets.encode([packets.Save()]), b"\xff"):
        mind.receive_broadcast(1, frame)
    assert len(mind.faults) == 3
    mind.perceive(sense(1))
    mind.decide()


def test_map_changes_wait_for_a_new_target_if_the_strategy_defers_them() -> None:
    mind = robot("scan-replan")
    mind.perceive(sense(1))
    mind.decide()
    first = len(mind.replication.logs[0])
    assert first > 0
    mind.perceive(sense(2, 11))
    mind.decide()
    assert len(mind.replication.logs[0]) == first
    assert mind.target is not None
    mind.perceive(sense(3, *mind.target))
    mind.decide()
    assert len(mind.replication.logs[0]) > first


def test_a_resting_scanner_logs_nothing() -> None:
    mind = robot("classical")
    mind.perceive(sense(1))
    mind.decide()
    before = len(mind.replication.logs[0])
    mind.perceive(sense(2, 11, look=False))
    mind.decide()
    assert len(mind.replication.logs[0]) == before


@pytest.mark.parametrize(
    ("robots", "map_encoding", "first"),
    [(2, "scans", 1), (2, "polygons", 1 + SURE_AFTER), (1, "polygons", 1)],
)
def test_with_inferred_cells_a_robot_is_done_only_after_some_steps(
    robots: int, map_encoding: str, first: int
) -> None:
    mind = Robot(
        settings_for(drawn(*["." * 5] * 5), robots=robots, map_encoding=map_encoding, strategy="meier")
    )
    explored = []
    for step in range(1, SURE_AFTER + 3):
        mind.perceive(sense(step, 2, 2))
        explored.append(mind.decide().explored)
    assert explored.index(True) + 1 == first
    assert all(explored[first - 1 :])


def test_entries_that_a_teammate_claims_to_build_on_but_nobody_received_do_no_harm() -> None:
    """A forger guesses the entries that the victim has not sent yet; its own entries depend on them."""
    victim, forger = (
        Robot(
            settings_for(
                GRID, robot=number, map_encoding="predictive", strategy="meier", dissemination="gossip"
            )
        )
        for number in (0, 1)
    )
    victim.perceive(sense(1))
    forger.perceive(sense(1))
    for each, peer in ((victim, 1), (forger, 0)):
        each.replication.open_round(0, [peer], None)
        each.close_round(RoundReport(1, 0, [], [], [], False))
        each.decide()
    victim.perceive(sense(2, 12))
    (unsent,) = victim.replication.open_round(0, [1], None)
    forger.replication.open_round(0, [0], None)
    forger.close_round(RoundReport(2, 0, [], [], [Delivery(0, unsent.payload)], False))
    forger.decide()
    forger.perceive(sense(3, 14))
    (forged,) = forger.replication.open_round(0, [0], None)
    assert len(forger.replication.logs[0])
    victim.close_round(RoundReport(2, 0, [], [SendReport(0, 0)], [Delivery(1, forged.payload)], False))
    for step in range(3, 6):
        victim.decide()
        victim.perceive(sense(step, 12 + step))
        (frame,) = victim.replication.open_round(0, [1], None)
        victim.close_round(RoundReport(step, 0, [], [SendReport(0, len(frame.payload))], [], False))
    assert not victim.faults
    victim.decide()
    assert (victim.planning == victim.own)[victim.own != 0].all()
