"""Handshakes on a perfect medium: offers by the policies, answers that are never ambiguous, and byzantine peers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.replication.base import Replication
from agent.replication.control_packets import LEAST_HANDSHAKE
from agent.replication.handshakes import MAX_WAIT, STUBBORN, Connection
from agent.replication.log import Log
from agent.replication.peers import PeerTable
from agent.replication.policies import CROWD, Backoff, Rounds
from agent.replication.replica import Replica
from protocol import packet_codec, packet_index, packets
from protocol.errors import ProtocolError
from protocol.messages import ConnectionReport, Delivery, OutgoingFrame, RoundReport
from protocol.packet_codec import encode
from protocol.packets import BLOCKS, DECLINED, INDEX_WINDOW, Answer, Block, Offer, Save
from tests.agent.replication.network import Network, entries, entry, everyone, line, make_engine

ROUND = BLOCKS * INDEX_WINDOW
seeds = st.integers(0, 2**32 - 1)
POLICIES = "backoff", "thesis"
policies = st.sampled_from(POLICIES)


def engine(robot: int = 0, robots: int = 2) -> Replication:
    """An engine that can decode everything."""
    return make_engine(robot, robots, lambda *received: packet_index.ends(received[-1]))


def closing(*connections: ConnectionReport, data: Sequence[Delivery] = ()) -> RoundReport:
    return RoundReport(0, 0, list(connections), [], list(data), False)


def declines(offers: Sequence[Delivery]) -> list[OutgoingFrame]:
    return [OutgoingFrame(each.sender, encode([Block(DECLINED)]), each.connection) for each in offers]


def expected(network: Network, robot: int, peer: int, of: int) -> int:
    return int(network.engines[robot].peers.expected[peer, of])


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("rounds", [1, 2, 3])
def test_a_log_reaches_robots_out_of_its_author_s_range_through_others(policy: str, rounds: int) -> None:
    network = Network(4, policy)
    network.append(0, 30)
    assert network.settle(line(4), None, rounds, most=20) <= 8
    assert all(each.sender != 3 for played in network.step(line(4)) for each in played if each.map_id == 0)


@pytest.mark.parametrize("rounds", [1, 2])
def test_others_logs_get_through_while_all_robots_keep_appending(rounds: int) -> None:
    network = Network(3)
    for _ in range(20):
        for robot in range(3):
            network.append(robot, 2)
        network.step(line(3), None, rounds)
        network.check()
    assert network.length(2, 0) >= 30
    assert network.length(0, 2) >= 30


@given(st.lists(st.integers(0, 60), min_size=1, max_size=60))
def test_data_that_was_cut_anywhere_goes_on_where_it_stopped(budgets: list[int]) -> None:
    network = Network(2)
    network.append(0, 40)
    for budget in budgets:
        before = network.carried
        network.step(everyone(2), budget)
        assert network.carried - before <= budget
        network.check()
    network.settle(everyone(2))


def test_a_frame_may_be_cut_between_any_two_packets() -> None:
    sizes = [len(entry(0, number)) for number in range(6)]
    for count in range(7):
        for more in range(sizes[count] if count < 6 else 1):
            network = Network(2)
            network.append(0, 6)
            network.round(0, everyone(2), 4 + sum(sizes[:count]) + more)
            assert network.length(1, 0) == expected(network, 0, 1, 0) == count
            network.round(1, everyone(2))
            assert network.complete()


@pytest.mark.parametrize("budget", range(5))
def test_frames_that_were_not_on_the_air_change_nothing(budget: int) -> None:
    network = Network(2)
    network.append(0, 3)
    network.round(0, everyone(2), budget)
    assert network.length(1, 0) == expected(network, 0, 1, 0) == 0


def test_an_answer_that_was_not_on_the_air_changes_nothing() -> None:
    each = engine()
    each.append(entries(0, 0, 5))
    for number in range(3):
        assert each.open_round(0, [1], None), "an answer that no robot received is no refusal"
        each.send_data([Delivery(1, encode([Answer(3 + number)]), number, 0)])
        each.close_round(closing(ConnectionReport(number, 2, 0, 0)))
        assert each.peers.expected[1, 0] == 0


def test_a_peer_that_declines_still_counts_as_holding_the_entries_sent_to_it() -> None:
    network = Network(2, "thesis")
    network.append(0, 4)
    network.round(0, everyone(2))
    peer: Any = network.engines[1]
    peer.answer = declines
    network.append(0, 1)
    network.round(0, everyone(2))
    assert expected(network, 0, 1, 0) == 4


def test_only_missing_entries_are_sent() -> None:
    network = Network(2, "thesis")
    network.append(0, 10)
    network.round(0, everyone(2))
    network.append(0, 2)
    (played,) = network.round(0, everyone(2))
    assert played.carried[2] == len(entry(0, 10) + entry(0, 11))
    assert network.round(0, everyone(2)) == []


def test_of_two_robots_that_offer_the_same_map_one_sends_and_the_other_is_declined() -> None:
    network = Network(3, "thesis", seed=4)
    network.append(0, 5)
    network.round(0, {0: [1], 1: [0], 2: []})
    played = network.round(1, {0: [2], 1: [2], 2: [0, 1]})
    assert sorted(each.carried[2] > 0 for each in played) == [False, True]
    assert [each.carried[:2] for each in played] == [[2, 2], [2, 2]]
    assert network.held(2, of=0) == network.written(0)


def test_no_robot_is_offered_its_own_map_or_entries_that_it_is_known_to_hold() -> None:
    network = Network(3, "thesis")
    for robot in range(3):
        network.append(robot, 4)
    for _ in range(4):
        assert all(each.map_id != each.receiver != each.sender for each in network.round(1, everyone(3)))
    assert network.round(1, everyone(3)) == []


@given(st.integers(2, 5), seeds)
def test_backoff_wastes_fewer_handshakes_than_the_thesis(robots: int, seed: int) -> None:
    spent = {}
    for policy in POLICIES:
        network = Network(robots, policy, seed)
        spent[policy] = 0
        for _ in range(15):
            for robot in range(robots):
                network.append(robot, 1)
            for played in network.step(everyone(robots)):
                spent[policy] += sum(sum(each.carried[:2]) for each in played)
        network.settle(everyone(robots))
    assert spent["backoff"] <= spent["thesis"]


def refusals(network: Network, rounds: int) -> list[int]:
    """Rounds in which robot 0 offers robot 1 the map of robot 2."""
    played = [network.round(1, {0: [1], 1: [0]}) for _ in range(rounds)]
    return [
        number
        for number, these in enumerate(played)
        if any((each.sender, each.receiver, each.map_id) == (0, 1, 2) for each in these)
    ]


def test_after_each_refusal_the_next_offer_waits_twice_as_long_until_it_is_accepted() -> None:
    network = Network(3)
    network.append(2, 1)
    network.round(1, {0: [2], 2: [0]})
    peer: Any = network.engines[1]
    accepts = peer.answer
    peer.answer = declines  # as if another robot always sent it this map
    offered = refusals(network, 4 * MAX_WAIT)
    gaps = [later - earlier for earlier, later in pairwise(offered)]
    assert gaps[:7] == [1, 2, 4, 8, 16, 32, MAX_WAIT]
    assert set(gaps[7:]) == {MAX_WAIT}
    peer.answer = accepts
    refusals(network, MAX_WAIT)
    for count in range(2, 6):
        network.append(2, 1)
        network.round(1, {0: [2], 2: [0]})
        network.round(1, {0: [1], 1: [0]})
        assert network.length(1, 2) == count
    network.append(2, 1)
    network.round(1, {0: [2], 2: [0]})
    peer.answer = declines
    offered = refusals(network, 8)
    assert [later - earlier for earlier, later in pairwise(offered)][:3] == [1, 2, 4]


def test_a_robot_offers_each_teammate_one_map_a_round_at_most() -> None:
    network = Network(4)
    for robot in range(4):
        network.append(robot, 3)
    for number in range(6):
        pairs = [(each.sender, each.receiver) for each in network.round(number % 2, everyone(4))]
        assert len(set(pairs)) == len(pairs)


# Long logs: the length in an answer is never ambiguous.


PLACES = [0, 1, INDEX_WINDOW - 1, INDEX_WINDOW, INDEX_WINDOW + 1, 3 * INDEX_WINDOW + 5]


@pytest.mark.parametrize("table", PLACES)
@pytest.mark.parametrize("mine", PLACES)
@pytest.mark.parametrize("theirs", PLACES)
def test_a_length_in_another_block_is_understood(mine: int, theirs: int, table: int) -> None:
    network = Network(3, "thesis")
    network.appended[2] = max(mine, theirs)
    for each, length in zip(network.engines, (mine, theirs), strict=False):
        each.logs[2].append(entries(2, 0, length))
    network.engines[0].peers.expected[1, 2] = min(table, mine, theirs)
    network.round(0, {0: [1], 1: [0], 2: []})
    assert network.length(1, 2) == max(mine, theirs)
    assert network.held(1, of=2)[-3:] == entries(2, 0, max(mine, theirs))[-3:]


def long_log(length: int) -> Log:
    log = Log()
    log.append(length * [encode([Save()])])
    return log


@pytest.mark.parametrize(("length", "count"), [(0, 1), (INDEX_WINDOW - 1, 1), (INDEX_WINDOW, 2), (ROUND, 3)])
def test_an_answer_is_as_short_as_it_can_be(length: int, count: int) -> None:
    each = engine(1)
    each.logs[0] = long_log(length)
    (reply,) = each.answer([Delivery(0, encode([Offer(0, 0)]), 0)])
    assert len(packet_codec.decode(reply.payload)) == count
    assert len(reply.payload) == 2 * count


LATE = [
    (ROUND + 20, 0, 0),
    (ROUND + 20, ROUND + 5, 0),
    (ROUND + 20, ROUND - 1, 0),
    (ROUND + INDEX_WINDOW + 20, ROUND + 5, 0),
    (2 * ROUND + 7, ROUND + 3, 3),
    (2 * ROUND + 7, 12, 12),
    (3 * ROUND, 3 * ROUND - 1, 5),
    (ROUND + 20, ROUND + 5, ROUND + 1),
    (ROUND + 20, ROUND + 5, ROUND - 1),
]


@pytest.mark.parametrize(("mine", "theirs", "table"), LATE)
def test_a_peer_that_got_far_ahead_of_the_table_goes_on_where_it_is(
    mine: int, theirs: int, table: int
) -> None:
    offerer, peer = engine(0, 3), engine(1, 3)
    offerer.logs[2].append(mine * [encode([Save()])])
    peer.logs[2].append(theirs * [encode([Save()])])
    offerer.peers.expected[1, 2] = table
    (offer,) = offerer.open_round(1, [1], 1000)
    (answer,) = peer.answer([Delivery(0, offer.payload, 0)])
    (data,) = offerer.send_data([Delivery(1, answer.payload, 0, 2)])
    sent = len(data.payload)
    assert sent == min(mine - theirs, 1000)
    offerer.close_round(closing(ConnectionReport(0, 2, len(answer.payload), sent)))
    assert offerer.peers.expected[1, 2] == theirs + sent


# Policies against their rules.


@st.composite
def tables(draw: st.DrawFn) -> tuple[int, np.random.Generator, Any, Any, Any]:
    """Team size, a generator, entries that peers hold, rounds in which offers are due, and log lengths."""
    robots, rng = draw(st.integers(2, 9)), np.random.default_rng(draw(seeds))
    shape = robots, robots
    return robots, rng, rng.integers(0, 4, shape), rng.integers(0, 6, shape), rng.integers(0, 6, robots)


def offered_by_the_rule(
    robot: int, peer: int, held: Any, due: Any, lengths: Any, now: int, number: int, single: bool
) -> int:
    own = lengths[robot] > held[peer][robot] and now >= due[peer][robot]
    if own and not single:
        return robot
    if number == 0 and not (single and now % 2 == 0):
        return robot if own else -1
    others = [
        each
        for each in range(len(lengths))
        if each not in (robot, peer) and lengths[each] > held[peer][each] and now >= due[peer][each]
    ]
    if others:
        return max(others, key=lambda each: lengths[each] - held[peer][each])
    return robot if own else -1


@given(tables(), st.integers(0, 1), st.integers(1, 6), st.booleans())
def test_backoff_offers_by_its_rule(team: Any, number: int, now: int, single: bool) -> None:
    robots, rng, held, due, lengths = team
    robot = int(rng.integers(robots))
    peers = [peer for peer in range(robots) if peer != robot]
    peer_table = PeerTable(robot, robots, robots)
    replica = Replica(peer_table, lambda *received: packet_index.ends(received[-1]), lambda _: None)
    for log, length in zip(replica.logs, lengths.tolist(), strict=True):
        log.append([b"entry"] * length)
    rounds = Rounds(replica, Backoff().offers, forwards=True)
    rounds.now, rounds.single = now - 1, single
    replica.peers.expected[:], rounds.due[:] = held, due
    by_the_rule = [
        (peer, offered_by_the_rule(robot, peer, held, due, lengths, now, number, single and number == 0))
        for peer in peers
    ]
    assert rounds.open(number, peers, None) == [
        (peer, of, held[peer, of]) for peer, of in by_the_rule if of >= 0
    ]


# Crowds: handshakes grow with the square of the team, the medium does not.


@given(st.integers(2, 40), st.none() | st.integers(0, 3000), policies)
def test_a_crowd_makes_no_more_offers_than_the_medium_can_carry_answers_to(
    robots: int, budget: int | None, policy: str
) -> None:
    network = Network(robots, policy)
    for robot in range(robots):
        network.append(robot, 1)
    made = [
        each.open_round(0, list(everyone(robots)[robot]), budget)
        for robot, each in enumerate(network.engines)
    ]
    assert all(len({frame.receiver for frame in offers}) == len(offers) for offers in made)
    most = robots - 1
    if policy == "backoff" and budget is not None and robots > CROWD:
        most = min(most, max(1, budget // LEAST_HANDSHAKE // robots))
        assert sum(map(len, made)) * LEAST_HANDSHAKE <= max(budget, robots * LEAST_HANDSHAKE)
    assert all(len(offers) == most for offers in made)


def test_in_a_crowd_every_robot_has_its_turn() -> None:
    robots, each = 30, engine(7, 30)
    each.append(entries(7, 0, 1))
    offered: list[int] = []
    while len(offered) < robots - 1:
        offered += [frame.receiver for frame in each.open_round(0, list(everyone(robots)[7]), 400)]
    assert offered[: robots - 1] == [*range(8, robots), *range(7)]


def test_the_logs_of_a_crowd_still_reach_all_robots() -> None:
    robots = CROWD + 4
    network = Network(robots, seed=1)
    for robot in range(robots):
        network.append(robot, 3)
    network.settle(everyone(robots), 500)


# Byzantine peers. The relay has checked the form of their frames, not their sense.


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
    each.append(entries(0, 0, 2))
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
    each.append(entries(0, 0, 2))
    assert each.open_round(0, [1], None)
    with pytest.raises(ProtocolError):
        each.send_data([Delivery(1, frame, 0, 0)])


def test_an_answer_to_an_offer_that_was_not_made_is_an_error() -> None:
    each = engine(0, 3)
    each.append(entries(0, 0, 2))
    each.open_round(0, [1], None)
    for peer, of in ((2, 0), (1, 1)):
        with pytest.raises(ProtocolError, match=f"robot {peer} answers an offer that was not made"):
            each.send_data([Delivery(peer, encode([Answer(0)]), 0, of)])


@pytest.mark.parametrize("claimed", [2, 3, 4095])
def test_no_entries_go_to_a_peer_that_claims_as_many_or_more(claimed: int) -> None:
    each = engine()
    each.append(entries(0, 0, 2))
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


def test_entries_that_all_in_range_hold_count_as_delivered() -> None:
    network = Network(3)
    network.append(0, 2)
    maker = network.engines[0]
    assert not maker.delivered()
    network.step({0: [1], 1: [0], 2: []})
    assert maker.delivered()
    assert maker.undelivered() == 2
    network.step(everyone(3))
    assert maker.undelivered() == 0
    network.append(0, 1)
    assert not maker.delivered()


def test_an_event_that_a_state_does_not_expect_is_an_error() -> None:
    with pytest.raises(KeyError):
        Connection(1, 1, state="refused").on("news")
