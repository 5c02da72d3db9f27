"""Acknowledgments in gossip: how a robot learns that entries arrived.

On a reliable medium, which loses nothing, the send report is the acknowledgment. If the medium may lose, delay,
repeat or reorder frames, a broadcast only raises the number of entries that a peer is *expected* to hold. Peers
acknowledge by `Held` reports (`reports`), or by sending entries themselves. An expectation that is not acknowledged
within the retransmission timeout is dropped, so the entries are broadcast again:

    event                                                       reaction
    entries came behind a gap                                   store them until the gap is filled
    a report, more than a round trip after the broadcast,       drop the expectation
    acknowledges no more entries than before
    no report for two round trips and the interval in which     drop the expectation
    the peer may postpone it
"""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np

from agent.replication.peers import NEVER
from agent.replication.replica import Replica
from protocol.packets import Held

PATIENCE = 6
"""Steps after which a robot repeats its report of a gap, and after which the next peer forwards missing entries."""

SHARE = 8
"""The part of the medium that all reports together may take, as a divisor; as for receivers of RTP (RFC 3550)."""

MIN_ROUND_TRIP, MAX_ROUND_TRIP = 2, 64
"""Steps until a report can come back: the minimum, and the maximum that is counted."""


class Acks:
    """Acknowledgments of all peers, by the medium (`PeerTable.reliable`) or by reports.

    On a reliable medium all peers in range receive what is on the air, so nothing times out, and nothing is stored.
    """

    def __init__(self, replica: Replica) -> None:
        peers = self._peers = replica.peers
        self.interval = PATIENCE
        """Steps within which a robot acknowledges entries; longer on a narrow medium."""
        self.turn = PATIENCE
        """Steps after which the next peer may forward entries that another lacks."""
        self._replica = replica
        if not peers.reliable:
            peers.acked = peers.new_table()
        self._expected_since = peers.delivery_table(NEVER)
        """The step since which a peer is expected to hold more than it acknowledged."""
        self._round_trip = np.full(peers.robots, MIN_ROUND_TRIP, np.int64)
        """Steps after which a report of each peer came back recently."""
        self._stored: defaultdict[int, dict[int, tuple[int, bytes]]] = defaultdict(dict)
        """Entries of each map that came behind a gap, by offset, with their senders."""

    def begin_step(self, budget: int | None) -> None:
        """Adapt intervals to the bytes that the team may send in this step (None: no limit)."""
        if budget and not self._peers.reliable:
            robots = self._peers.robots
            self.interval = max(PATIENCE, math.ceil(SHARE * Held.size * robots * (robots - 1) / budget))
            self.turn = 2 * int(self._round_trip.max()) + self.interval

    def drop_late(self) -> None:
        """Drop expectations whose retransmission timeout is over."""
        if self._peers.reliable:
            return
        step = self._replica.step
        expected, acked, since = self._peers.expected, self._peers.acked, self._expected_since
        open_ones = expected > acked
        since[~open_ones] = NEVER
        since[open_ones & (since == NEVER)] = step
        late = open_ones & (step - since > 2 * self._round_trip[:, None] + self.interval)
        expected[late] = acked[late]
        since[late] = NEVER

    def report_received(self, peer: int, number: int, length: int) -> None:
        """Acknowledge entries, measure the round trip, and drop an expectation that the report contradicts."""
        expected, acked, step = self._peers.expected, self._peers.acked, self._replica.step
        before, since = int(acked[peer, number]), int(self._expected_since[peer, number])
        if length > before or self._peers.may_restart:
            acked[peer, number] = length
            if since != NEVER and length > before:
                round_trip = max(step - since, int(self._round_trip[peer]) - 1)
                self._round_trip[peer] = min(max(round_trip, MIN_ROUND_TRIP), MAX_ROUND_TRIP)
                self._expected_since[peer, number] = step
        if since != NEVER and length <= before and step - since >= self._round_trip[peer]:
            expected[peer, number] = length
        self._peers.expect(peer, number, length)

    def store(self, peer: int, number: int, first: int, entries: list[bytes]) -> None:
        """Store entries that came behind a gap; on a reliable medium their sender sends them again."""
        if not self._peers.reliable:
            self._stored[number] |= {offset: (peer, entry) for offset, entry in enumerate(entries, first)}

    def stored(self, number: int, length: int) -> tuple[int, bytes] | None:
        """Take the stored entry at offset `length`, with its sender; if there is none, drop those before it."""
        stored = {at: each for at, each in self._stored[number].items() if at >= length}
        self._stored[number] = stored
        return stored.pop(length, None)
