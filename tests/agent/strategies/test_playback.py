from __future__ import annotations

import numpy as np
import pytest

from agent.replication.delivery import Acks
from agent.replication.peers import PeerTable
from agent.replication.replica import Replica
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from agent.strategies.base import Decision, Situation
from agent.strategies.playback import LOSSY_PATIENCE, PATIENCE, Playback
from agent.strategies.registry import strategies, strategy
from protocol.body import Body


def settings(robots: int, *, lossy: bool = False) -> Settings:
    return Settings(
        robot=0, bodies=(Body(5.0, 360.0, 3.0),) * robots, width=4, height=4, beams=36, seed=0,
        strategy="playback", encoding=EncodingSettings("predictive"),
        replication=ReplicationSettings("gossip", requires_acks=lossy),
    )  # fmt: skip


def decisions(
    *states: tuple[int, int], peers: tuple[int, ...] = (1,), robots: int = 2, lossy: bool = False
) -> list[Decision]:
    """Decisions of a robot whose log has these lengths and backlogs, step by step."""
    robot = Playback({}, settings(robots, lossy=lossy))
    grid = np.zeros((4, 4), np.uint8)
    return [
        robot.decide(Situation(step, grid, 1, 1, peers=peers, log_entries=entries, backlog=backlog))
        for step, (entries, backlog) in enumerate(states, 1)
    ]


def test_a_robot_is_done_once_its_log_has_stopped_growing_and_is_delivered() -> None:
    found = decisions((0, 0), (1, 1), (1, 0), (1, 0), (2, 0), (2, 0))
    assert [each.explored for each in found] == [False, False, False, True, False, True]


def test_a_robot_without_teammates_in_range_is_not_done() -> None:
    assert not any(each.explored for each in decisions((1, 0), (1, 0), peers=()))
    assert decisions((1, 0), (1, 0), peers=(), robots=1)[-1].explored


@pytest.mark.parametrize(("backlog", "peers"), [(3, (1,)), (0, ())])
@pytest.mark.parametrize(("lossy", "patience"), [(False, PATIENCE), (True, LOSSY_PATIENCE)])
def test_a_robot_gives_up_after_many_steps_without_a_delivery(
    backlog: int, peers: tuple[int, ...], lossy: bool, patience: int
) -> None:
    found = decisions(*[(5, backlog)] * (patience + 1), peers=peers, lossy=lossy)
    assert [each.stalled for each in found] == [False] * patience + [True]


def test_on_a_lossy_medium_a_robot_asks_silent_peers_five_times_before_it_gives_up() -> None:
    acks = Acks(Replica(PeerTable(0, 8, 8, reliable=False), lambda *_: [], lambda _: None))
    acks.begin_step(budget=50)
    assert 5 * acks.turn < LOSSY_PATIENCE


def test_a_robot_neither_drives_nor_has_a_target() -> None:
    for decision in decisions((0, 0), (5, 3), (5, 0)):
        assert (decision.target, len(decision.path), len(decision.points)) == (None, 0, 0)


def test_the_strategy_is_not_listed_among_those_that_explore() -> None:
    assert "playback" not in strategies()
    assert strategy("playback") is Playback
