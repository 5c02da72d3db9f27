"""The radio where maps travel by gossip: who is heard, who goes first, what is refused."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import pytest
from hypothesis import given

from netshaper.ledger import EVERYONE
from netshaper.medium import BROADCAST, NEWS
from netshaper.radio import RadioSettings
from protocol import packet_index, packets
from protocol.messages import Open, Said
from protocol.packets import Offer, Save, Target, encode
from tests.netshaper.scenes import gossip, play
from tests.netshaper.scripted_robots import Air, Gossiper, Put


@given(gossip())
def test_news_are_heard_by_all_in_range_and_both_ends_are_told_what_was_carried(scene: Any) -> None:
    for step in play(scene, deadly=False):
        reach = {robot: note.peers for robot, note in step.opened}
        carried: Counter[tuple[int, int]] = Counter()
        heard: Counter[int] = Counter()
        for row in step.rows[(step.rows["frame"] == NEWS) & (step.rows["carried"] == 1)]:
            sender, size = int(row["sender"]), int(row["bytes"])
            assert int(row["received_by"]) == len(reach[sender])
            carried[sender, int(row["round"])] += size
            heard[sender] += size * len(reach[sender])
        told = Counter({(robot, o.round): sum(o.data) for robot, o in step.outcomes})
        assert +told == +carried
        delivered: Counter[int] = Counter()
        for kind, frame in step.delivered:
            if kind == "data":
                delivered[frame.sender] += len(frame.payload)
        assert delivered == +heard


@given(gossip())
def test_news_are_cut_between_packets(scene: Any) -> None:
    for step in play(scene):
        for kind, frame in step.delivered:
            if kind == "data":
                assert b"".join(packet_index.split(frame.payload)) == frame.payload


def test_the_most_urgent_news_go_first_and_a_shorter_packet_may_use_the_rest() -> None:
    class Says(Gossiper):
        def opens(self, note: Open) -> list[Put | Said]:
            size = (40, 30, 3)[self.number]
            news = (EVERYONE, encode([packets.Update(0, bytes(size))]))
            return [news, Said(note.step, note.round, "offers", [], 10 * self.number % 20)]

    settings = RadioSettings(3, 0, math.inf, 40, 1, gossip=True)
    air = Air(settings, {number: Says(number, 3, 0) for number in range(3)})
    rows = air.step(1, {number: (number, 0) for number in range(3)}).rows
    assert [(int(row["sender"]), int(row["carried"])) for row in rows] in (
        [(1, 1), (0, 0), (2, 1)],
        [(1, 1), (2, 1), (0, 0)],
    )


@pytest.mark.parametrize(
    ("payload", "receiver", "reason"),
    [
        (encode([Offer(1, 0)]), EVERYONE, "no conn of this kind"),
        (encode([Target(1, 2), Save()]), EVERYONE, "no targ of this kind"),
        (6 * b"\xff", EVERYONE, "no packet begins with 0xffff"),
        (b"", EVERYONE, "nothing in it"),
        (encode([Save()]), 1, "said to one robot"),
    ],
)
def test_what_are_no_news_is_refused_and_booked(payload: bytes, receiver: int, reason: str) -> None:
    class Says(Gossiper):
        def opens(self, note: Open) -> list[Put | Said]:
            said: list[Put | Said] = [(receiver, payload)] if self.number == 0 else []
            return [*said, Said(note.step, note.round, "offers", [])]

    air = Air(RadioSettings(2, 0, math.inf, gossip=True), {number: Says(number, 2, 0) for number in range(2)})
    step = air.step(1, {0: (0, 0), 1: (1, 0)})
    assert not step.delivered
    ((sender, why),) = air.radio.faults
    assert sender == 0
    assert reason in why
    assert step.rows["bytes"].sum() == len(payload)


def test_targets_leave_most_of_a_narrow_medium_to_news() -> None:
    class Says(Gossiper):
        def opens(self, note: Open) -> list[Put | Said]:
            target = (EVERYONE, encode([Target(self.number, 1)]))
            news = (EVERYONE, encode([packets.Update(0, bytes(6))]))
            return [target, news, Said(note.step, note.round, "offers", [])]

    air = Air(RadioSettings(8, 0, math.inf, 48, 1, gossip=True), {n: Says(n, 8, 0) for n in range(8)})
    rows = air.step(1, {number: (number, 0) for number in range(8)}).rows
    carried = rows[rows["carried"] == 1]
    assert carried["bytes"][carried["frame"] == BROADCAST].sum() == 3
    assert carried["bytes"][carried["frame"] == NEWS].sum() == 40
