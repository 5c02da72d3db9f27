"""The medium against a slow model: packets go on the air one by one until one finds no room."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from netshaper.ledger import CAUSES, EVERYONE, ROW
from netshaper.medium import UNLIMITED, Connections, Medium
from protocol import packets
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
budgets = st.just(UNLIMITED) | st.integers(0, 600)

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


def play(medium: Medium, event: object) -> None:
    frames = [encode(said) for _, said in words_of(event)]
    if isinstance(event, bool):
        medium.broadcast(0, 0, frames[0], [1] if event else [])
    else:
        connections = Connections()
        connections.add([(0, 1, 0)], frames[:1])
        for said, frame in zip(connections.frames[1:], frames[1:], strict=False):
            said[0] = frame
        medium.play(0, connections)


def rows(medium: Medium) -> list[tuple[int, ...]]:
    """The ledger's rows of a step."""
    booked: list[tuple[int, ...]] = np.frombuffer(medium.report().rows, ROW).tolist()
    return booked


def carried_by_the_book(events_: list[object], budget: int) -> tuple[int, int]:
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
                if budget != UNLIMITED and carried + len(piece) > budget:
                    open_, broken = False, True
                    continue
                carried += len(piece)
    return said, carried


@given(events, budgets)
def test_the_medium_carries_what_the_slow_model_carries(events_: list[object], budget: int) -> None:
    medium = Medium(1, budget)
    for event in events_:
        play(medium, event)
    said, carried = carried_by_the_book(events_, budget)
    assert medium.carried == carried
    assert sum(row[9] for row in rows(medium) if row[10]) == carried
    assert sum(row[9] for row in rows(medium)) == said
    if budget != UNLIMITED:
        assert carried <= budget
        assert 0 <= medium.left <= budget - carried


@given(events, budgets)
def test_rows_count_packets_kind_by_kind(events_: list[object], budget: int) -> None:
    medium = Medium(1, budget)
    for event in events_:
        play(medium, event)
    words = [packet for event in events_ for _, said in words_of(event) for packet in said]
    for number, kind in enumerate(packets.ALL_KINDS):
        these = [row for row in rows(medium) if row[7] == number]
        assert sum(row[8] for row in these) == sum(packet.name == kind for packet in words)


def test_a_broadcast_is_booked_with_the_number_of_those_who_heard_it() -> None:
    medium = Medium(3, 10)
    assert medium.broadcast(0, 2, encode([Target(1, 2)]), [0, 1, 4])
    assert rows(medium) == [(3, 0, -1, 3, 2, EVERYONE, -1, packets.ALL_KINDS.index("targ"), 1, 3, 1, 0, 3)]


def test_a_refused_frame_costs_nothing() -> None:
    medium = Medium(1, 10)
    medium.refuse(0, 0, 1, 2, encode([Offer(0, 0)]), "range", "")
    assert (medium.left, medium.carried) == (10, 0)
    assert [CAUSES[row[11]] for row in rows(medium)] == ["range"]
