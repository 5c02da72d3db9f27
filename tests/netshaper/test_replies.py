"""Replies told beforehand: the same goes on the air as if each robot had been asked, in fewer messages."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.exchange.session import Session
from netshaper.medium import UNLIMITED
from netshaper.radio import Frame, Note, Outgoing, Radio, RadioSettings
from protocol import packet_index, packets
from protocol.errors import ProtocolError
from protocol.messages import NO_REPLIES, Open, Outcome, PhaseDelivery, Replies, Said, pack, unpack


class Team:
    """Sessions of robots that log words, and the radio between them."""

    def __init__(self, robots: int, policy: str, budget: int, reach: float, *, beforehand: bool) -> None:
        self.radio = Radio(RadioSettings(robots, 7, reach, budget))
        self.sessions = [Session(robot, robots, policy) for robot in range(robots)]
        self.opened = 0
        """How often the medium was opened to a robot."""
        self.words = 0
        """What robots had to say to the relay."""
        self.books: list[tuple[bytes, bytes]] = []
        self._beforehand = beforehand
        self._heard: list[list[tuple[int, bytes]]] = [[] for _ in range(robots)]

    def step(self, number: int, cells: dict[int, tuple[int, int]], logged: list[int]) -> None:
        for robot, (session, words) in enumerate(zip(self.sessions, logged, strict=True)):
            session.record([packets.encode([packets.Fragment(bytes([robot, number % 256]))])] * words)
        out = self.radio.begin(number, cells)
        while out:
            said: list[tuple[int, Said]] = []
            for item in out:
                said += self._take(item)
            self.words += len(said)
            out = [item for robot, words in said for item in self.radio.said(robot, words)]

    def _take(self, item: Outgoing) -> list[tuple[int, Said]]:
        if isinstance(item, Frame):
            for receiver in item.receivers:
                self._heard[receiver].append((item.sender, item.payload))
        elif isinstance(item, Note):
            heard = [*self._heard[item.receiver], *zip(item.senders, item.frames, strict=True)]
            self._heard[item.receiver] = []
            said = self._speak(item.receiver, item.message, heard)
            return [] if said is None else [(item.receiver, said)]
        else:
            report = item.report()
            self.books.append((report.rows, report.frames))
        return []

    def _speak(self, robot: int, note: object, heard: list[tuple[int, bytes]]) -> Said | None:
        session = self.sessions[robot]
        if isinstance(note, Open):
            self.opened += 1
            room = None if note.budget == UNLIMITED else note.budget
            offers = session.offers(note.round, note.peers, room)
            receivers, frames = [peer for peer, _, _ in offers], [frame for _, _, frame in offers]
            replies = session.replies() if self._beforehand else NO_REPLIES
            return Said(note.step, note.round, "offers", [], 0, receivers, frames, replies)
        if isinstance(note, Outcome):
            for peer, map_id, frame in session.outcome(note, heard):
                session.accept(peer, map_id, frame, packet_index.ends(frame))
        if not isinstance(note, PhaseDelivery):
            return None
        if note.phase == "offers":
            said = session.answers([(n, *frame) for n, frame in zip(note.connections, heard, strict=True)])
        else:
            named = zip(note.connections, heard, note.maps, strict=True)
            said = session.data([(n, peer, map_id, frame) for n, (peer, frame), map_id in named])
        if note.spoken:
            return None
        numbers, receivers = [number for number, _, _ in said], [peer for _, peer, _ in said]
        phase = "answers" if note.phase == "offers" else "data"
        return Said(note.step, note.round, phase, numbers, 0, receivers, [frame for _, _, frame in said])


@settings(deadline=None)
@given(
    st.integers(2, 5),
    st.sampled_from(("backoff", "thesis")),
    st.sampled_from((UNLIMITED, 0, 9, 40, 300)),
    st.integers(0, 1000),
)
def test_what_is_said_for_robots_is_what_they_would_say(
    robots: int, policy: str, budget: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    asked, spoken = (Team(robots, policy, budget, 10.0, beforehand=each) for each in (False, True))
    for number in range(1, 9):
        places = random.integers(0, 16, (robots, 2)).tolist()
        logged = random.choice([0, 1, 1, 5, 3000], robots).tolist()
        for team in (asked, spoken):
            team.step(number, {robot: (x, y) for robot, (x, y) in enumerate(places)}, logged)
    assert spoken.books == asked.books
    assert not spoken.radio.faults
    for one, other in zip(asked.sessions, spoken.sessions, strict=True):
        assert [len(log) for log in one.logs] == [len(log) for log in other.logs]
        assert (one.known == other.known).all()
    assert spoken.words <= asked.words


def test_where_all_is_as_it_seems_a_robot_speaks_once_an_exchange() -> None:
    asked, spoken = (Team(3, "backoff", UNLIMITED, 10.0, beforehand=each) for each in (False, True))
    cells = {robot: (robot, 0) for robot in range(3)}
    for number in range(1, 11):
        for team in (asked, spoken):
            team.step(number, cells, [1, 1, 1])
    assert spoken.words == spoken.opened == asked.opened
    assert asked.words > 2 * asked.opened


def test_who_lies_about_its_replies_is_refused_like_one_who_says_them() -> None:
    radio = Radio(RadioSettings(2, 0, 10.0))
    radio.begin(1, {0: (0, 0), 1: (1, 0)})
    offer, answer = (packets.encode([packet]) for packet in (packets.Offer(0, 0), packets.Answer(0)))
    sends = Replies([], [], b"", [b""], [answer], [0], [b"\xff\xff no units"])
    radio.said(0, Said(1, 0, "offers", [], 0, [1], [offer], sends))
    answers = Replies([offer], [packets.encode([packets.Answer(0), packets.Save()])], b"", [], [], [], [])
    radio.said(1, Said(1, 0, "offers", [], 0, [], [], answers))
    assert [sender for sender, _ in radio.faults] == [1]
    assert "an answer frame is" in radio.faults[0][1]
    radio.faults.clear()
    radio.begin(2, {0: (0, 0), 1: (1, 0)})
    radio.said(0, Said(2, 0, "offers", [], 0, [1], [offer], sends))
    radio.said(1, Said(2, 0, "offers", [], 0, [], [], Replies([offer], [answer], b"", [], [], [], [])))
    assert [sender for sender, _ in radio.faults] == [0]


@pytest.mark.parametrize(
    "replies",
    [
        [[b"a"], [], b"", [], [], [], []],
        [[], [], b"", [b"a"], [], [], []],
        [[], [], b"", [b"a"], [b"b"], [1], [b"c"]],
        [[], [], []],
    ],
)
def test_replies_that_do_not_fit_together_are_no_message(replies: list[Any]) -> None:
    said = [7, 1, 0, "offers", [], 0, [], [], replies]
    with pytest.raises(ProtocolError, match="replies must be Replies"):
        unpack(msgspec.msgpack.encode(said))
    whole = Said(1, 0, "offers", [], 0, [], [], Replies([b"a"], [b"b"], b"f", [b"c"], [b"d"], [0], [b"e"]))
    assert unpack(pack(whole)) == whole
