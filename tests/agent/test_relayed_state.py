"""Connected sub-teams: robots in between forward the states that they received."""

from __future__ import annotations

from typing import Any

import pytest

from agent.robot import Robot
from agent.strategies.base import Situation, TeammatePose
from agent.strategies.burgard import Burgard
from agent.team_state import RelayedState
from netshaper.admission import is_broadcast
from protocol import packet_codec, packets
from protocol.grid import Cell, ray_table
from protocol.messages import RoundReport, Sense
from protocol.packets import Passed, Target
from tests.agent.planning.planning_references import drawn, settings_for

GRID = drawn(*["." * 60] * 20)
READINGS = (ray_table(5.0, 360).start[1:] - ray_table(5.0, 360).start[:-1]).astype("<u2").tobytes()


class Watched(Burgard):
    """Burgard's strategy; records its last situation and sub-team."""

    name = "watched"

    def decide(self, situation: Situation) -> Any:
        """Record the situation and the sub-team, then decide."""
        self.situation, self.members = situation, tuple(self.team(situation))
        return super().decide(situation)


class Line:
    """Robots in a row; each receives from its direct neighbors unless the link is broken."""

    def __init__(self, robots: int, sub_team: str, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("agent.robot.strategy", lambda name: Watched)
        options = {"sub_team": sub_team}
        self.robots = [
            Robot(
                settings_for(
                    GRID,
                    robot=robot,
                    robots=robots,
                    strategy="burgard",
                    map_encoding="scans",
                    options=options,
                )
            )
            for robot in range(robots)
        ]
        self.step_number, self.broken = 0, False

    def step(self, columns: list[int]) -> None:
        """Play one step with the robots in these columns; neighbors receive each broadcast."""
        self.step_number += 1
        for robot, x in zip(self.robots, columns, strict=True):
            robot.perceive(Sense(self.step_number, x, 10, 0, b"", READINGS, ""))
        beside = {
            one: [two for two in (one - 1, one + 1) if self.in_range(one, two)]
            for one in range(len(self.robots))
        }
        frames = {one: self.robots[one].announce(peers) for one, peers in beside.items()}
        for one, frame in frames.items():
            assert frame is None or is_broadcast(frame)
            for other in beside[one] if frame is not None else ():
                assert frame is not None
                self.robots[other].receive_broadcast(one, frame)
            report = RoundReport(self.step_number, 0, [], [], [], frame is not None)
            self.robots[one].close_round(report)
        for robot in self.robots:
            robot.decide()
            assert not robot.peer_errors

    def in_range(self, one: int, two: int) -> bool:
        return 0 <= two < len(self.robots) and not (self.broken and {one, two} == {0, 1})

    @property
    def teams(self) -> list[tuple[int, ...]]:
        return [robot.strategy.members for robot in self.robots]  # type: ignore[attr-defined]


def test_in_a_chain_of_three_all_plan_for_three_with_relayed_states(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for sub_team, ends in (("in-range", [(0, 1), (1, 2)]), ("connected", [(0, 1, 2), (0, 1, 2)])):
        line = Line(3, sub_team, monkeypatch)
        targets = set()
        for step in range(3):
            line.step([5 + step, 20, 35])
            targets.add(line.robots[0].target)
        first, last = line.teams[0], line.teams[2]
        assert [first, last] == ends
        assert line.teams[1] == (0, 1, 2)
    situation = line.robots[2].strategy.situation  # type: ignore[attr-defined]
    assert situation.connected == (0,)
    assert situation.poses[0] == TeammatePose(6, 10, leads=False), "where it was a step ago"
    assert situation.targets[0] in targets
    assert situation.traveled[0] == 1.0


def test_a_robot_with_an_outdated_relayed_state_is_no_member(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    line = Line(4, "connected", monkeypatch)
    for _ in range(4):
        line.step([5, 20, 35, 50])
    assert line.teams == 4 * [(0, 1, 2, 3)]
    line.broken = True
    for _ in range(4):
        line.step([5, 20, 35, 50])
    assert line.teams == [(0,), *3 * [(1, 2, 3)]]


def test_a_relayed_state_circulates_no_longer_than_through_a_chain_of_all_robots() -> None:
    one, two = (RelayedState(settings_for(GRID, robot=robot, robots=5)) for robot in (1, 2))
    poses: dict[int, TeammatePose] = {0: TeammatePose(3, 4, leads=False)}
    targets: dict[int, Cell] = {0: (8, 9)}
    sent = {1: one.forward(1, [0], [2], poses, targets), 2: two.forward(1, [], [1], poses, targets)}
    assert sent == {1: [Passed(0, 1, 3, 4), Target(8, 9)], 2: []}
    lasted = 0
    for step in range(1, 9):
        for state, other in ((one, 2), (two, 1)):
            news = [state.take(packet, step) for packet in sent[other] if isinstance(packet, Passed)]
            assert news == ([True] if (step, other) == (1, 1) else [False] * len(news)), (
                "a state is new only when it comes directly from its robot"
            )
        lasted += bool(two.connected(step, [1]))
        sent = {
            1: one.forward(step + 1, [2], [2], poses, targets),
            2: two.forward(step + 1, [1], [1], poses, targets),
        }
    assert lasted == 3 and sent == {1: [], 2: []}


@pytest.mark.parametrize("frame", [
    [Passed(9, 1, 3, 4)], [Passed(0, 1, 500, 4)], [Passed(0, 1, 3, 4), Target(900, 9)],
])  # fmt: skip
def test_a_relayed_state_of_an_unknown_robot_or_cell_is_a_fault(frame: list[packets.AnyPacket]) -> None:
    robot = Robot(settings_for(GRID, robot=2, robots=3, strategy="burgard", map_encoding="scans"))
    robot.receive_broadcast(1, packet_codec.encode(frame))
    assert len(robot.peer_errors) == 1


@pytest.mark.parametrize("frame", [
    [Passed(1, 1, 3, 4), Passed(1, 1, 3, 4)], [Passed(2, 1, 3, 4), Passed(1, 1, 3, 4)],
    [Passed(1, 1, 3, 4), packets.Pose(1, 1, 0)],
    [Target(1, 1), packets.Pose(1, 1, 0)], [Target(1, 1), Target(1, 1)], [],
])  # fmt: skip
def test_the_radio_rejects_broadcasts_with_repeated_or_unordered_packets(
    frame: list[packets.AnyPacket],
) -> None:
    assert not is_broadcast(packet_codec.encode(frame))
    assert is_broadcast(
        packet_codec.encode(
            [packets.Pose(1, 1, 0), Target(1, 1), Passed(1, 1, 3, 4), Target(5, 5), Passed(2, 1, 3, 4)]
        )
    )
