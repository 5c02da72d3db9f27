"""Logs, frame builders, and the tables of neighbors: the parts that know nothing of each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.replication.control_packets import parse
from agent.replication.frame_builder import FrameBuilder
from agent.replication.log import Log
from agent.replication.neighbors import BroadcastCursors, Neighbors
from agent.replication.peers import map_ids
from agent.replication.replica import Replica
from protocol.errors import ProtocolError
from protocol.packets import FromEarly, Held, Near, encode
from tests.agent.replication.network import entries, entry

sizes = st.lists(st.integers(1, 30), max_size=12)


def log_of(*lengths: int) -> tuple[Log, list[bytes]]:
    log, units = Log(), [bytes([number]) * size for number, size in enumerate(lengths)]
    log.append(units)
    return log, units


@given(sizes, st.data())
def test_a_log_returns_the_entries_that_fit_from_an_offset(lengths: list[int], data: st.DataObject) -> None:
    log, units = log_of(*lengths)
    log.truncate(data.draw(st.integers(0, len(units) + 3)))
    first = data.draw(st.integers(log.start, len(units)))
    budget = data.draw(st.none() | st.integers(0, 200))
    got = log.read(first, budget)
    after = log.offset_after(first, len(got))
    assert len(log) == len(units)
    assert got == b"".join(units[first:after])
    if budget is None:
        assert after == len(units)
    else:
        assert len(got) <= budget
        assert after == len(units) or len(got) + lengths[after] > budget
    end = data.draw(st.integers(first, len(units)))
    assert log.read(first, budget, end) == b"".join(units[first : min(end, after)])


@given(sizes, st.data())
def test_entries_are_retracted_unless_they_are_shared_or_truncated(
    lengths: list[int], data: st.DataObject
) -> None:
    log, units = log_of(*lengths)
    log.truncate(data.draw(st.integers(0, len(units))))
    count, shared = data.draw(st.integers(0, len(units))), data.draw(st.integers(0, len(units)))
    possible = len(units) - count >= max(shared, log.start)
    assert log.retract(count, shared) == possible
    left = len(units) - count if possible else len(units)
    log.append(units)
    assert log.read(log.start, None) == b"".join(units[log.start : left] + units)
    assert len(log) == left + len(units)


def test_a_builder_stops_at_the_budget_and_a_shorter_packet_still_fits() -> None:
    builder = FrameBuilder(4)
    long, short = encode([Held(1, 300)]), encode([Near(1)])
    assert not builder.fits(long)
    for _ in range(2):
        assert builder.fits(short)
        builder.add(short, lambda: None)
    assert not builder.fits(short)
    assert builder.payload == short + short


@pytest.mark.parametrize(
    ("budget", "first", "end", "payload", "after"),
    [(7, 0, 3, b"--abcde", 2), (4, 0, 3, b"", 0), (9, 2, 2, b"", 2), (None, 1, 3, b"--defghi", 3)],
)
def test_entries_go_in_as_far_as_they_fit_and_no_header_stands_alone(
    budget: int | None, first: int, end: int, payload: bytes, after: int
) -> None:
    log = Log()
    log.append([b"abc", b"de", b"fghi"])
    builder = FrameBuilder(budget)
    assert builder.add_entries(log, first, end, b"--", lambda *_: None) == after
    assert builder.payload == payload


@pytest.mark.parametrize(
    ("sent", "expected"),
    [
        (0, []),
        (2, ["near"]),
        (4, ["near"]),
        (7, ["near", (0, 1)]),
        (9, ["near", (0, 2)]),
        (12, ["near", (0, 2)]),
        (16, ["near", (0, 2), (2, 3)]),
    ],
)
def test_handlers_run_for_the_parts_that_were_on_the_air(sent: int, expected: list[object]) -> None:
    log = Log()
    log.append([b"abc", b"de", b"fghi"])
    ran: list[object] = []
    builder = FrameBuilder()
    builder.add(b"nn", lambda: ran.append("near"))
    builder.add_entries(log, 0, 2, b"--", lambda first, end: ran.append((first, end)))
    builder.add_entries(log, 2, 3, b"---", lambda first, end: ran.append((first, end)))
    builder.sent(sent)
    assert ran == expected


def test_a_frame_is_split_into_control_packets_and_entries_behind_their_headers() -> None:
    own, others = entries(0, 0, 2), entries(1, 5, 8)
    controls, sections = parse(
        encode([Near(1)]) + b"".join(own) + encode([FromEarly(1, 5)]) + b"".join(others)
    )
    assert controls == [Near(1), FromEarly(1, 5)]
    assert sections == [(None, own), (FromEarly(1, 5), others)]
    with pytest.raises(ProtocolError):
        parse(b"\xff")


def test_all_robots_are_neighbors_until_they_report_otherwise() -> None:
    neighbors = Neighbors(0, 4)
    assert neighbors.news([1, 2, 3]) == []
    assert np.flatnonzero(neighbors.receivers(2)).tolist() == [1, 3]
    neighbors.near[2, 3] = False
    assert np.flatnonzero(neighbors.receivers(2)).tolist() == [1]
    assert neighbors.near[3, 2]
    assert not neighbors.near[2, 3]


def test_a_departure_is_news_until_all_in_range_received_it() -> None:
    neighbors = Neighbors(0, 4)
    assert neighbors.news([1, 2]) == [(3, False)]
    neighbors.inform([1], 3, here=False)
    assert neighbors.news([1, 2]) == [(3, False)]
    neighbors.inform([2], 3, here=False)
    assert neighbors.news([1, 2]) == []
    assert neighbors.news([1, 2, 3]) == [(3, True)]


def test_a_robot_that_restarts_has_received_and_sent_nothing() -> None:
    neighbors = Neighbors(0, 3)
    neighbors.near[1, 2] = False
    neighbors.inform([1], 2, here=False)
    neighbors.restarted(1)
    assert neighbors.near[1, 2]
    assert neighbors.news([1]) == [(2, False)]


def test_cursors_are_known_to_robots_that_were_in_range_ever_since() -> None:
    cursors = BroadcastCursors(0, 3, known=True, reliable=True)
    assert cursors.known(0, [1, 2])
    assert cursors.of(1) == 0
    cursors.begin_step([1])
    cursors.sent(5, [1])
    cursors.received(1, 3)
    assert cursors.known(5, [1])
    assert not cursors.known(5, [1, 2])
    assert (cursors.of(1), cursors.of(2)) == (3, None)
    unreliable = BroadcastCursors(0, 3, known=True, reliable=False)
    unreliable.sent(5, [1])
    assert not unreliable.known(5, [1])


def test_a_peer_is_distrusted_unless_others_sent_entries_of_the_map_that_it_got_wrong() -> None:
    wrong = {b"lie"}

    def consume(peer: int, map_id: object, frame: bytes) -> list[int]:
        if frame in wrong:
            raise ProtocolError("entry", 0, "a lie")
        return [len(frame)]

    maps = map_ids(4)
    replica = Replica(maps[0], maps, consume)
    assert replica.accept(1, 2, entry(2, 0))
    assert not replica.accept(3, 2, b"lie")
    assert [(each.peer, each.map) for each in replica.take_rejected()] == [(3, maps[2])]
    assert replica.distrusted == set(), "robot 1 may have been the one that lied"
    assert replica.accept(3, 3, entry(3, 0))
    assert not replica.accept(3, 2, entry(2, 1)), "of this map nothing is accepted from robot 3"
    assert not replica.accept(3, 3, b"lie")
    assert replica.distrusted == {3}
    assert not replica.accept(3, 1, entry(1, 0))
    assert len(replica.take_rejected()) == 1
