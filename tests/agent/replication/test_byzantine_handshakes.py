"""Handshakes with byzantine peers: no false offer, answer or entry harms honest robots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.replication.handshakes import STUBBORN
from protocol import packet_codec, packet_index, packets
from protocol.errors import ProtocolError
from protocol.messages import ConnectionReport, Delivery, OutgoingFrame
from protocol.packet_codec import encode
from protocol.packets import BLOCKS, DECLINED, INDEX_WINDOW, Answer, Block, Offer, Save
from tests.agent.replication.handshake_ends import closing, declines, engine
from tests.agent.replication.network import Network, entries, entry, everyone

seeds = st.integers(0, 2**32 - 1)
policies = st.sampled_from(("backoff", "thesis"))

# The relay has checked the form of their frames, not their sense.


def make_byzantine(network: Network, robot: int, seed: int) -> None:
    """Let a robot offer, answer and send whatever has the right form."""
    rng, robots, each = np.random.default_rng([seed, robot]), len(network.engines), network.engines[robot]

    def offers(_number: int, in_range: list[int], _budget: int | None) -> list[OutgoingFrame]:
        return [
            OutgoingFrame(peer, encode([Offer(of, int(rng.integers(BLOCKS)))]))
            for peer in in_range
            for of in rng.integers(0, robots, rng.integers(0, 3)).tolist()
        ]

    def answers(arrived: Sequence[Delivery]) -> list[OutgoingFrame]:
        index, block = Answer(int(rng.integers(INDEX_WINDOW))), Block(int(rng.integers(BLOCKS)))
        choices: list[list[packets.Packet]] = [
            [index],
            [block, index],
            [block, block, index],
            [Block(DECLINED)],
        ]
        return [
            OutgoingFrame(offer.sender, encode(choices[rng.integers(4)]), offer.connection)
            for offer in arrived
            if rng.random() < 0.9
        ]

    def data(arrived: Sequence[Delivery]) -> list[OutgoingFrame]:
        return [
            OutgoingFrame(
                answer.sender,
                b"".join(entries(answer.map_id, int(rng.integers(9)), 9)) + encode([Save()]),
                answer.connection,
            )
            for answer in arrived
        ]

    overrides: Any = each
    overrides.open_round, overrides.answer, overrides.send_data = offers, answers, data
    overrides.close_round = lambda _report: []


@pytest.mark.slow
@settings(max_examples=max(8, settings().max_examples // 4))
@given(st.integers(3, 5), policies, seeds)
def test_a_byzantine_robot_neither_spoils_a_log_nor_keeps_others_from_theirs(
    robots: int, policy: str, seed: int
) -> None:
    network = Network(robots, policy, seed)
    honest = range(robots - 1)
    make_byzantine(network, robots - 1, seed)
    for _ in range(150):
        for robot in honest:
            if sum(map(len, network.engines[robot].logs)) < 40:
                network.append(robot, 1)
        network.step(everyone(robots), 500)
        for robot in honest:
            for of in honest:
                assert network.held(robot, of) == network.written(of)[: network.length(robot, of)]
            assert network.held(robot, robot) == network.written(robot)
    assert network.complete(honest) or all(
        network.held(robot, of) == network.written(of) for robot in honest for of in honest
    )


def test_no_robot_accepts_entries_of_its_own_map() -> None:
    each = engine(0, 3)
    each.own_log.append(entries(0, 0, 2))
    (answer,) = each.answer([Delivery(1, encode([Offer(0, 0)]), 5)])
    assert packet_codec.decode(answer.payload) == [Block(DECLINED)]
    each.close_round(closing(ConnectionReport(5, 2, 2, 9), data=[Delivery(1, entry(0, 2), 5)]))
    assert packet_index.split(each.logs[0].read(0, None)) == entries(0, 0, 2)


def test_data_on_a_connection_that_was_declined_or_never_offered_is_dropped() -> None:
    each = engine(0, 3)
    offer = encode([Offer(2, 0)])
    answers = each.answer([Delivery(1, offer, 5), Delivery(2, offer, 6)])
    assert [packet_codec.decode(frame.payload) for frame in answers] == [[Answer(0)], [Block(DECLINED)]]
    data = [Delivery(sender, entry(2, 0), connection) for sender, connection in ((1, 5), (2, 6), (2, 99))]
    each.close_round(closing(ConnectionReport(5, 2, 2, 7), ConnectionReport(6, 2, 2, 7), data=data))
    assert packet_index.split(each.logs[2].read(0, None)) == entries(2, 0, 1)


@pytest.mark.parametrize(
    "frame", [b"", b"\xff", encode([Answer(0)]), encode([Offer(3, 0)]), 2 * encode([Offer(1, 0)]), b"\xc0"]
)
def test_a_malformed_offer_is_an_error(frame: bytes) -> None:
    with pytest.raises(ProtocolError):
        engine(0, 3).answer([Delivery(1, frame, 0)])


@pytest.mark.parametrize(
    "frame",
    [
        b"",
        b"\xff",
        encode([Offer(0, 0)]),
        encode([Block(0)]),
        encode([Answer(0), Block(0)]),
        2 * encode([Answer(0)]),
        3 * encode([Block(0)]),
        encode([Block(0), Block(DECLINED)]),
        encode([Save()]),
    ],
)
def test_a_malformed_answer_is_an_error(frame: bytes) -> None:
    each = engine(0, 3)
    each.own_log.append(entries(0, 0, 2))
    assert each.open_round(0, [1], None)
    with pytest.raises(ProtocolError):
        each.send_data([Delivery(1, frame, 0, 0)])


def test_an_answer_to_an_offer_that_was_not_made_is_an_error() -> None:
    each = engine(0, 3)
    each.own_log.append(entries(0, 0, 2))
    each.open_round(0, [1], None)
    for peer, of in ((2, 0), (1, 1)):
        with pytest.raises(ProtocolError, match=f"robot {peer} answers an offer that was not made"):
            each.send_data([Delivery(peer, encode([Answer(0)]), 0, of)])


@pytest.mark.parametrize("claimed", [2, 3, 4095])
def test_no_entries_go_to_a_peer_that_claims_as_many_or_more(claimed: int) -> None:
    each = engine()
    each.own_log.append(entries(0, 0, 2))
    each.open_round(0, [1], None)
    assert each.send_data([Delivery(1, encode([Answer(claimed)]), 0, 0)]) == []
    each.close_round(closing(ConnectionReport(0, 2, 2, 0)))
    assert each.peers.expected[1, 0] == 2
    assert each.delivered()


def test_entries_are_not_repeated_to_a_peer_that_claims_fewer_than_it_received() -> None:
    network = Network(2, "thesis")
    network.append(0, 9)
    network.round(0, everyone(2))
    peer: Any = network.engines[1]
    peer.answer = lambda offers: [OutgoingFrame(o.sender, encode([Answer(0)]), o.connection) for o in offers]
    network.append(0, 1)
    assert sum(each.carried[2] for each in network.round(0, everyone(2))) == 0
    assert network.round(0, everyone(2)) == []


def test_a_peer_that_refuses_again_and_again_is_not_waited_for() -> None:
    network = Network(3)
    network.append(0, 1)
    peer: Any = network.engines[1]
    peer.answer = declines
    waited = 0
    while not network.engines[0].delivered():
        network.step(everyone(3))
        waited += 1
    assert 1 < waited <= 2 * STUBBORN
    network.append(0, 1)
    assert not network.engines[0].delivered(), "robot 2 is waited for"
    network.step(everyone(3))
    assert network.engines[0].delivered()
    assert network.length(2, 0) == 2


def test_offers_of_a_rejected_peer_leave_the_place_to_others() -> None:
    network = Network(3)
    network.append(2, 1)
    network.round(1, {0: [2], 2: [0]})
    network.engines[1].replica.reject(0, 2, "malformed")
    for _ in range(4):
        network.round(1, {0: [1], 1: [0]})
    assert network.length(1, 2) == 0
    network.round(1, everyone(3))
    assert network.length(1, 2) == 1
