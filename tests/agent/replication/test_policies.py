"""Policies of offers against their rules, and in crowds."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from agent.replication.control_packets import LEAST_HANDSHAKE
from agent.replication.peers import PeerTable
from agent.replication.policies import CROWD, Backoff, Rounds
from agent.replication.replica import Replica
from protocol import packet_index
from tests.agent.replication.handshake_ends import engine
from tests.agent.replication.network import Network, entries, everyone

seeds = st.integers(0, 2**32 - 1)
policies = st.sampled_from(("backoff", "thesis"))


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
    rounds = Rounds(replica, Backoff(), forwards=True)
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
    each.own_log.append(entries(7, 0, 1))
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
