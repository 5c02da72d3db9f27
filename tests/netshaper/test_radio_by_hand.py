"""The radio with frames written by hand: those that a round transmits and refuses, and robots that die in between."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netshaper.ledger import (
    ANSWER,
    BROADCAST,
    CAUSES,
    DATA,
    EVERYONE,
    KIND_NUMBER,
    MALFORMED,
    OFFER,
    ROW,
    balance,
)
from netshaper.settings import RadioSettings
from protocol import packets
from protocol.budget import UNLIMITED, Budget
from protocol.messages import (
    Close,
    ConnectionReport,
    Delivery,
    Open,
    OutgoingFrame,
    PhaseDelivery,
    RobotFrames,
    RoundReport,
)
from protocol.packet_codec import encode
from protocol.packets import Answer, Delete, Offer, Save, Target
from tests.netshaper.network import Network, Step
from tests.netshaper.scenes import seeds
from tests.netshaper.scripted_robots import Robot


def network_of(
    *robots: Robot, budget: Budget = UNLIMITED, range_cells: float = 10.0, rounds: int = 1
) -> Network:
    settings = RadioSettings(len(robots), 7, range_cells, budget, rounds)
    return Network(settings, dict(enumerate(robots)))


class Sends(Robot):
    """A robot that opens with given frames, answers `Answer(0)` and sends given data for each answer."""

    def __init__(
        self,
        number: int,
        *offers: tuple[int, bytes],
        broadcast: bytes = b"",
        data: bytes = b"",
        late: bytes = b"",
    ) -> None:
        super().__init__(number, 2, 0)
        self.offers = [OutgoingFrame(*each) for each in offers]
        self.broadcast = broadcast
        self.sends = data
        self.late = late

    def opens(self, event: Open) -> list[RobotFrames]:
        first = (self.broadcast, self.offers) if event.round == 0 else ()
        return [RobotFrames(event.step, event.round, "offers", *first)]

    def answer(self, _rng: np.random.Generator) -> bytes:
        return encode([Answer(0)])

    def data(self, _rng: np.random.Generator, _answer: bytes) -> bytes:
        return self.sends

    def rests(self, event: Close) -> list[RobotFrames]:
        return [RobotFrames(event.step, 0, "late", self.late)] if self.late else []


OFFER_0 = encode([Offer(0, 0)])
TARGET_12 = encode([Target(1, 2)])
TOGETHER = {0: (0, 0), 1: (3, 4)}


def logged(step: Step) -> list[tuple[str, int, int, int, bool, str]]:
    """Rows as (frame, sender, receiver, bytes, carried, cause)."""
    frames = ("offer", "answer", "data", "broadcast")
    return [
        (frames[frame], sender, receiver, size, bool(carried), CAUSES[cause])
        for frame, sender, receiver, size, carried, cause in step.rows[
            ["frame", "sender", "receiver", "bytes", "carried", "cause"]
        ].tolist()
    ]


def test_a_connection_puts_its_offer_its_answer_and_its_data_on_the_air() -> None:
    step = network_of(Sends(0, (1, OFFER_0), data=encode([Save(), Save()])), Sends(1)).step(1, TOGETHER)
    assert logged(step) == [
        ("offer", 0, 1, 2, True, ""),
        ("answer", 1, 0, 2, True, ""),
        ("data", 0, 1, 2, True, ""),
    ]
    assert step.rows["map"].tolist() == [0, 0, 0]
    assert step.rows["kind"].tolist() == [KIND_NUMBER["conn"], KIND_NUMBER["conn"], KIND_NUMBER["save"]]


@pytest.mark.parametrize(
    ("budget", "carried"),
    [
        (0, (0, 0, 0, 0)),
        (2, (0, 0, 0, 0)),
        (3, (3, 0, 0, 0)),
        (4, (3, 0, 0, 0)),
        (5, (3, 2, 0, 0)),
        (7, (3, 2, 2, 0)),
        (8, (3, 2, 2, 1)),
        (9, (3, 2, 2, 1)),
        (10, (3, 2, 2, 3)),
        (11, (3, 2, 2, 4)),
        (99, (3, 2, 2, 4)),
    ],
)
def test_the_budget_is_spent_on_targets_then_connection_by_connection_packet_by_packet(
    budget: int, carried: tuple[int, ...]
) -> None:
    data = encode([Save(), Delete(1), Save()])
    robots = Sends(0, (1, OFFER_0), broadcast=TARGET_12, data=data), Sends(1)
    step = network_of(*robots, budget=Budget(budget)).step(1, TOGETHER)
    by_frame = [
        step.bytes_where((step.rows["carried"] == 1) & (step.rows["frame"] == frame)) for frame in range(4)
    ]
    assert (by_frame[BROADCAST], by_frame[OFFER], by_frame[ANSWER], by_frame[DATA]) == carried
    assert step.bytes_where(step.rows["carried"] == 0) == 11 - sum(carried)
    (_, report), (_, other) = step.reports
    assert report.connections == [ConnectionReport(0, *carried[1:])]
    assert report.broadcast_sent == (carried[0] > 0)
    assert other.deliveries == ([Delivery(0, data[: carried[3]], 0)] if carried[3] else [])


def test_once_closed_the_medium_stays_closed_for_smaller_frames_and_later_rounds() -> None:
    robots = Sends(0, (1, OFFER_0), data=encode([packets.Fragment(bytes(63))])), Sends(1, (0, OFFER_0))
    step = network_of(*robots, budget=Budget(50), rounds=2).step(1, TOGETHER)
    assert [event.round for number, event in step.opened if number == 0] == [0]
    cut = step.rows["carried"].tolist().index(0)
    assert not step.rows["carried"][cut:].any()


def test_a_later_round_has_the_remaining_budget() -> None:
    robots = Sends(0, (1, OFFER_0), data=encode([Save()])), Sends(1)
    step = network_of(*robots, budget=Budget(50), rounds=3).step(1, TOGETHER)
    assert [event.budget.limit for number, event in step.opened if number == 0] == [50, 45, 45]


def test_the_next_step_has_its_whole_budget_again() -> None:
    network = network_of(Sends(0, (1, OFFER_0), data=bytes(0)), Sends(1), budget=Budget(4))
    assert [network.step(number, TOGETHER).carried for number in (1, 2, 3)] == [4, 4, 4]


def test_a_target_reaches_all_robots_in_range_and_is_logged_once() -> None:
    step = network_of(Sends(0, broadcast=TARGET_12), Sends(1), Sends(2), range_cells=5.0).step(
        1, {0: (0, 0), 1: (3, 4), 2: (4, 4)}
    )
    assert logged(step) == [("broadcast", 0, EVERYONE, 3, True, "")]
    assert step.rows["received_by"].tolist() == [1]
    assert [frame.receiver for frame in step.delivered] == [1]


def test_a_target_without_receivers_is_still_on_the_air() -> None:
    step = network_of(Sends(0, broadcast=TARGET_12), Sends(1), range_cells=1.0).step(1, TOGETHER)
    assert logged(step) == [("broadcast", 0, EVERYONE, 3, True, "")]
    assert step.rows["received_by"].tolist() == [0]


def test_a_frame_to_a_robot_out_of_range_is_logged_and_not_delivered() -> None:
    step = network_of(Sends(0, (1, OFFER_0)), Sends(1), range_cells=4.9).step(1, TOGETHER)
    assert logged(step) == [("offer", 0, 1, 2, False, "range")]
    assert step.delivered == []


@pytest.mark.parametrize("receiver", [0, 2, 63, -99])
def test_a_frame_to_its_sender_or_to_no_robot_is_out_of_range(receiver: int) -> None:
    step = network_of(Sends(0, (receiver, OFFER_0)), Sends(1)).step(1, {0: (0, 0), 1: (0, 1)})
    assert logged(step) == [("offer", 0, receiver, 2, False, "range")]


@pytest.mark.parametrize(
    "payload",
    [
        b"\xff",
        TARGET_12,
        OFFER_0 + OFFER_0,
        encode([Offer(2, 0)]),
        encode([Answer(1)]),
        OFFER_0[:1],
        b"\xc0\x00\xf0",
    ],
)
def test_a_malformed_offer_is_logged_with_its_cause_and_reported(payload: bytes) -> None:
    network = network_of(Sends(0, (1, payload)), Sends(1))
    step = network.step(1, TOGETHER)
    assert {
        (sender, receiver, carried, cause) for _, sender, receiver, _, carried, cause in logged(step)
    } == {(0, 1, False, "protocol")}
    assert step.bytes_where(step.rows["bytes"] > 0) == len(payload)
    assert step.delivered == []
    assert [robot for robot, _ in network.radio.protocol_errors] == [0]


def test_a_map_is_offered_to_a_robot_once_per_round() -> None:
    network = network_of(
        Sends(0, (1, OFFER_0), (1, encode([Offer(0, 3)])), (1, encode([Offer(1, 0)]))), Sends(1)
    )
    step = network.step(1, TOGETHER)
    offers = sorted(row for row in logged(step) if row[0] == "offer")
    assert offers == [
        ("offer", 0, 1, 2, False, "protocol"),
        ("offer", 0, 1, 2, True, ""),
        ("offer", 0, 1, 2, True, ""),
    ]
    assert [robot for robot, _ in network.radio.protocol_errors] == [0]


def test_an_offer_to_all_robots_is_refused() -> None:
    network = network_of(Sends(0, (EVERYONE, OFFER_0)), Sends(1))
    step = network.step(1, TOGETHER)
    assert logged(step) == [("offer", 0, EVERYONE, 2, False, "protocol")]
    assert [robot for robot, _ in network.radio.protocol_errors] == [0]
    assert step.delivered == []
    assert step.reports == []


def test_malformed_bytes_have_their_own_kind() -> None:
    step = network_of(Sends(0, (1, b"\xff\xff\xff")), Sends(1)).step(1, TOGETHER)
    assert step.rows[["kind", "packets", "bytes"]].tolist() == [(MALFORMED, 1, 3)]


@pytest.mark.parametrize("payload", [b"\xff", OFFER_0, TARGET_12 + TARGET_12, b"\x80\x01"])
def test_a_broadcast_other_than_one_target_is_refused(payload: bytes) -> None:
    network = network_of(Sends(0, broadcast=payload), Sends(1))
    step = network.step(1, TOGETHER)
    assert not step.rows["carried"].any()
    assert step.delivered == []
    assert network.radio.protocol_errors


def test_a_second_target_in_a_step_is_refused() -> None:
    class Insists(Sends):
        def opens(self, event: Open) -> list[RobotFrames]:
            return [RobotFrames(event.step, event.round, "offers", self.broadcast)]

    network = network_of(Insists(0, broadcast=TARGET_12), Sends(1), rounds=2)
    step = network.step(1, TOGETHER)
    assert logged(step) == [
        ("broadcast", 0, EVERYONE, 3, True, ""),
        ("broadcast", 0, EVERYONE, 3, False, "protocol"),
    ]


@pytest.mark.parametrize(
    "data", [b"\xff", b"\x80\x01", b"\xf2\x00", b"\xfc\x01", OFFER_0, TARGET_12, encode([Save()]) + b"\xd0"]
)
def test_malformed_data_is_logged_and_not_delivered(data: bytes) -> None:
    network = network_of(Sends(0, (1, OFFER_0), data=data), Sends(1))
    step = network.step(1, TOGETHER)
    refused = step.rows[step.rows["frame"] == DATA]
    assert int(refused["bytes"].sum()) == len(data)
    assert {CAUSES[cause] for cause in refused["cause"]} == {"protocol"}
    assert [frame for frame in step.delivered if frame.kind == "data"] == []
    assert network.radio.protocol_errors


def test_data_for_an_offer_that_was_not_answered_is_refused_and_logged() -> None:
    class Impatient(Sends):
        def reply_to(self, event: PhaseDelivery, deliveries: Sequence[Delivery]) -> list[OutgoingFrame]:
            (answer,) = deliveries
            return [OutgoingFrame(1, encode([Save()]), 1 - answer.connection)]

    class Choosy(Sends):
        def reply_to(self, event: PhaseDelivery, deliveries: Sequence[Delivery]) -> list[OutgoingFrame]:
            return super().reply_to(event, deliveries)[1:]

    network = network_of(Impatient(0, (1, OFFER_0), (1, encode([Offer(1, 0)]))), Choosy(1))
    step = network.step(1, TOGETHER)
    assert sorted(logged(step)) == [
        ("answer", 1, 0, 2, True, ""),
        ("data", 0, 1, 1, False, "protocol"),
        ("offer", 0, 1, 2, True, ""),
        ("offer", 0, 1, 2, True, ""),
    ]
    assert [reason for _, reason in network.radio.protocol_errors] == ["a frame of no connection of its own"]


@given(seeds, st.permutations([(peer, map_id) for peer in (1, 2) for map_id in (0, 1, 2)]))
def test_the_order_of_a_robot_s_offers_changes_nothing(seed: int, order: list[tuple[int, int]]) -> None:
    def played(pairs: list[Any]) -> list[Any]:
        offers = [(peer, encode([Offer(map_id, 0)])) for peer, map_id in pairs]
        robots = {0: Sends(0, *offers, data=encode(3 * [Delete(1)])), 1: Sends(1), 2: Sends(2)}
        network = Network(RadioSettings(3, seed, 10.0, Budget(20)), robots)
        rows: list[Any] = network.step(1, TOGETHER | {2: (1, 1)}).rows.tolist()
        return rows

    assert played(order) == played(sorted(order))


def test_frames_sent_while_the_medium_is_closed_are_logged_in_the_next_step() -> None:
    network = network_of(Sends(0, late=TARGET_12), Sends(1))
    assert logged(network.step(1, TOGETHER)) == []
    assert logged(network.step(2, TOGETHER)) == [("data", 0, EVERYONE, 3, False, "protocol")]


@pytest.mark.parametrize("robots", [1, 2, 3])
def test_a_step_without_frames_carries_nothing(robots: int) -> None:
    step = network_of(*map(Sends, range(robots))).step(1, {robot: (robot, 0) for robot in range(robots)})
    assert (step.carried, len(step.rows)) == (0, 0)


def test_a_step_without_living_robots_ends_at_once() -> None:
    step = network_of(Sends(0), Sends(1)).step(1, {})
    assert (step.carried, len(step.rows)) == (0, 0)


# Deaths.


@pytest.mark.parametrize("moment", range(40))
@pytest.mark.parametrize("victim", [0, 1])
def test_a_death_at_any_moment_stalls_no_robot_and_is_logged(victim: int, moment: int) -> None:
    data = encode([Save(), Save()])
    robots = [
        Sends(n, *((peer, encode([Offer(n, 0)])) for peer in range(3) if peer != n), data=data)
        for n in range(3)
    ]
    network = Network(RadioSettings(3, 7, 10.0), dict(enumerate(robots)))
    step = network.step(1, TOGETHER | {2: (1, 1)}, {victim: moment})
    assert set(step.closed) - network.dead == {0, 1, 2} - network.dead
    ((sent, carried, cut, received),) = balance(step.rows).values()
    assert sent == carried + cut == sum(len(payload) for _, payload in step.submitted)
    assert received == carried
    lost = step.rows[step.rows["cause"] == CAUSES.index("lost")]
    assert all(victim in (row["sender"], row["receiver"]) for row in lost)
    assert not (step.rows["cause"] == CAUSES.index("protocol")).any()
    assert not network.radio.protocol_errors


def test_data_for_a_robot_that_died_in_between_is_lost_and_uses_no_budget() -> None:
    network = network_of(Sends(0), Sends(1), budget=Budget(4))
    radio = network.radio
    radio.begin(1, {0: (0, 0), 1: (0, 1)})
    assert [robot for robot, _ in radio.events] == [0, 1]
    radio.submit(0, RobotFrames(1, 0, "offers", frames=[OutgoingFrame(1, OFFER_0)]))
    radio.submit(1, RobotFrames(1, 0, "offers"))
    radio.submit(1, RobotFrames(1, 0, "answers", frames=[OutgoingFrame(0, encode([Answer(0)]), 0)]))
    radio.lost(1)
    data = RobotFrames(1, 0, "data", frames=[OutgoingFrame(1, encode([Save()]), 0)])
    radio.events.clear()
    radio.submit(0, data)
    (to, ended), closed = radio.events
    assert (to, closed) == (0, (0, Close(1)))
    assert isinstance(ended, RoundReport)
    assert ended.connections == [ConnectionReport(0, 2, 2, 0)]
    (account,) = radio.accounts
    report = account.report()
    rows = np.frombuffer(report.rows, ROW)
    assert [CAUSES[cause] for cause in rows["cause"]] == ["", "", "lost"]
    assert report.carried == 4
