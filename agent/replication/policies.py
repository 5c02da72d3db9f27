"""Policies of unicast dissemination: which log ranges to offer to which peer in a round."""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left
from typing import ClassVar, NamedTuple

import numpy as np

from agent.replication.control_packets import LEAST_HANDSHAKE
from agent.replication.peers import Table
from agent.replication.replica import Replica

GOSSIP = "gossip"
"""The name of the dissemination without offers (`agent.replication.gossip`)."""

MAX_WAIT = 64
"""The most rounds for which an offer is postponed, if no round trip is known."""

CROWD = 16
"""Robots in range of each other above which ``backoff`` bounds handshakes by the medium's capacity."""


class Offer(NamedTuple):
    """A map, by its ID `number`, of which a peer is expected to lack the entries from offset `first` on."""

    peer: int
    number: int
    first: int


class Rounds:
    """The rounds of the medium as one robot sees them, and its offers in each."""

    def __init__(self, replica: Replica, dissemination: OfferDissemination, *, forwards: bool) -> None:
        self.peers = replica.peers
        self.now = 0
        """Rounds so far, over all steps."""
        self.number = 0
        """The round within its step, from 0."""
        self.single = True
        """Whether every step so far had one round only."""
        self.in_range: list[int] = []
        self.budget: int | None = None
        """Bytes left of the step's budget; None: no limit."""
        self.due = self.peers.delivery_table()
        """``due[peer, map]``: the round before which a map is not offered to the peer again."""
        self.tries = self.peers.delivery_table()
        """``tries[peer, map]``: offers that the peer refused in a row, or transmissions that no report followed."""
        self.next_peer = self.peers.robot + 1
        """The peer that a crowd's bounded offers go on with."""
        self._replica = replica
        self._dissemination = dissemination
        self._forwards = forwards
        """Whether maps of other robots are offered as well as this robot's own."""

    def open(self, number: int, in_range: list[int], budget: int | None) -> list[Offer]:
        """Begin the next round; return its offers."""
        self.now += 1
        self._replica.step += number == 0
        self.number = number
        self.single = self.single and number == 0
        self.in_range = in_range
        self.budget = budget
        lengths = self._replica.lengths()
        if not self._forwards:
            lengths[np.arange(len(lengths)) != self.peers.own] = 0
        return self._dissemination.offers(self, lengths) if in_range and lengths.any() else []

    def postpone(self, peer: int, map_id: int, first_wait: int, longest: int) -> None:
        """Offer a map to a peer again after `first_wait` rounds; they double with each further try, up to `longest`."""
        tries = self.tries.item(peer, map_id)
        self.due[peer, map_id] = self.now + min(first_wait << tries, longest)
        self.tries[peer, map_id] = tries + 1

    def delivered(self, most_tries: int) -> bool:
        """Return whether peers are in range, and each should hold this robot's log, or had over `most_tries` tries."""
        own, length = self.peers.own, self._replica.own_log.length
        expected, tries = self.peers.expected[:, own].tolist(), self.tries[:, own]
        return bool(self.in_range) and all(
            expected[peer] >= length or tries[peer] > most_tries for peer in self.in_range
        )


class OfferDissemination(ABC):
    """Robots offer log ranges to each other, and send the entries that the receiver asks for."""

    name: ClassVar[str]

    @abstractmethod
    def offers(self, rounds: Rounds, lengths: Table) -> list[Offer]:
        """Return the offers of a round, at most one per peer and map.

        `rounds` has the peers in range, the entries that each is known to hold, and the rounds so far; `lengths`, int64
        of shape (maps,), the entries of each map that this robot may offer.
        """


class Thesis(OfferDissemination):
    """Every peer in range is offered all that it lacks, this robot's map first."""

    name = "thesis"

    def offers(self, rounds: Rounds, lengths: Table) -> list[Offer]:
        """Return the offers of a round."""
        peers, held = rounds.peers, lengths.tolist()
        map_ids = [peers.own, *(map_id for map_id in range(len(held)) if map_id != peers.own)]
        return [
            Offer(peer, map_id, first)
            for peer in rounds.in_range
            for map_id in map_ids
            if map_id != peers.current[peer] and (first := peers.expected.item(peer, map_id)) < held[map_id]
        ]


class Backoff(OfferDissemination):
    """Every peer in range is offered one map at most, this robot's own first.

    After a refusal, a map waits twice as long as before (`Rounds.due`), as Ethernet does after a collision. Maps of
    other robots are offered after the first round of a step, the one with most missing entries first; if steps have
    only one round, own and other maps alternate. In a crowd (`CROWD`) robots offer to no more peers than the medium
    could carry answers of, in turn.
    """

    name = "backoff"

    def offers(self, rounds: Rounds, lengths: Table) -> list[Offer]:
        """Return the offers of a round."""
        in_range, now, own, expected = rounds.in_range, rounds.now, rounds.peers.own, rounds.peers.expected
        length = lengths.item(own)
        offers = {
            peer: Offer(peer, own, first)
            for peer in in_range
            if (first := expected.item(peer, own)) < length and now >= rounds.due.item(peer, own)
        }
        if rounds.number or (rounds.single and now % 2 == 0):
            missing = np.where(now >= rounds.due, lengths - expected, 0)
            missing[:, own] = 0
            missing[np.arange(rounds.peers.robots), rounds.peers.current] = 0
            most = missing.argmax(axis=1).tolist()
            for peer in in_range:
                map_id = most[peer]
                if (rounds.single or peer not in offers) and missing.item(peer, map_id) > 0:
                    offers[peer] = Offer(peer, map_id, expected.item(peer, map_id))
        chosen = [offers[peer] for peer in in_range if peer in offers]
        crowd = len(in_range) + 1
        if rounds.budget is None or crowd <= CROWD:
            return chosen
        most = max(1, rounds.budget // (LEAST_HANDSHAKE * crowd))
        if len(chosen) > most:
            first = bisect_left(chosen, (rounds.next_peer,))
            chosen = [*chosen[first:], *chosen[:first]][:most]
        if chosen:
            rounds.next_peer = chosen[-1].peer + 1
        return chosen
