"""The radio: budget, order and books, with robots that keep to the protocol, lie, say nothing, or die."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netshaper.ledger import CAUSES, EVERYONE, KIND_NUMBER, MALFORMED, ROW, balance
from netshaper.medium import ANSWER, BROADCAST, DATA, OFFER, UNLIMITED, Medium
from netshaper.radio import Note, RadioSettings
from protocol import packet_index, packets
from protocol.messages import Close, Open, Outcome, PhaseDelivery, Said
from protocol.packets import Answer, Decline, Delete, Offer, Save, Target, encode
from tests.netshaper.scenes import gossip, play, scenes, seeds
from tests.netshaper.scripted_robots import Air, Heard, Liar, Mute, Put, Robot, Step

either = st.one_of(scenes(), gossip())


def unicast_data(step: Step) -> Any:
    return (step.rows["frame"] == DATA) & (step.rows["carried"] == 1)


@given(either)
def test_no_step_carries_more_than_its_budget(scene: Any) -> None:
    budget = scene[0].budget
    for step in play(scene):
        carried = step.bytes_where(step.rows["carried"] == 1)
        assert carried == step.carried
        assert budget == UNLIMITED or carried <= budget


@given(either)
def test_every_byte_that_was_said_is_booked_once_carried_or_cut(scene: Any) -> None:
    settings, robots, cells, deaths = scene
    # A last step in which nobody lives books what was said after the one before had closed.
    steps = play((settings, robots, [*cells, {}], [*deaths, {}]))
    said: Counter[int] = Counter()
    booked: Counter[int] = Counter()
    for step in steps:
        for sender, _, payload in step.said:
            said[sender] += len(payload)
        for row in step.rows:
            booked[int(row["sender"])] += int(row["bytes"])
        for whole, carried, cut, _ in balance(step.rows).values():
            assert whole == carried + cut
    assert +said == +booked


@given(scenes())
def test_what_is_carried_to_one_robot_is_heard_by_it_and_by_nobody_else(scene: Any) -> None:
    for step in play(scene):
        for _, carried, _, heard in balance(step.rows).values():
            broadcast = (step.rows["receiver"] == EVERYONE) & (step.rows["carried"] == 1)
            assert heard == carried - step.bytes_where(broadcast)
        booked: Counter[tuple[int, int]] = Counter()
        for row in step.rows[unicast_data(step)]:
            booked[int(row["sender"]), int(row["receiver"])] += int(row["bytes"])
        delivered: Counter[tuple[int, int]] = Counter()
        for kind, frame in step.delivered:
            if kind == "data":
                delivered[frame.sender, frame.receiver] += len(frame.payload)
        assert delivered == booked


@given(scenes())
def test_a_broadcast_counts_once_whoever_hears_it(scene: Any) -> None:
    for step in play(scene, deadly=False):
        rows = step.rows[(step.rows["frame"] == BROADCAST) & (step.rows["carried"] == 1)]
        assert (rows["bytes"] == 3).all()
        assert (rows["packets"] == 1).all()
        assert len(set(rows["sender"].tolist())) == len(rows)
        heard = Counter(frame.sender for kind, frame in step.delivered if kind == "targets")
        assert heard == +Counter(dict(rows[["sender", "received_by"]].tolist()))


@given(scenes())
def test_the_first_packet_that_finds_no_room_closes_the_medium(scene: Any) -> None:
    budget = scene[0].budget
    for step in play(scene):
        admitted = step.rows[(step.rows["carried"] == 1) | (step.rows["cause"] == CAUSES.index("budget"))]
        cut = np.flatnonzero(admitted["carried"] == 0)
        if budget == UNLIMITED:
            assert not len(cut)
        elif len(cut):
            assert not admitted["carried"][cut[0] :].any()


@given(
    scenes(st.lists(st.sampled_from((Robot, Robot, Mute)), min_size=1, max_size=6)) | gossip(honest=True),
    seeds,
    seeds,
)
def test_the_order_in_which_the_relay_reads_robots_changes_nothing(scene: Any, one: int, other: int) -> None:
    for first, second in zip(play(scene, one, False), play(scene, other, False), strict=True):
        assert first.rows.tolist() == second.rows.tolist()
        assert sorted(first.outcomes, key=_by_robot) == sorted(second.outcomes, key=_by_robot)


def _by_robot(outcome: tuple[int, Outcome]) -> tuple[int, int]:
    return outcome[0], outcome[1].round


@given(scenes())
def test_a_receiver_hears_its_offers_in_the_order_in_which_they_are_played(scene: Any) -> None:
    for step in play(scene):
        for receiver, turn, heard in step.turns:
            assert turn.connections == sorted(turn.connections)
            for (peer, payload), map_id in zip(heard, turn.maps, strict=True):
                assert peer != receiver
                if turn.phase == "offers":
                    assert packets.decode(payload)[0].map == map_id  # type: ignore[union-attr]
        played = step.rows[(step.rows["connection"] >= 0)]["connection"].tolist()
        assert played == sorted(played)


@given(scenes())
def test_both_ends_of_a_connection_are_told_the_same(scene: Any) -> None:
    for step in play(scene):
        told: dict[int, set[tuple[int, int, int]]] = {}
        for _, outcome in step.outcomes:
            for number, *carried in zip(
                outcome.connections, outcome.offers, outcome.answers, outcome.data, strict=True
            ):
                told.setdefault(number, set()).add((carried[0], carried[1], carried[2]))
        for number, versions in told.items():
            rows = step.rows[(step.rows["connection"] == number) & (step.rows["carried"] == 1)]
            booked = tuple(
                int(rows["bytes"][rows["frame"] == frame].sum()) for frame in (OFFER, ANSWER, DATA)
            )
            assert versions == {booked}


@given(scenes())
def test_what_was_cut_was_cut_between_packets(scene: Any) -> None:
    for step in play(scene):
        for kind, frame in step.delivered:
            if kind == "data":
                assert packet_index.split(frame.payload)


@given(scenes())
def test_a_robot_out_of_range_hears_nothing(scene: Any) -> None:
    settings, _, cells, _ = scene
    for where, step in zip(cells, play(scene), strict=True):
        for _, frame in step.delivered:
            (ax, ay), (bx, by) = where[frame.sender], where[frame.receiver]
            assert math.hypot(ax - bx, ay - by) <= settings.range_cells
        far = step.rows[step.rows["cause"] == CAUSES.index("range")]
        assert not far["carried"].any()
        assert not far["received_by"].any()


@given(scenes())
def test_everyone_who_lives_is_told_of_every_exchange_while_the_medium_is_open_and_of_the_end(
    scene: Any,
) -> None:
    settings, robots, cells, deaths = scene
    air = Air(settings, robots)
    for at, where in enumerate(cells):
        step = air.step(at + 1, where, deaths[at])
        assert set(step.closed) - air.dead == set(where) - air.dead
        for robot in step.closed:
            opened = [note.round for number, note in step.opened if number == robot]
            assert opened == list(range(len(opened)))
            closed = settings.budget == step.carried or CAUSES.index("budget") in step.rows["cause"]
            assert len(opened) == (settings.rounds if settings.robots > 1 else 0) or closed


@given(scenes(st.lists(st.sampled_from((Robot, Robot, Liar, Liar)), min_size=2, max_size=6)))
def test_who_lies_harms_nobody_who_does_not(scene: Any) -> None:
    settings, robots, cells, _ = scene
    settings = replace(settings, budget=UNLIMITED)
    byzantine = {number for number, robot in robots.items() if isinstance(robot, Liar)}
    silent = {n: Quiet(n, len(robots), 0) if n in byzantine else robot for n, robot in robots.items()}
    none: list[Any] = [{} for _ in cells]
    for first, second in zip(
        play((settings, robots, cells, none)), play((settings, silent, cells, none)), strict=True
    ):
        assert _among(first, byzantine) == _among(second, byzantine)


class Quiet(Robot):
    """A robot that takes part and has nothing to say."""

    def opens(self, note: Open) -> list[Put | Said]:
        return [Said(note.step, note.round, "offers", [])]

    def answer(self, _rng: np.random.Generator) -> bytes:
        return encode([Decline()])


def _among(step: Step, without: set[int]) -> list[Any]:
    """What the others said to each other, but for the numbers of connections, which count everyone's."""
    rows = step.rows[~np.isin(step.rows["sender"], [*without])]
    rows = rows[~np.isin(rows["receiver"], [*without])]
    return sorted((row[1], *row[3:]) for row in rows.tolist())


# Scenes by hand.


def air_of(*robots: Robot, budget: int = UNLIMITED, range_cells: float = 10.0, rounds: int = 1) -> Air:
    settings = RadioSettings(len(robots), 7, range_cells, budget, rounds)
    return Air(settings, dict(enumerate(robots)))


class Says(Robot):
    """A robot that opens with given frames, answers `Answer(0)` and sends given data for each answer."""

    def __init__(self, number: int, *opening: Put, data: bytes = b"", late: bytes = b"") -> None:
        super().__init__(number, 2, 0)
        self.opening = list(opening)
        self.sends = data
        self.late = late

    def opens(self, note: Open) -> list[Put | Said]:
        return [*(self.opening if note.round == 0 else []), Said(note.step, note.round, "offers", [])]

    def answer(self, _rng: np.random.Generator) -> bytes:
        return encode([Answer(0)])

    def data(self, _rng: np.random.Generator, _answer: bytes) -> bytes:
        return self.sends

    def rests(self, _note: Any) -> list[Put | Said]:
        return [(EVERYONE, self.late)] if self.late else []


OFFER_0 = encode([Offer(0, 0)])
TARGET_12 = encode([Target(1, 2)])
TOGETHER = {0: (0, 0), 1: (3, 4)}


def booked(step: Step) -> list[tuple[str, int, int, int, bool, str]]:
    """Rows as (frame, sender, receiver, bytes, carried, cause)."""
    frames = ("offer", "answer", "data", "broadcast")
    return [
        (frames[frame], sender, receiver, size, bool(carried), CAUSES[cause])
        for frame, sender, receiver, size, carried, cause in step.rows[
            ["frame", "sender", "receiver", "bytes", "carried", "cause"]
        ].tolist()
    ]


def test_a_connection_puts_its_offer_its_answer_and_its_data_on_the_air() -> None:
    step = air_of(Says(0, (1, OFFER_0), data=encode([Save(), Save()])), Says(1)).step(1, TOGETHER)
    assert booked(step) == [
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
    robots = Says(0, (EVERYONE, TARGET_12), (1, OFFER_0), data=data), Says(1)
    step = air_of(*robots, budget=budget).step(1, TOGETHER)
    by_frame = [
        step.bytes_where((step.rows["carried"] == 1) & (step.rows["frame"] == frame)) for frame in range(4)
    ]
    assert (by_frame[BROADCAST], by_frame[OFFER], by_frame[ANSWER], by_frame[DATA]) == carried
    assert step.bytes_where(step.rows["carried"] == 0) == 11 - sum(carried)
    (_, outcome), (_, other) = step.outcomes
    assert (outcome.offers, outcome.answers, outcome.data) == ([carried[1]], [carried[2]], [carried[3]])
    assert outcome.broadcast == (carried[0] > 0)
    assert other.heard == ([0] if carried[3] else [])


def test_once_closed_the_medium_stays_closed_for_smaller_frames_and_later_exchanges() -> None:
    robots = Says(0, (1, OFFER_0), data=encode([packets.Fragment(bytes(63))])), Says(1, (0, OFFER_0))
    step = air_of(*robots, budget=50, rounds=2).step(1, TOGETHER)
    assert [note.round for number, note in step.opened if number == 0] == [0]
    cut = step.rows["carried"].tolist().index(0)
    assert not step.rows["carried"][cut:].any()


def test_a_later_exchange_has_what_is_left_of_the_budget() -> None:
    robots = Says(0, (1, OFFER_0), data=encode([Save()])), Says(1)
    step = air_of(*robots, budget=50, rounds=3).step(1, TOGETHER)
    assert [note.budget for number, note in step.opened if number == 0] == [50, 45, 45]


def test_the_next_step_has_its_whole_budget_again() -> None:
    air = air_of(Says(0, (1, OFFER_0), data=bytes(0)), Says(1), budget=4)
    assert [air.step(number, TOGETHER).carried for number in (1, 2, 3)] == [4, 4, 4]


def test_a_target_is_heard_by_all_in_range_and_booked_once() -> None:
    step = air_of(Says(0, (EVERYONE, TARGET_12)), Says(1), Says(2), range_cells=5.0).step(
        1, {0: (0, 0), 1: (3, 4), 2: (4, 4)}
    )
    assert booked(step) == [("broadcast", 0, EVERYONE, 3, True, "")]
    assert step.rows["received_by"].tolist() == [1]
    assert [frame.receiver for _, frame in step.delivered] == [1]


def test_a_target_that_nobody_hears_is_on_the_air_all_the_same() -> None:
    step = air_of(Says(0, (EVERYONE, TARGET_12)), Says(1), range_cells=1.0).step(1, TOGETHER)
    assert booked(step) == [("broadcast", 0, EVERYONE, 3, True, "")]
    assert step.rows["received_by"].tolist() == [0]


def test_a_frame_to_a_robot_out_of_range_is_booked_and_not_passed_on() -> None:
    step = air_of(Says(0, (1, OFFER_0)), Says(1), range_cells=4.9).step(1, TOGETHER)
    assert booked(step) == [("offer", 0, 1, 2, False, "range")]
    assert step.delivered == []


@pytest.mark.parametrize("receiver", [0, 2, 63, -99])
def test_a_frame_to_oneself_or_to_nobody_is_out_of_range(receiver: int) -> None:
    step = air_of(Says(0, (receiver, OFFER_0)), Says(1)).step(1, {0: (0, 0), 1: (0, 1)})
    assert booked(step) == [("offer", 0, receiver, 2, False, "range")]


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
def test_an_offer_that_is_none_is_booked_with_its_cause_and_reported(payload: bytes) -> None:
    air = air_of(Says(0, (1, payload)), Says(1))
    step = air.step(1, TOGETHER)
    assert {
        (sender, receiver, carried, cause) for _, sender, receiver, _, carried, cause in booked(step)
    } == {(0, 1, False, "protocol")}
    assert step.bytes_where(step.rows["bytes"] > 0) == len(payload)
    assert step.delivered == []
    assert [robot for robot, _ in air.radio.faults] == [0]


def test_a_map_is_offered_to_a_robot_once_an_exchange() -> None:
    air = air_of(Says(0, (1, OFFER_0), (1, encode([Offer(0, 3)])), (1, encode([Offer(1, 0)]))), Says(1))
    step = air.step(1, TOGETHER)
    offers = sorted(row for row in booked(step) if row[0] == "offer")
    assert offers == [
        ("offer", 0, 1, 2, False, "protocol"),
        ("offer", 0, 1, 2, True, ""),
        ("offer", 0, 1, 2, True, ""),
    ]
    assert [robot for robot, _ in air.radio.faults] == [0]


def test_bytes_that_are_no_packets_have_a_kind_of_their_own() -> None:
    step = air_of(Says(0, (1, b"\xff\xff\xff")), Says(1)).step(1, TOGETHER)
    assert step.rows[["kind", "packets", "bytes"]].tolist() == [(MALFORMED, 1, 3)]


@pytest.mark.parametrize("payload", [b"\xff", OFFER_0, TARGET_12 + TARGET_12, b"\x80\x01", b""])
def test_a_broadcast_of_anything_but_one_target_is_refused(payload: bytes) -> None:
    air = air_of(Says(0, (EVERYONE, payload)), Says(1))
    step = air.step(1, TOGETHER)
    assert not step.rows["carried"].any()
    assert step.delivered == []
    assert air.radio.faults


def test_a_second_target_in_a_step_is_refused() -> None:
    step = air_of(Says(0, (EVERYONE, TARGET_12), (EVERYONE, TARGET_12)), Says(1)).step(1, TOGETHER)
    assert sorted(booked(step)) == [
        ("broadcast", 0, EVERYONE, 3, False, "protocol"),
        ("broadcast", 0, EVERYONE, 3, True, ""),
    ]


@pytest.mark.parametrize(
    "data", [b"\xff", b"\x80\x01", b"\xf2\x00", b"\xfc\x01", OFFER_0, TARGET_12, encode([Save()]) + b"\xd0"]
)
def test_data_that_is_malformed_or_no_data_is_booked_and_passed_on_to_nobody(data: bytes) -> None:
    air = air_of(Says(0, (1, OFFER_0), data=data), Says(1))
    step = air.step(1, TOGETHER)
    refused = step.rows[step.rows["frame"] == DATA]
    assert int(refused["bytes"].sum()) == len(data)
    assert {CAUSES[cause] for cause in refused["cause"]} == {"protocol"}
    assert [kind for kind, _ in step.delivered if kind == "data"] == []
    assert air.radio.faults


def test_data_for_an_offer_that_was_not_answered_is_refused_and_booked() -> None:
    class Impatient(Says):
        def takes_turn(self, note: PhaseDelivery, heard: Heard) -> list[Put | Said]:
            (number,) = note.connections
            return [(1, encode([Save()])), Said(note.step, note.round, "data", [1 - number])]

    class Choosy(Says):
        def takes_turn(self, note: PhaseDelivery, heard: Heard) -> list[Put | Said]:
            return [*super().takes_turn(note, heard)[1:-1], Said(note.step, note.round, "answers", [1])]

    air = air_of(Impatient(0, (1, OFFER_0), (1, encode([Offer(1, 0)]))), Choosy(1))
    step = air.step(1, TOGETHER)
    assert sorted(booked(step)) == [
        ("answer", 1, 0, 2, True, ""),
        ("data", 0, 1, 1, False, "protocol"),
        ("offer", 0, 1, 2, True, ""),
        ("offer", 0, 1, 2, True, ""),
    ]
    assert [reason for _, reason in air.radio.faults] == ["a frame of no connection of its own"]


@given(seeds, st.permutations([(peer, map_id) for peer in (1, 2) for map_id in (0, 1, 2)]))
def test_the_order_in_which_a_robot_says_its_offers_changes_nothing(seed: int, order: list[Put]) -> None:
    def played(pairs: list[Any]) -> list[Any]:
        offers = [(peer, encode([Offer(map_id, 0)])) for peer, map_id in pairs]
        robots = {0: Says(0, *offers, data=encode(3 * [Delete(1)])), 1: Says(1), 2: Says(2)}
        air = Air(RadioSettings(3, seed, 10.0, 20), robots)
        rows: list[Any] = air.step(1, TOGETHER | {2: (1, 1)}).rows.tolist()
        return rows

    assert played(order) == played(sorted(order))


def test_what_is_said_while_the_medium_is_closed_is_booked_in_the_next_step() -> None:
    air = air_of(Says(0, late=TARGET_12), Says(1))
    assert booked(air.step(1, TOGETHER)) == []
    assert booked(air.step(2, TOGETHER)) == [("data", 0, EVERYONE, 3, False, "protocol")]


@pytest.mark.parametrize("robots", [1, 2, 3])
def test_a_step_without_words_carries_nothing(robots: int) -> None:
    step = air_of(*map(Says, range(robots))).step(1, {robot: (robot, 0) for robot in range(robots)})
    assert (step.carried, len(step.rows)) == (0, 0)


def test_a_step_in_which_nobody_lives_ends_at_once() -> None:
    step = air_of(Says(0), Says(1)).step(1, {})
    assert (step.carried, len(step.rows)) == (0, 0)


# Deaths.


@pytest.mark.parametrize("moment", range(40))
@pytest.mark.parametrize("victim", [0, 1])
def test_a_death_at_any_moment_stalls_nobody_and_is_booked(victim: int, moment: int) -> None:
    data = encode([Save(), Save()])
    robots = [
        Says(n, *((peer, encode([Offer(n, 0)])) for peer in range(3) if peer != n), data=data)
        for n in range(3)
    ]
    air = Air(RadioSettings(3, 7, 10.0), dict(enumerate(robots)))
    step = air.step(1, TOGETHER | {2: (1, 1)}, {victim: moment})
    assert set(step.closed) - air.dead == {0, 1, 2} - air.dead
    ((said, carried, cut, heard),) = balance(step.rows).values()
    assert said == carried + cut == sum(len(payload) for _, _, payload in step.said)
    assert heard == carried
    lost = step.rows[step.rows["cause"] == CAUSES.index("lost")]
    assert all(victim in (row["sender"], row["receiver"]) for row in lost)
    assert not (step.rows["cause"] == CAUSES.index("protocol")).any()
    assert not air.radio.faults


def test_data_for_a_robot_that_died_in_between_is_lost_and_costs_nothing() -> None:
    air = air_of(Says(0), Says(1), budget=4)
    outgoing = air.radio.begin(1, {0: (0, 0), 1: (0, 1)})
    assert len(outgoing) == 2
    air.radio.said(0, Said(1, 0, "offers", [], 0, [1], [OFFER_0]))
    air.radio.said(1, Said(1, 0, "offers", []))
    air.radio.said(1, Said(1, 0, "answers", [0], 0, [0], [encode([Answer(0)])]))
    air.radio.lost(1)
    outcome, close, medium = air.radio.said(0, Said(1, 0, "data", [0], 0, [1], [encode([Save()])]))
    assert isinstance(outcome, Note) and isinstance(close, Note) and isinstance(medium, Medium)
    assert (outcome.receiver, close) == (0, Note(0, Close(1)))
    assert isinstance(outcome.message, Outcome)
    assert outcome.message.data == [0]
    report = medium.report()
    rows = np.frombuffer(report.rows, ROW)
    assert [CAUSES[cause] for cause in rows["cause"]] == ["", "", "lost"]
    assert report.carried == 4
