"""Policies of unicast dissemination: which log ranges to offer to which peer in a round.

A policy is a function of the peer table, the log lengths and the round. `thesis` offers every peer all that it lacks.
`backoff` offers each peer one map at most, this robot's own first; after a refusal it waits twice as long, as Ethernet
does after a collision. Maps of other robots are offered after the first round of a step, the one with most missing
entries first; if steps have only one round, own and other maps alternate. In a crowd (`CROWD`) robots offer to no more
peers than the medium could carry answers of, in turn.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from agent.replication.handshake_packets import LEAST_HANDSHAKE
from agent.replication.peers import PeerTable, Table
from protocol.arrays import Int64Rows, Int64s
from protocol.kernels import kernel

CROWD = 16
"""Robots in range of each other above which ``backoff`` bounds handshakes by the medium's capacity: at this size 240
offers a round take 960 bytes with their answers."""


class LogRange(NamedTuple):
    """Entries `first` to `end` - 1 of a map's log, for one peer."""

    receiver: int
    number: int
    first: int
    end: int


@dataclass
class Round:
    """The round that the medium is in, as one robot sees it."""

    next_peer: int
    """The peer that a crowd's bounded offers go on with."""
    now: int = 0
    """Rounds so far, over all steps."""
    number: int = 0
    """The round within its step, from 0."""
    single: bool = True
    """Whether every step so far had one round only."""
    in_range: list[int] = field(default_factory=list)
    budget: int | None = None
    """Bytes left of the step's budget; None: no limit."""

    def open(self, number: int, in_range: list[int], budget: int | None) -> None:
        """Begin the next round."""
        self.now += 1
        self.number = number
        self.single = self.single and number == 0
        self.in_range = in_range
        self.budget = budget


Policy = Callable[[PeerTable, Round, Table], list[LogRange]]
"""Chooses ranges, in order, given the peer table, the round, and the number of entries of each map to offer."""


def offerable(peers: PeerTable, lengths: Table, *, forwards: bool) -> Table:
    """Return the log lengths, zero for maps that are not offered: if not `forwards`, all but this robot's."""
    return lengths if forwards else np.where(np.arange(len(lengths)) == peers.own, lengths, 0)


def thesis(peers: PeerTable, now: Round, lengths: Table) -> list[LogRange]:
    """Offer every peer in range all that it lacks, this robot's map first."""
    expected, held = peers.expected, lengths.tolist()
    numbers = [peers.own, *(number for number in range(len(held)) if number != peers.own)]
    return [
        LogRange(peer, number, first, held[number])
        for peer in now.in_range
        for number in numbers
        if number != peers.current[peer] and (first := expected.item(peer, number)) < held[number]
    ]


def backoff(peers: PeerTable, now: Round, lengths: Table) -> list[LogRange]:
    """Offer every peer in range one map at most, with binary exponential back-off after refusals."""
    chosen = np.empty(len(now.in_range), np.int64)
    in_range, current = np.array(now.in_range, np.int64), np.array(peers.current, np.int64)
    rule = now.now, now.number, now.single
    choose_offers(peers.expected, peers.due, lengths, in_range, current, peers.own, *rule, chosen)
    offers = [
        LogRange(peer, number, peers.expected.item(peer, number), lengths.item(number))
        for peer, number in zip(now.in_range, chosen.tolist(), strict=True)
        if number >= 0
    ]
    crowd = len(now.in_range) + 1
    if now.budget is None or crowd <= CROWD:
        return offers
    return _in_turn(offers, now, max(1, now.budget // (LEAST_HANDSHAKE * crowd)))


def _in_turn(offers: list[LogRange], now: Round, most: int) -> list[LogRange]:
    """Return `most` offers, of those sorted by receiver, from the next receiver on."""
    if len(offers) > most:
        first = bisect_left(offers, (now.next_peer,))
        offers = [*offers[first:], *offers[:first]][:most]
    if offers:
        now.next_peer = offers[-1].receiver + 1
    return offers


POLICIES: dict[str, Policy] = {"backoff": backoff, "thesis": thesis}

GOSSIP = "gossip"

DISSEMINATIONS = (*POLICIES, GOSSIP)
"""The values of the scenario's setting `dissemination`."""


@kernel
def choose_offers(
    expected: Int64Rows,
    due: Int64Rows,
    lengths: Int64s,
    in_range: Int64s,
    current: Int64s,
    own: int,
    now: int,
    round_number: int,
    single: bool,
    chosen: Int64s,
) -> None:
    """Choose for each peer the map to offer by the rule ``backoff``; -1: none."""
    turn_of_others = round_number != 0 or (single and now % 2 == 0)
    for each in range(len(in_range)):
        peer = in_range[each]
        own_due = lengths[own] > expected[peer, own] and now >= due[peer, own]
        chosen[each] = own if own_due else -1
        if (own_due and not single) or not turn_of_others:
            continue
        most = 0
        for number in range(len(lengths)):
            missing = lengths[number] - expected[peer, number]
            if missing > most and number not in (own, current[peer]) and now >= due[peer, number]:
                most = missing
                chosen[each] = number
