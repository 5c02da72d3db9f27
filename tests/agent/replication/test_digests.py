"""Digests of logs: forged and damaged entries are found, dropped and replaced, in all disseminations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.replication.control_packets import header
from agent.replication.digests import INTERVAL, LogVerifier
from agent.replication.log import Log
from protocol import packet_codec, packet_index
from protocol.messages import Delivery, RoundReport
from protocol.packet_codec import decode, encode
from protocol.packets import Fragment, From, LogDigest
from tests.agent.replication.network import (
    VARIANTS,
    Network,
    Reach,
    entries,
    entry,
    everyone,
    line,
    make_engine,
    random_reach,
)

seeds = st.integers(0, 2**32 - 1)
variants = st.sampled_from(VARIANTS)
FORGER = 1


def forgery(true: bytes) -> bytes:
    """Another entry of the same log and length."""
    (fragment,) = decode(true)
    assert isinstance(fragment, Fragment)
    return encode([Fragment(fragment.data[:1] + b"fake" + fragment.data[5:])])


def forged(sender: int, _receiver: int, map_id: int, frame: bytes) -> bytes:
    """A frame in which the forger replaced all entries of other robots' logs."""
    if sender != FORGER:
        return frame
    sent = []
    for packet in packet_index.split(frame):
        if packet_codec.name(packet) != Fragment.name:
            control = decode(packet)[0]
            map_id = control.map if isinstance(control, From) else map_id
            sent.append(packet)
        else:
            sent.append(packet if map_id == FORGER else forgery(packet))
    return b"".join(sent)


def open_network(robots: int, variant: tuple[str, bool], seed: int, *, digests: bool = True) -> Network:
    """A network of robots that can decode all entries, true or false."""
    network = Network(robots, variant[0], seed, acks=variant[1], digests=digests)
    network.understands = lambda *_: True
    return network


def check_decoded(network: Network) -> None:
    """Assert that robots have decoded what their logs hold: nothing that was dropped, and nothing twice."""
    for robot, decoded in enumerate(network.decoded):
        for of in range(len(network.engines)):
            assert of == robot or decoded[of] == network.engines[robot].logs[of].read(0)


def distrusted(network: Network) -> set[int]:
    return set[int]().union(*(engine.replica.distrusted for engine in network.engines))


@pytest.mark.slow
@given(st.integers(3, 5), variants, seeds, st.sampled_from((None, 100, 300)))
def test_forged_entries_are_dropped_and_replaced_once_the_author_is_in_range(
    robots: int, variant: tuple[str, bool], seed: int, budget: int | None
) -> None:
    network = open_network(robots, variant, seed)
    network.tamper = forged
    rng = np.random.default_rng(seed)
    for _ in range(20):
        for robot in range(robots):
            network.append(robot, int(rng.integers(0, 3)))
        network.step(random_reach(rng, robots, 0.5), budget)
    network.tamper = lambda _sender, _receiver, _map_id, frame: frame
    network.settle(everyone(robots), budget and max(budget, 100), most=400)
    check_decoded(network)
    assert distrusted(network) <= {FORGER}


@pytest.mark.slow
@given(variants, seeds)
def test_a_forger_that_never_stops_is_distrusted_and_the_others_share_their_logs(
    variant: tuple[str, bool], seed: int
) -> None:
    robots = 4
    network = open_network(robots, variant, seed)
    network.tamper = forged
    rng = np.random.default_rng(seed)
    honest = [robot for robot in range(robots) if robot != FORGER]
    for step in range(120):
        for robot in range(robots):
            network.append(robot, int(rng.integers(0, 2)))
        network.step(everyone(robots) if step % 3 else line(robots), 300)
    for _ in range(300):
        network.step(everyone(robots), 300)
    for robot in honest:
        for of in range(robots):
            assert network.held(robot, of) == network.written(of)
        assert network.engines[robot].replica.distrusted <= {FORGER}
    check_decoded(network)


@given(st.integers(2, 4), variants, seeds, st.integers(1, 4))
def test_a_flipped_bit_in_a_frame_does_no_lasting_harm_and_nobody_is_distrusted(
    robots: int, variant: tuple[str, bool], seed: int, flips: int
) -> None:
    network, rng, left = open_network(robots, variant, seed), np.random.default_rng(seed), [flips]

    def flip(_sender: int, _receiver: int, _map_id: int, frame: bytes) -> bytes:
        if not frame or not left[0] or rng.random() < 0.8:
            return frame
        left[0] -= 1
        damaged = bytearray(frame)
        damaged[int(rng.integers(len(frame)))] ^= 1 << int(rng.integers(8))
        return bytes(damaged)

    network.tamper = flip
    for _ in range(30):
        for robot in range(robots):
            network.append(robot, int(rng.integers(0, 3)))
        network.step(everyone(robots), 300)
    left[0] = 0
    network.settle(everyone(robots), 300, most=300)
    check_decoded(network)
    assert distrusted(network) == set()


@pytest.mark.parametrize(("name", "acks"), [each for each in VARIANTS if each[1] or each[0] == "gossip"])
def test_an_author_reports_a_forgery_of_its_log_and_sends_a_digest(name: str, acks: bool) -> None:
    engine = make_engine(0, 3, lambda *received: packet_index.ends(received[-1]), name, requires_acks=acks)
    engine.own_log.append(entries(0, 0, 3))
    engine.own_log.sent(3)

    def receive(*frames: bytes) -> list[int]:
        report = RoundReport(1, 0, [], [], [Delivery(FORGER, frame) for frame in frames], False)
        return [each.peer for each in engine.close_round(report)]

    engine.salt = 7
    assert receive(header(0, 1) + entry(0, 1) + entry(0, 2)) == []
    assert engine.own_log.digest_length == 0
    assert receive(header(0, 1) + forgery(entry(0, 1))) == [FORGER]
    assert engine.own_log.digest_length == 2
    assert receive(header(0, 2) + entry(0, 2) + entry(0, 3)) == [FORGER], "it wrote no entry 3"
    sent = engine.announcements() + b"".join(each.payload for each in engine.open_round(0, [1, 2], None))
    digests = [each for each in packet_codec.decode(sent) if isinstance(each, LogDigest)]
    assert [each.entries for each in digests] == [2]
    assert len(engine.logs[0]) == 3, "its own log is its own"


@pytest.mark.slow
@given(st.integers(2, 5), variants, seeds)
def test_digests_cost_a_byte_per_step_and_change_nothing_else(
    robots: int, variant: tuple[str, bool], seed: int
) -> None:
    plain, digesting = (open_network(robots, variant, seed, digests=each) for each in (False, True))
    rng = np.random.default_rng(seed)
    steps = 12 * robots
    for _ in range(steps):
        counts = rng.integers(0, 3, robots).tolist()
        for network in (plain, digesting):
            for robot, count in enumerate(counts):
                network.append(robot, count)
            network.step(everyone(robots))
        for robot in range(robots):
            assert [len(log) for log in plain.engines[robot].logs] == [
                len(log) for log in digesting.engines[robot].logs
            ]
    assert plain.announced == 0
    spent = digesting.announced + digesting.carried - plain.carried
    assert 0 < spent <= steps
    assert spent % LogDigest.size == 0
    assert plain.rejected == digesting.rejected == []
    for robot, engine in enumerate(digesting.engines):
        for of in range(robots):
            verified = engine.replica.verifiers[of].length
            assert of == robot or verified > 0 or len(engine.logs[of]) == 0


@pytest.mark.parametrize(("name", "acks"), VARIANTS)
def test_entries_are_verified_within_a_turn_of_all_robots(name: str, acks: bool) -> None:
    network = open_network(3, (name, acks), 3)
    for robot in range(3):
        network.append(robot, 7)
    for _ in range(2 * 3 * INTERVAL + 4):
        network.step(everyone(3))
    for engine in network.engines:
        own = engine.peers.own
        assert [v.length for number, v in enumerate(engine.replica.verifiers) if number != own] == [7, 7]
        assert not engine.replica.has_forwarded()


@pytest.mark.slow
@settings(max_examples=15)
@given(st.sampled_from([each for each in VARIANTS if each[1]]), seeds, st.sampled_from((0.1, 0.3)))
def test_on_a_lossy_medium_late_digests_and_entries_are_not_taken_for_forgeries(
    variant: tuple[str, bool], seed: int, loss: float
) -> None:
    network = Network(3, variant[0], seed, acks=True, loss=loss, delay=3, duplication=0.3, digests=True)
    reach: Reach = everyone(3)
    for step in range(60):
        network.append(step % 3, 1 + seed % 3)
        network.step(reach, 300)
        network.check()
    network.settle(reach, 300)
    assert network.rejected == []


def test_entries_that_the_author_sent_after_an_early_digest_are_not_taken_for_forgeries() -> None:
    written, held = Log(), Log()
    written.append(entries(1, 0, 3))
    digest = LogVerifier(written).digest(3, 5, complete=True)
    verifier = LogVerifier(held)
    verifier.receive(digest)
    held.append(
        entries(1, 0, 5)
    )  # the entries that the digest had overtaken, and two that were written since
    assert verifier.check() is True
    assert verifier.length == 3
