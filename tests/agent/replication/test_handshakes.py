"""Handshakes on a perfect medium: logs reach all robots, frames may be cut, and answers are never ambiguous."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.replication.handshakes import Connection
from agent.replication.log import Log
from agent.replication.policies import MAX_WAIT
from protocol import packet_codec
from protocol.messages import ConnectionReport, Delivery
from protocol.packet_codec import encode
from protocol.packets import BLOCKS, INDEX_WINDOW, Answer, Offer, Save
from tests.agent.replication.handshake_ends import closing, declines, engine
from tests.agent.replication.network import Network, entries, entry, everyone, line

ROUND = BLOCKS * INDEX_WINDOW
seeds = st.integers(0, 2**32 - 1)
POLICIES = "backoff", "thesis"
policies = st.sampled_from(POLICIES)


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
    each.own_log.append(entries(0, 0, 5))
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
