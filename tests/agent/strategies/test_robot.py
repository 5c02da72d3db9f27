"""Messages that a robot sends for its strategy: poses, targets, and deferred map changes."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pytest
from msgspec.structs import replace

from agent.announcements import REPEAT_POSE
from agent.completion import SURE_AFTER, SURE_AFTER_NOISE, SURE_AFTER_NOISE_IN_TEAM, sure_after
from agent.robot import Robot
from agent.strategies.base import Decision, Situation, Strategy, TeammatePose
from protocol import packet_codec, packets
from protocol.grid import ray_table
from protocol.messages import Delivery, RoundReport, SendReport, Sense
from protocol.range_scans import TURN, Laser
from protocol.scans import NONE
from tests.agent.planning.planning_references import drawn, settings_for

GRID = drawn(*["." * 30] * 30)


def make_robot(strategy: str, number: int = 0, **others: Any) -> Robot:
    return Robot(settings_for(GRID, robot=number, strategy=strategy, map_encoding="scans", **others))


def sense(step: int, x: int = 10, y: int = 10, *, look: bool = True) -> Sense:
    lengths = np.diff(ray_table(5.0, 360).start).astype(np.uint16)
    readings = lengths if look else np.full(360, NONE, np.uint16)
    return Sense(step, x, y, 0, b"", readings.tobytes(), "")


def carried(step: int) -> RoundReport:
    return RoundReport(step, 0, [], [], [], True)


def announced(robot: Robot, peers: list[int]) -> list[str]:
    frame = robot.announce(peers)
    return [] if frame is None else [packet.name for packet in packet_codec.decode(frame)]


def test_only_team_strategies_publish_poses() -> None:
    for strategy, expected in (("burgard", ["pose"]), ("leaders", ["pose"]), ("meier", []), ("nearest", [])):
        robot = make_robot(strategy)
        robot.perceive(sense(1))
        assert announced(robot, [1]) == expected


def test_a_received_pose_is_repeated_after_a_while_or_for_a_new_peer() -> None:
    robot = make_robot("burgard", robots=3)
    sent = []
    for step in range(1, REPEAT_POSE + 2):
        robot.perceive(sense(step))
        sent.append("pose" in announced(robot, [1]))
        if sent[-1]:
            robot.close_round(carried(step))
    assert sent == [True] + [False] * (REPEAT_POSE - 1) + [True]
    robot.perceive(sense(20))
    assert announced(robot, [1, 2]) == ["pose"]


def test_a_pose_that_was_not_transmitted_is_sent_again() -> None:
    robot = make_robot("burgard")
    robot.perceive(sense(1))
    assert announced(robot, [1]) == ["pose"]
    robot.perceive(sense(2))
    assert announced(robot, [1]) == ["pose"]


def test_a_pose_and_a_target_go_in_one_broadcast_and_are_understood() -> None:
    one, other = make_robot("burgard"), make_robot("burgard", 1)
    one.perceive(sense(1))
    one.decide()
    one.perceive(sense(2))
    frame = one.announce([1])
    assert frame is not None
    assert [packet.name for packet in packet_codec.decode(frame)] == ["pose", "targ"]
    assert len(frame) == 7
    other.receive_broadcast(0, frame)
    assert not other.peer_errors


def test_a_pose_contains_whether_the_robot_leads() -> None:
    for number, leads in ((0, 1), (1, 0)):
        robot = make_robot("leaders", number)
        robot.perceive(sense(1))
        frame = robot.announce([1 - number])
        assert frame is not None
        (pose,) = packet_codec.decode(frame)
        assert pose == packets.Pose(10, 10, leads)


class Witness(Strategy):
    """Records the last situation."""

    name = "witness"
    summary = "stays and records its last situation"
    source = "an example"
    publishes_pose = True
    situation: ClassVar[Situation]

    def decide(self, situation: Situation) -> Decision:
        Witness.situation = situation
        return Decision()


def test_a_depot_is_the_first_received_pose_and_distances_add_up_from_pose_to_pose() -> None:
    robot = make_robot(f"{__name__}:Witness")
    for step, x, received in ((1, 10, (3, 4)), (2, 13, (6, 8)), (3, 13, (6, 10))):
        robot.perceive(sense(step, x))
        robot.announce([1])
        robot.receive_broadcast(1, packet_codec.encode([packets.Pose(*received, 0)]))
        robot.decide()
    situation = Witness.situation
    assert situation.homes == {0: (10, 10), 1: (3, 4)}
    assert situation.home == (10, 10)
    assert situation.poses == {1: TeammatePose(6, 10, leads=False)}
    assert situation.traveled == {0: 3.0, 1: 5.0 + 2.0}


class Undecided(Strategy):
    """Returns a cell instead of a decision."""

    name = "undecided"
    summary = "returns a cell instead of a decision"
    source = "an example"

    def decide(self, situation: Situation) -> Decision:
        return situation.here  # type: ignore[return-value]


def test_an_error_names_what_a_strategy_returned_instead_of_a_decision() -> None:
    robot = make_robot(f"{__name__}:Undecided")
    robot.perceive(sense(1))
    with pytest.raises(
        TypeError, match=r"strategy undecided: decide must return a Decision; it returned \(10, 10\)"
    ):
        robot.decide()


def test_a_malformed_broadcast_is_a_fault_and_nothing_more() -> None:
    robot = make_robot("burgard")
    for frame in (
        packet_codec.encode([packets.Pose(500, 3, 0)]),
        packet_codec.encode([packets.Save()]),
        b"\xff",
    ):
        robot.receive_broadcast(1, frame)
    assert len(robot.peer_errors) == 3
    robot.perceive(sense(1))
    robot.decide()


def test_map_changes_wait_for_a_new_target_if_the_strategy_defers_them() -> None:
    robot = make_robot("scan-replan")
    robot.perceive(sense(1))
    robot.decide()
    first = len(robot.replication.logs[0])
    assert first > 0
    robot.perceive(sense(2, 11))
    robot.decide()
    assert len(robot.replication.logs[0]) == first
    assert robot.target is not None
    robot.perceive(sense(3, *robot.target))
    robot.decide()
    assert len(robot.replication.logs[0]) > first


def test_a_resting_scanner_logs_nothing() -> None:
    robot = make_robot("classical")
    robot.perceive(sense(1))
    robot.decide()
    before = len(robot.replication.logs[0])
    robot.perceive(sense(2, 11, look=False))
    robot.decide()
    assert len(robot.replication.logs[0]) == before


@pytest.mark.parametrize(
    ("robots", "map_encoding", "first"),
    [(2, "scans", 1), (2, "polygons", 1 + SURE_AFTER), (1, "polygons", 1)],
)
def test_with_inferred_cells_a_robot_is_done_only_after_some_steps(
    robots: int, map_encoding: str, first: int
) -> None:
    robot = Robot(
        settings_for(drawn(*["." * 5] * 5), robots=robots, map_encoding=map_encoding, strategy="meier")
    )
    explored = []
    for step in range(1, SURE_AFTER + 3):
        robot.perceive(sense(step, 2, 2))
        explored.append(robot.decide().explored)
    assert explored.index(True) + 1 == first
    assert all(explored[first - 1 :])


@pytest.mark.parametrize(
    ("robots", "people", "steps"),
    [(1, False, SURE_AFTER_NOISE), (2, True, SURE_AFTER_NOISE_IN_TEAM), (2, False, SURE_AFTER_NOISE_IN_TEAM)],
)
def test_with_real_sensors_a_team_without_people_waits_less_for_the_end(
    robots: int, people: bool, steps: int
) -> None:
    laser = Laser(beams=9, first=0, span=TURN // 2, reach_mm=1000)
    settings = settings_for(GRID, robots=robots, strategy="meier", people=people)
    bodies = tuple(replace(body, laser=laser) for body in settings.bodies)
    assert sure_after(replace(settings, bodies=bodies)) == steps
    assert sure_after(settings) == 0, "lasers are exact"


def test_entries_that_depend_on_unsent_entries_do_no_harm() -> None:
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
    assert not victim.peer_errors
    victim.decide()
    assert (victim.planning == victim.own)[victim.own != 0].all()
