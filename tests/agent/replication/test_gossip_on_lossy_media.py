"""Gossip where only peers acknowledge: lost entries are sent again, and no others."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.replication.base import Replication
from agent.replication.control_packets import parse
from agent.replication.delivery import WINDOW
from agent.replication.reports import REFRESH
from protocol import packet_codec, packet_index
from protocol.packet_codec import encode
from protocol.packets import From, FromFirst, Gone, HeldFirst, Near
from tests.agent.replication.network import (
    Network,
    Transmission,
    closing,
    engine,
    entries,
    entry,
    everyone,
    make_engine,
)


def entry_bytes(played: list[list[Transmission]]) -> int:
    """Bytes of entries on the air."""
    frames = [each.frames[0][: each.carried[0]] for sent in played for each in sent]
    return sum(len(b"".join(those)) for frame in frames for _, those in parse(frame).sections)


def play(network: Network, steps: int, lose: Callable[[int, int, int], bool]) -> int:
    """Play steps of one round, of 60 bytes; return the bytes of entries that were on the air.

    `lose`: whether the frame of a step is lost on its way from one robot to another.
    """
    size = 0
    for now in range(steps):
        network.tamper = lambda sender, receiver, _map, payload, now=now: (  # type: ignore[misc]
            b"" if lose(now, sender, receiver) else payload
        )
        if now < 12:
            network.append(0, 3)
        size += entry_bytes(network.step(everyone(3), 60, 1))
        network.check()
    return size


@given(st.integers(1, 10), st.integers(1, 3))
def test_only_the_entries_of_lost_frames_are_sent_again_and_at_most_one_frame_more(
    first: int, count: int
) -> None:
    network = Network(3, "gossip", acks=True)
    lost = range(first, first + count)
    size = play(network, 60, lambda now, sender, receiver: (sender, receiver) == (0, 2) and now in lost)
    assert network.complete()
    missing = sum(map(len, entries(0, 3 * first, 3 * min(12, first + count))))
    again = size - sum(map(len, network.written(0)))
    assert missing <= again <= missing + max(map(len, network.written(0))) * 3


def test_if_reports_are_lost_robots_ask_for_them_and_send_no_entries_again() -> None:
    network = Network(3, "gossip", acks=True)
    size = play(network, 40, lambda now, sender, _receiver: sender == 2 and now < 30)
    assert size == sum(map(len, network.written(0)))
    assert network.complete()
    assert network.engines[0].undelivered() == 0


@pytest.mark.parametrize("acks", [False, True])
def test_if_frames_may_be_lost_a_robot_repeats_which_robots_are_in_its_range(acks: bool) -> None:
    each = engine(0, 3, acks=acks)
    reported: list[object] = []
    for _ in range(2 * 3 * REFRESH):
        sent = each.open_round(0, [1], None)
        payload = b"".join(frame.payload for frame in sent)
        reported += [p for p in packet_codec.decode(payload) if isinstance(p, Near | Gone)]
        each.close_round(closing(sent=len(payload)))
    assert reported == ([Gone(2), *2 * [Near(1), Gone(2)]] if acks else [Gone(2)])


def broadcasts(each: Replication, in_range: list[int], steps: int, *first: tuple[int, bytes]) -> list[bytes]:
    """An engine's broadcasts in some steps, all on the air; `first`: the frames that it receives in the first step."""
    sent = []
    for now in range(steps):
        frame = b"".join(frame.payload for frame in each.open_round(0, in_range, None))
        each.close_round(closing(*(() if now else first), sent=len(frame)))
        sent.append(frame)
    return sent


def reports(frames: list[bytes]) -> list[HeldFirst]:
    """The reports of map 0 in frames, in order."""
    packets = [packet for frame in frames for packet in packet_codec.decode(frame)]
    return [packet for packet in packets if isinstance(packet, HeldFirst) and packet.map == 0]


def test_a_forwarder_asks_a_silent_peer_once_for_a_report_by_one_of_its_own() -> None:
    forwarder = engine(1, 3, acks=True)
    broadcasts(forwarder, [0], 10, (0, encode([FromFirst(0, 0)]) + b"".join(entries(0, 0, 3))))
    lacks = (2, encode([HeldFirst(0, 0)]))
    assert any(entry(0, 2) in frame for frame in broadcasts(forwarder, [2], 6, lacks))
    asked = broadcasts(forwarder, [2], REFRESH)
    assert not any(entry(0, 2) in frame for frame in asked)
    assert HeldFirst(0, 3) in reports(asked)
    assert len(reports(broadcasts(forwarder, [2], 10 * REFRESH))) <= 4, "reports in turn only"


def test_a_robot_reports_what_it_lacks_until_the_entries_arrive() -> None:
    each = engine(2, 3, acks=True)
    asked = reports(broadcasts(each, [0, 1], 100, (1, encode([HeldFirst(0, 3)]))))
    assert set(asked) == {HeldFirst(0, 0)}
    assert len(asked) > 4
    broadcasts(each, [0, 1], 20, (1, encode([FromFirst(0, 0)]) + b"".join(entries(0, 0, 3))))
    assert not reports(broadcasts(each, [0, 1], 100))


def test_a_robot_reports_what_it_lacks_only_in_turn_once_the_peer_that_has_it_has_left() -> None:
    each = engine(2, 3, acks=True)
    broadcasts(each, [0, 1], 10, (1, encode([HeldFirst(0, 3)])))
    turns = 6
    assert len(reports(broadcasts(each, [0], turns * 3 * REFRESH))) <= turns + 1


def test_a_robot_between_others_that_are_apart_repeats_its_reports() -> None:
    each = engine(1, 3, acks=True)
    assert not any(broadcasts(each, [0, 2], 100))
    assert any(broadcasts(each, [0, 2], 100, (0, encode([Gone(2)]))))


def test_entries_far_behind_a_gap_are_not_stored() -> None:
    each = engine(1, 2, acks=True)
    (_, sent) = broadcasts(each, [0], 2, (0, encode([From(0, 2 * WINDOW)]) + entry(0, 0)))
    assert packet_codec.decode(sent) == [HeldFirst(0, 0)]


@pytest.mark.parametrize(("round_trip", "waited", "again"), [(0, 1, True), (4, 4, False), (4, 5, True)])
def test_reports_that_may_have_been_under_way_with_the_entries_show_no_loss(
    round_trip: int, waited: int, again: bool
) -> None:
    each = make_engine(0, 2, lambda *_: [], "gossip", requires_acks=True, round_trip=round_trip)
    each.own_log.append(entries(0, 0, 2))
    (frame,) = each.open_round(0, [1], None)
    each.close_round(closing(sent=len(frame.payload)))
    for left in reversed(range(waited)):
        each.open_round(0, [1], None)
        each.close_round(closing() if left else closing((1, encode([HeldFirst(0, 0)]))))
    assert bool(each.open_round(1, [1], None)) == again


@pytest.mark.parametrize("budget", [50, None])
def test_a_gap_that_no_robot_fills_is_reported_more_and_more_rarely(budget: int | None) -> None:
    each = engine(1, 2, acks=True)
    reported = []
    for now in range(1200):
        sent = each.open_round(0, [0], budget)
        reported += [now] * bool(sent)
        forged = [(0, encode([FromFirst(0, 9)]) + entry(0, 9))] if now == 0 else []
        each.close_round(closing(*forged, sent=len(sent[0].payload) if sent else 0))
    gaps = np.diff(reported)
    assert gaps[:8].tolist() == [2] * 8
    assert gaps[-1] > 40
    assert (np.diff(gaps) >= 0).all()


def test_entries_that_came_behind_a_gap_are_kept_until_it_is_filled() -> None:
    each = engine(1, 2, acks=True)
    each.open_round(0, [0], None)
    for first in (3, 0):
        each.close_round(closing((0, encode([FromFirst(0, first)]) + b"".join(entries(0, first, first + 3)))))
    assert packet_index.split(each.logs[0].read(0, None)) == entries(0, 0, 6)
    (frame,) = each.open_round(1, [0], None)
    assert packet_codec.decode(frame.payload) == [HeldFirst(0, 6)], (
        "no robot is to repeat the entries that were kept"
    )


def test_false_entries_behind_a_gap_are_replaced_when_the_true_entries_arrive() -> None:
    lie = entry(0, 7)
    each = engine(2, 3, acks=True, lie=lie)
    each.open_round(0, [0, 1], None)
    first, second = (encode([FromFirst(0, at)]) + entry(0, at) for at in range(2))
    assert not each.close_round(closing((1, encode([FromFirst(0, 1)]) + lie)))
    assert [rejected.peer for rejected in each.close_round(closing((0, first)))] == [1]
    each.close_round(closing((0, second)))
    assert packet_index.split(each.logs[0].read(0, None)) == entries(0, 0, 2)


def test_entries_that_were_kept_are_dropped_if_their_sender_is_rejected_meanwhile() -> None:
    each = engine(2, 3, acks=True)
    each.open_round(0, [0, 1], None)
    each.close_round(closing((1, encode([FromFirst(0, 1)]) + entry(0, 1))))
    each.replica.reject(1, 0, "malformed")
    each.close_round(closing((0, encode([FromFirst(0, 0)]) + entry(0, 0))))
    assert packet_index.split(each.logs[0].read(0, None)) == entries(0, 0, 1)
