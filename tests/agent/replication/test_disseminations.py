"""All disseminations on all media: every log reaches every robot, in order, and what is lost is sent again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from agent.replication.base import Replication
from protocol import packet_index
from protocol.errors import ProtocolError
from protocol.messages import ConnectionReport, Delivery, RoundReport, SendReport
from protocol.packet_codec import encode
from protocol.packets import Answer, FromFirst, HeldFirst, Offer
from tests.agent.replication.network import (
    VARIANTS,
    Network,
    Reach,
    entries,
    everyone,
    line,
    make_engine,
    random_reach,
)

seeds = st.integers(0, 2**32 - 1)
variants = st.sampled_from(VARIANTS)
LOSSY = [name for name, acks in VARIANTS if acks]


def engine(dissemination: str, robots: int = 2, *, robot: int = 0, acks: bool = False) -> Replication:
    """An engine that can decode everything."""

    return make_engine(
        robot, robots, lambda *received: packet_index.ends(received[-1]), dissemination, requires_acks=acks
    )


@given(st.integers(2, 6), variants, seeds, st.integers(1, 3), st.sampled_from((None, 30, 100, 1000)))
@example(3, ("backoff", False), 0, 1, None)
def test_with_any_encounters_logs_are_never_wrong_and_complete_in_the_end(
    robots: int, variant: tuple[str, bool], seed: int, rounds: int, budget: int | None
) -> None:
    network = Network(robots, variant[0], seed, acks=variant[1])
    rng = np.random.default_rng(seed)
    for _ in range(12):
        for robot in range(robots):
            network.append(robot, int(rng.integers(0, 5)))
        network.step(random_reach(rng, robots, 0.4), budget, rounds)
        network.check()
    order = rng.permutation(robots).tolist()
    reach = {order[robot]: [order[peer] for peer in peers] for robot, peers in line(robots).items()}
    network.settle(reach, budget and max(budget, 100), rounds, most=4000)
    network.check()


@settings(max_examples=20)
@given(
    st.sampled_from(LOSSY),
    st.integers(2, 4),
    seeds,
    st.sampled_from((0.0, 0.2, 0.5)),
    st.sampled_from((0, 1, 4)),
    st.sampled_from((0.0, 0.4)),
    st.sampled_from((None, 60, 300)),
    st.booleans(),
)
def test_logs_are_complete_in_the_end_whatever_the_medium_does_to_frames(
    name: str,
    robots: int,
    seed: int,
    loss: float,
    delay: int,
    duplication: float,
    budget: int | None,
    chain: bool,
) -> None:
    network = Network(robots, name, seed, acks=True, loss=loss, delay=delay, duplication=duplication)
    reach: Reach = line(robots) if chain else everyone(robots)
    for step in range(12):
        network.append(step % robots, 1 + seed % 4)
        network.step(reach, budget)
        network.check()
    network.settle(reach, budget)


@pytest.mark.parametrize("name", LOSSY)
def test_lost_entries_do_not_count_as_delivered(name: str) -> None:
    network = Network(2, name, acks=True, loss=1.0)
    network.append(0, 30)
    for _ in range(40):
        network.step(everyone(2))
    assert network.engines[0].undelivered() == 30
    network.loss = 0.0
    for _ in range(80):
        network.step(everyone(2))
    assert network.complete()
    assert network.engines[0].undelivered() == 0


@pytest.mark.parametrize(("name", "acks"), VARIANTS)
def test_robots_that_hold_the_same_fall_silent(name: str, acks: bool) -> None:
    network = Network(3, name, 1, acks=acks, loss=0.2 if acks else 0.0, delay=2 if acks else 0)
    for robot in range(3):
        network.append(robot, 10)
    for _ in range(150):
        network.step(everyone(3))
    assert network.complete()
    before = network.carried
    for _ in range(40):
        network.step(everyone(3))
    assert network.carried == before


@pytest.mark.parametrize(("name", "most"), [("backoff", 3.0), ("thesis", 3.0), ("gossip", 4.0)])
def test_losing_a_fifth_of_the_frames_does_not_multiply_the_traffic(name: str, most: float) -> None:
    carried = []
    for loss in (0.0, 0.2):
        network = Network(3, name, 5, acks=True, loss=loss)
        for step in range(300):
            if step < 60:
                network.append(step % 3, 3)
            network.step(everyone(3))
        assert network.complete()
        carried.append(network.carried)
    assert carried[1] < most * carried[0]


@pytest.mark.parametrize(("name", "acks"), VARIANTS)
def test_logs_become_complete_after_a_partition_of_a_hundred_steps(name: str, acks: bool) -> None:
    network = Network(4, name, 2, acks=acks, loss=0.1 if acks else 0.0)
    apart: Reach = {0: [1], 1: [0], 2: [3], 3: [2]}
    for step in range(120):
        network.append(step % 4, 1)
        network.step(apart if step >= 10 else everyone(4), 200)
    assert not network.complete()
    network.settle(everyone(4), 200, most=150)


@pytest.mark.parametrize("name", LOSSY)
def test_entries_are_not_retracted_once_they_were_on_the_air(name: str) -> None:
    each = engine(name, acks=True)
    each.own_log.append(entries(0, 0, 2))
    assert each.own_log.retract(1)
    each.own_log.append(entries(0, 1, 2))
    for number in range(4):
        frames = each.open_round(number, [1], None)
        sent = [SendReport(at, len(frame.payload)) for at, frame in enumerate(frames)]
        report = Delivery(1, encode([HeldFirst(0, 0)]))
        each.close_round(RoundReport(1, number, [], sent, [report], False))
    assert not each.own_log.retract(1), "it was lost perhaps, but perhaps not"


@pytest.mark.parametrize("name", ["backoff", "thesis"])
@pytest.mark.parametrize("count", range(5))
def test_only_the_packets_of_an_acknowledged_frame_that_were_on_the_air_count_as_sent(
    name: str, count: int
) -> None:
    each = engine(name, acks=True)
    each.own_log.append(entries(0, 0, 2))
    received = [Delivery(1, encode([Offer(1, 0)])), Delivery(1, encode([HeldFirst(0, 0)]))]
    each.open_round(0, [1], None)
    each.close_round(RoundReport(1, 0, [], [], received, False))
    (frame,) = each.open_round(1, [1], None)
    written = encode([HeldFirst(1, 0), FromFirst(0, 0)]) + b"".join(entries(0, 0, 2))
    assert frame.payload == written
    size = [0, *packet_index.ends(written)][count]
    each.close_round(RoundReport(1, 1, [], [SendReport(0, size)], [], False))
    assert each.own_log.shared == max(0, count - 2)
    again = [each.payload for each in each.open_round(2, [1], None)]
    left = b"" if count > 2 else written[2:]
    assert again == [payload for payload in [written[: 0 if count else 2] + left] if payload]


@pytest.mark.parametrize(("name", "acks"), VARIANTS)
def test_only_entries_that_were_never_on_the_air_are_retracted(name: str, acks: bool) -> None:
    network = Network(2, name, acks=acks)
    network.append(0, 3)
    assert network.engines[0].own_log.retract(1)
    network.appended[0] -= 1
    network.settle(everyone(2))
    assert not network.engines[0].own_log.retract(1)


def test_a_peer_that_claims_entries_which_were_never_sent_cannot_make_the_log_inconsistent() -> None:
    for name in LOSSY:
        each = engine(name, acks=True)
        each.own_log.append(entries(0, 0, 5))
        each.open_round(0, [1], 9)
        claim = Delivery(1, encode([HeldFirst(0, 5)]))
        each.close_round(RoundReport(1, 0, [], [], [claim], False))
        assert each.own_log.retract(2)
        assert len(each.logs[0]) == 3
    each = engine("backoff")
    each.own_log.append(entries(0, 0, 5))
    each.open_round(0, [1], None)
    each.send_data([Delivery(1, encode([Answer(5)]), 0, 0)])
    each.close_round(RoundReport(1, 0, [ConnectionReport(0, 2, 2, 0)], [], [], False))
    assert not each.own_log.retract(2), "the log is as the peer claims to hold it"
    assert len(each.logs[0]) == 5


@pytest.mark.parametrize(("name", "acks"), [each for each in VARIANTS if each[1] or each[0] == "gossip"])
def test_without_handshakes_there_are_no_answers(name: str, acks: bool) -> None:
    each = engine(name, acks=acks)
    with pytest.raises(ProtocolError, match="1 offers"):
        each.answer([Delivery(1, encode([Offer(1, 0)]), 0)])
    with pytest.raises(ProtocolError, match="1 answers"):
        each.send_data([Delivery(1, b"", 0, 1)])


def test_an_unknown_dissemination_is_refused_with_those_that_exist() -> None:
    with pytest.raises(ValueError, match="'often'; there are: backoff, thesis, gossip"):
        engine("often")


@pytest.mark.parametrize(("name", "acks"), VARIANTS)
def test_two_robots_that_walk_apart_and_back_hold_all_of_each_other(name: str, acks: bool) -> None:
    """Each appends an entry a step; they are in range in the first and the last twenty steps."""
    network = Network(2, name, acks=acks)
    for step in range(100):
        network.append(0, 1)
        network.append(1, 1)
        before, together = network.carried, step < 20 or step >= 80
        network.step(everyone(2) if together else {0: [], 1: []}, 120)
        network.check()
        assert together or network.carried == before
    network.settle(everyone(2), 120)
