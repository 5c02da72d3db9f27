"""The medium against a slow model that sends packet by packet until one exceeds the budget."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from netshaper.admission import content_of
from netshaper.frame_log import Connection, Frame
from netshaper.ledger import BROADCAST, CAUSES, EVERYONE, OFFER, ROW
from netshaper.medium import Medium
from netshaper.settings import RadioSettings
from protocol import packets
from protocol.budget import UNLIMITED, Budget
from protocol.packet_codec import encode
from protocol.packets import Answer, Block, Delete, Fragment, Insert, Offer, Packet, Save, Target

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

Frames = list[tuple[str, list[Packet]]]


def frames_of(event: object) -> Frames:
    """The frames of an event: kind and packets."""
    if isinstance(event, bool):
        return [("target", [Target(1, 2)])]
    assert isinstance(event, tuple)
    answer, sent = event
    content: Frames = [("offer", [Offer(0, 0)])]
    if answer is not None:
        content.append(("answer", answer))
        if sent is not None:
            content.append(("data", sent))
    return content


def a_medium(budget: Budget, step: int = 1) -> Medium:
    medium = Medium(RadioSettings(5, 0, 10.0, budget))
    medium.begin_step(step, {})
    return medium


def play(medium: Medium, event: object) -> None:
    frames = [encode(packets_) for _, packets_ in frames_of(event)]
    if isinstance(event, bool):
        frame = Frame(0, EVERYONE, content_of(BROADCAST, frames[0]))
        medium.carry(frame, [1] if event else [])
    else:
        ends = ((0, 1), (1, 0), (0, 1))
        sent = [
            Frame(*ends[kind], content_of(kind, payload), connection=0) for kind, payload in enumerate(frames)
        ]
        medium.play(Connection(0, sent))


def rows(medium: Medium) -> list[tuple[int, ...]]:
    """The ledger's rows of a step."""
    logged: list[tuple[int, ...]] = np.frombuffer(medium.close().report().rows, ROW).tolist()
    return logged


def carried_by_the_book(events_: list[object], budget: Budget) -> tuple[int, int]:
    """Bytes submitted and carried: handshakes and targets are sent whole, data packet by packet."""
    submitted = carried = 0
    open_ = True
    for event in events_:
        broken = False
        for kind, content in frames_of(event):
            pieces = [encode([packet]) for packet in content] if kind == "data" else [encode(content)]
            for piece in pieces:
                submitted += len(piece)
                if broken or not open_:
                    continue
                if not budget.fits(carried + len(piece)):
                    open_, broken = False, True
                    continue
                carried += len(piece)
    return submitted, carried


@given(events, budgets)
def test_the_medium_carries_what_the_slow_model_carries(events_: list[object], budget: Budget) -> None:
    medium = a_medium(budget)
    for event in events_:
        play(medium, event)
    submitted, carried = carried_by_the_book(events_, budget)
    assert medium.carried == carried
    assert budget.fits(carried)
    left = medium.airtime.shared(0)
    assert left == budget.minus(carried) or left.spent
    logged = rows(medium)
    assert sum(row[9] for row in logged if row[10]) == carried
    assert sum(row[9] for row in logged) == submitted


@given(events, budgets)
def test_rows_count_packets_kind_by_kind(events_: list[object], budget: Budget) -> None:
    medium = a_medium(budget)
    for event in events_:
        play(medium, event)
    content = [packet for event in events_ for _, submitted in frames_of(event) for packet in submitted]
    logged = rows(medium)
    for number, kind in enumerate(packets.ALL_KINDS):
        these = [row for row in logged if row[7] == number]
        assert sum(row[8] for row in these) == sum(packet.name == kind for packet in content)


def test_a_broadcast_is_logged_with_its_number_of_receivers() -> None:
    medium = a_medium(Budget(10), step=3)
    assert medium.carry(Frame(2, EVERYONE, content_of(BROADCAST, encode([Target(1, 2)]))), [0, 1, 4])
    assert rows(medium) == [(3, 0, -1, 3, 2, EVERYONE, -1, packets.ALL_KINDS.index("targ"), 1, 3, 1, 0, 3)]


def test_a_refused_frame_costs_nothing() -> None:
    medium = a_medium(Budget(10))
    medium.refuse(Frame(1, 2, content_of(OFFER, encode([Offer(0, 0)]))), "range")
    assert (medium.airtime.shared(1), medium.carried) == (Budget(10), 0)
    assert [CAUSES[row[11]] for row in rows(medium)] == ["range"]
