"""Speculative replies: the relay carries the same frames as if it asked each robot, with fewer messages."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from agent.radio_events import continue_round, open_round
from agent.replication.base import Replication
from netshaper.radio import Radio
from netshaper.settings import RadioSettings
from protocol import packet_index, packets
from protocol.budget import UNLIMITED, Budget
from protocol.errors import ProtocolError
from protocol.messages import (
    NO_REPLIES,
    MediumEvent,
    Open,
    OutgoingFrame,
    PhaseDelivery,
    Replies,
    RobotFrames,
    RoundReport,
    pack,
    unpack,
)
from tests.agent.replication.network import make_engine
from tests.netshaper.network import Network


class Member:
    """A replication engine of a robot, with or without speculative replies."""

    def __init__(self, replication: Replication, *, speculates: bool) -> None:
        self.replication = replication
        self.speculates = speculates

    def __call__(self, event: MediumEvent) -> list[RobotFrames]:
        if isinstance(event, Open):
            frames = open_round(self.replication, event)
            return [frames if self.speculates else replace(frames, replies=NO_REPLIES)]
        if isinstance(event, RoundReport):
            assert not self.replication.close_round(event)
        elif isinstance(event, PhaseDelivery):
            sent = continue_round(self.replication, event, pytest.fail)
            return [] if sent is None else [sent]
        return []


def replication(robot: int, robots: int, policy: str = "backoff") -> Replication:
    """An engine that can decode everything."""
    return make_engine(robot, robots, lambda *received: packet_index.ends(received[-1]), policy)


class Team:
    """Replication engines that append entries, and the radio between them."""

    def __init__(self, robots: int, policy: str, budget: Budget, *, speculates: bool) -> None:
        self.engines = [replication(robot, robots, policy) for robot in range(robots)]
        members = {n: Member(engine, speculates=speculates) for n, engine in enumerate(self.engines)}
        self.network = Network(RadioSettings(robots, 7, 10.0, budget), members)
        self.opened = 0
        """How often a round was opened to a robot."""
        self.sent = 0
        """Messages that robots sent to the relay."""
        self.books: list[tuple[bytes, bytes]] = []

    def step(self, number: int, cells: dict[int, tuple[int, int]], logged: list[int]) -> None:
        for robot, (engine, count) in enumerate(zip(self.engines, logged, strict=True)):
            engine.append([packets.encode([packets.Fragment(bytes([robot, number % 256]))])] * count)
        step = self.network.step(number, cells)
        self.opened += len(step.opened)
        self.sent += len(step.sent)
        self.books.append((step.report.rows, step.report.frames))


@settings(deadline=None)
@given(
    st.integers(2, 5),
    st.sampled_from(("backoff", "thesis")),
    st.sampled_from((UNLIMITED, *map(Budget, (0, 9, 40, 300)))),
    st.integers(0, 1000),
)
def test_replies_of_the_relay_are_those_of_the_robots(
    robots: int, policy: str, budget: Budget, seed: int
) -> None:
    random = np.random.default_rng(seed)
    asked, answered = (Team(robots, policy, budget, speculates=each) for each in (False, True))
    for number in range(1, 9):
        places = random.integers(0, 16, (robots, 2)).tolist()
        logged = random.choice([0, 1, 1, 5, 3000], robots).tolist()
        for team in (asked, answered):
            team.step(number, {robot: (x, y) for robot, (x, y) in enumerate(places)}, logged)
    assert answered.books == asked.books
    assert not answered.network.radio.protocol_errors
    for one, other in zip(asked.engines, answered.engines, strict=True):
        assert [len(log) for log in one.logs] == [len(log) for log in other.logs]
        assert (one.peers.expected == other.peers.expected).all()
    assert answered.sent <= asked.sent


def test_without_losses_a_robot_sends_one_message_per_round() -> None:
    asked, answered = (Team(3, "backoff", UNLIMITED, speculates=each) for each in (False, True))
    cells = {robot: (robot, 0) for robot in range(3)}
    for number in range(1, 11):
        for team in (asked, answered):
            team.step(number, cells, [1, 1, 1])
    assert answered.sent == answered.opened == asked.opened
    assert asked.sent > 2 * asked.opened


def test_wrong_speculative_replies_are_refused_like_wrong_frames() -> None:
    radio = Radio(RadioSettings(2, 0, 10.0))
    radio.begin(1, {0: (0, 0), 1: (1, 0)})
    offer, answer = (packets.encode([packet]) for packet in (packets.Offer(0, 0), packets.Answer(0)))
    sends = Replies({}, [{answer: 0}], [b"\xff\xff no entries"])
    radio.submit(0, RobotFrames(1, 0, "offers", b"", [OutgoingFrame(1, offer)], 0, sends))
    wrong = packets.encode([packets.Answer(0), packets.Save()])
    radio.submit(1, RobotFrames(1, 0, "offers", replies=Replies({offer: wrong}, [], [])))
    assert [sender for sender, _ in radio.protocol_errors] == [1]
    assert "an answer frame is" in radio.protocol_errors[0][1]
    radio.protocol_errors.clear()
    radio.begin(2, {0: (0, 0), 1: (1, 0)})
    radio.submit(0, RobotFrames(2, 0, "offers", b"", [OutgoingFrame(1, offer)], 0, sends))
    radio.submit(1, RobotFrames(2, 0, "offers", replies=Replies({offer: answer}, [], [])))
    assert [sender for sender, _ in radio.protocol_errors] == [0]


@pytest.mark.parametrize(
    "replies",
    [
        [[b"a"], [], []],
        [{}, [{b"a": 1}], [b"c"]],
        [{}, [{b"a": -2}], []],
        [{}, []],
    ],
)
def test_inconsistent_replies_are_refused(replies: list[Any]) -> None:
    with pytest.raises(ProtocolError, match=r"replies(:|\[)"):
        unpack(msgspec.msgpack.encode([7, 1, 0, "offers", b"", [], 0, replies]))
    fitting = Replies({b"a": b"b"}, [{b"c": 0, b"d": -1}], [b"e"])
    whole = RobotFrames(1, 0, "offers", replies=fitting)
    assert unpack(pack(whole)) == whole
