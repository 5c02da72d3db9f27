"""The medium against a slow model: packets go on the air one by one until one finds no room."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from netshaper.connections import Connections
from netshaper.frame_log import Frame, index_or_none
from netshaper.ledger import BROADCAST, CAUSES, EVERYONE, OFFER, ROW
from netshaper.medium import Medium
from netshaper.settings import RadioSettings
from protocol import packets
from protocol.budget import UNLIMITED, Budget
from protocol.packets import Answer, Block, Delete, Fragment, Insert, Offer, Packet, Save, Target, encode

data = st.lists(
    st.sampled_from([Save(), Delete(7), Insert(1, 2, 3, 0, 1), Fragment(bytes(63)), Fragment(bytes(5))]),
    min_size=1,
    max_size=10,
)
answers: list[list[Packet]] = [[Answer(3)], [Block(1), Answer(3)]]
connections = st.tuples(st.sampled_from(answers) | st.none(), data | st.none())
targets = st.booleans()
events = st.lists(connections | targets, max_size=10)
budgets = st.just(UNLIMITED) | st.builds(Budget, st.integers(0, 600))

Words = list[tuple[str, list[Packet]]]


def words_of(event: object) -> Words:
    """What an event says, frame by frame."""
    if isinstance(event, bool):
        return [("target", [Target(1, 2)])]
    assert isinstance(event, tuple)
    answer, sent = event
    words: Words = [("offer", [Offer(0, 0)])]
    if answer is not None:
        words.append(("answer", answer))
        if sent is not None:
            words.append(("data", sent))
    return words


def a_medium(budget: Budget, step: int = 1) -> Medium:
    medium = Medium(RadioSettings(5, 0, 10.0, budget))
    medium.begin_step(step, {})
    return medium


def frame(kind: int, sender: int, receiver: int, payload: bytes) -> Frame:
    return Frame(kind, sender, receiver, payload, index_or_none(payload), 0 if kind == OFFER else -1)


def play(medium: Medium, event: object) -> None:
    frames = [encode(packets_) for _, packets_ in words_of(event)]
    if isinstance(event, bool):
        medium.broadcast(frame(BROADCAST, 0, EVERYONE, frames[0]), [1] if event else [])
    else:
        connections = Connections(0, [frame(OFFER, 0, 1, frames[0])])
        for kind, payload in enumerate(frames[1:], 1):
            connections.frames[kind][0] = frame(kind, 0, 1, payload)
        medium.play(connections)


def rows(medium: Medium) -> list[tuple[int, ...]]:
    """The ledger's rows of a step."""
    booked: list[tuple[int, ...]] = np.frombuffer(medium.close().report().rows, ROW).tolist()
    return booked


def carried_by_the_book(events_: list[object], budget: Budget) -> tuple[int, int]:
    """Bytes said and carried: handshakes and targets go whole, data packet by packet."""
    said = carried = 0
    open_ = True
    for event in events_:
        broken = False
        for kind, words in words_of(event):
            pieces = [encode([packet]) for packet in words] if kind == "data" else [encode(words)]
            for piece in pieces:
                said += len(piece)
                if broken or not open_:
                    continue
                if not budget.fits(carried + len(piece)):
                    open_, broken = False, True
                    continue
                carried += len(piece)
    return said, carried


@given(events, budgets)
def test_the_medium_carries_what_the_slow_model_carries(events_: list[object], budget: Budget) -> None:
    medium = a_medium(budget)
    for event in events_:
        play(medium, event)
    said, carried = carried_by_the_book(events_, budget)
    assert medium.carried == carried
    assert budget.fits(carried)
    left = medium.airtime.shared(0)
    assert left == budget.minus(carried) or left.spent
    booked = rows(medium)
    assert sum(row[9] for row in booked if row[10]) == carried
    assert sum(row[9] for row in booked) == said


@given(events, budgets)
def test_rows_count_packets_kind_by_kind(events_: list[object], budget: Budget) -> None:
    medium = a_medium(budget)
    for event in events_:
        play(medium, event)
    words = [packet for event in events_ for _, said in words_of(event) for packet in said]
    booked = rows(medium)
    for number, kind in enumerate(packets.ALL_KINDS):
        these = [row for row in booked if row[7] == number]
        assert sum(row[8] for row in these) == sum(packet.name == kind for packet in words)


def test_a_broadcast_is_booked_with_the_number_of_those_who_heard_it() -> None:
    medium = a_medium(Budget(10), step=3)
    assert medium.broadcast(frame(BROADCAST, 2, EVERYONE, encode([Target(1, 2)])), [0, 1, 4])
    assert rows(medium) == [(3, 0, -1, 3, 2, EVERYONE, -1, packets.ALL_KINDS.index("targ"), 1, 3, 1, 0, 3)]


def test_a_refused_frame_costs_nothing() -> None:
    medium = a_medium(Budget(10))
    medium.refuse(frame(OFFER, 1, 2, encode([Offer(0, 0)])), "range")
    assert (medium.airtime.shared(1), medium.carried) == (Budget(10), 0)
    assert [CAUSES[row[11]] for row in rows(medium)] == ["range"]
