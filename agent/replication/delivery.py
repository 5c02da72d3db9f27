"""Two ways for gossip to learn that entries arrived: the medium acknowledges them, or the peers do.

`MediumAcks`: on a medium that loses nothing, the send report is the acknowledgment.

`PeerAcks`: if the medium may lose, delay, repeat or reorder frames, a broadcast only raises what a peer is *expected*
to hold. Peers acknowledge by `Held` reports, or by sending entries themselves. An expectation that is not acknowledged
within the retransmission timeout is dropped, so the entries are broadcast again:

    event                                                       reaction
    entries are new, or were already held and came again        report the map within `_interval` steps
    entries came behind a gap                                   store them; report now and every `GAP_REPORTS` steps
    the gap was filled, and stored entries follow               report at once
    a peer reports no more than was acknowledged, though        drop the expectation
    it was sent more than a round trip ago
    a peer reports nothing for two round trips and the          drop the expectation
    interval in which it may postpone its report

Reports are suppressed to `SHARE` of the medium over the whole team, like receiver reports of RTP (RFC 3550).
"""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np

from agent.replication.peers import Mask, PeerTable, Table
from protocol.packets import Held

PATIENCE = 6
"""Steps after which a robot repeats its report of a gap, and after which the next peer forwards what another lacks."""

GAP_REPORTS = 2
"""Steps after which a gap is reported again where the medium may lose the report."""

SHARE = 8
"""The part of the medium that reports may take, as a divisor."""

MIN_ROUND_TRIP = 2
"""Steps in which a report can come back at the soonest."""

MAX_ROUND_TRIP = 64

NEVER = -1
"""The step of something that has not happened."""


class MediumAcks:
    """Acknowledgment by a medium without loss: a frame on the air has arrived at all peers in range.

    Most methods do nothing, since the send report is the only acknowledgment.
    """

    reliable = True
    """Whether all peers in range receive what is on the air."""
    gap_interval = PATIENCE
    """Steps between two reports of a gap."""
    turn = PATIENCE
    """Steps after which the next peer may forward what another lacks."""

    def __init__(self, peers: PeerTable) -> None:
        self._peers = peers

    def open_round(self, step: int, budget: int | None) -> None:
        """Drop expectations whose retransmission timeout is over; `budget`: bytes of a step that begins, else None."""

    def add_due(self, due: Mask, lengths: Table, step: int, last: Table) -> None:
        """Mark the maps to report in `due`, given log lengths and the step of each map's last report."""

    def report_sent(self, number: int, length: int) -> None:
        """Note that this robot's report of a map was on the air."""

    def report_received(self, peer: int, number: int, length: int, _step: int) -> None:
        """Note how many entries of a map a peer reports."""
        self._peers.expected[peer, number] = length

    def entries_received(self, peer: int, number: int, end: int, length: int) -> None:
        """Note that a peer sent entries of a map, before offset `end`; this robot holds `length` entries of it."""

    def store(self, peer: int, number: int, first: int, entries: list[bytes]) -> None:
        """Store entries that came behind a gap."""

    def stored(self, _number: int, _length: int) -> tuple[int, bytes] | None:
        """Take the entry at offset `length`, with its sender, if it came behind a gap."""
        return None

    def restarted(self, peer: int) -> None:
        """Expect nothing of a peer that lost its state."""

    def dropped(self, peer: int, number: int) -> None:
        """Expect nothing of entries that a peer dropped."""


class PeerAcks(MediumAcks):
    """Peers acknowledge."""

    reliable = False
    gap_interval = GAP_REPORTS

    def __init__(self, peers: PeerTable) -> None:
        super().__init__(peers)
        peers.acked = peers.new_table()
        self._expected_since: Table = np.full(peers.acked.shape, NEVER, np.int64)
        """The step since which a peer is expected to hold more than it acknowledged."""
        self._round_trip = np.full(peers.robots, MIN_ROUND_TRIP, np.int64)
        """Steps after which a report of each peer came back recently."""
        self._interval = PATIENCE
        """Steps within which this robot reports; longer on a narrow medium."""
        self._reported: Table = np.zeros(len(peers.maps), np.int64)
        """Length of each log in this robot's last report of it."""
        self._repeated: set[int] = set()
        """Maps of which entries came that were already held."""
        self._stored: defaultdict[int, dict[int, tuple[int, bytes]]] = defaultdict(dict)
        """Entries of each map that came behind a gap, by offset, with their senders."""

    def open_round(self, step: int, budget: int | None) -> None:
        """Drop expectations whose retransmission timeout is over."""
        if budget:
            robots = self._peers.robots
            self._interval = max(PATIENCE, math.ceil(SHARE * Held.size * robots * (robots - 1) / budget))
            self.turn = 2 * int(self._round_trip.max()) + self._interval
        expected, acked, since = self._peers.expected, self._peers.acked, self._expected_since
        open_ones = expected > acked
        since[~open_ones] = NEVER
        since[open_ones & (since == NEVER)] = step
        late = open_ones & (step - since > 2 * self._round_trip[:, None] + self._interval)
        expected[late] = acked[late]
        since[late] = NEVER

    def add_due(self, due: Mask, lengths: Table, step: int, last: Table) -> None:
        """Mark maps with news, or repeated entries, that were not reported within the interval."""
        news = lengths > self._reported
        news[list(self._repeated)] = True
        due |= news & (step >= last + self._interval)

    def report_sent(self, number: int, length: int) -> None:
        """Note that this robot's report of a map was on the air."""
        self._reported[number] = length
        self._repeated.discard(number)

    def report_received(self, peer: int, number: int, length: int, step: int) -> None:
        """Acknowledge entries, measure the round trip, and drop an expectation that the report contradicts."""
        expected, acked = self._peers.expected, self._peers.acked
        before, since = int(acked[peer, number]), int(self._expected_since[peer, number])
        if length > before or len(self._peers.maps) > self._peers.robots:
            acked[peer, number] = length
            if since != NEVER and length > before:
                round_trip = max(step - since, int(self._round_trip[peer]) - 1)
                self._round_trip[peer] = min(max(round_trip, MIN_ROUND_TRIP), MAX_ROUND_TRIP)
                self._expected_since[peer, number] = step
        if since != NEVER and length <= before and step - since >= self._round_trip[peer]:
            expected[peer, number] = length
        expected[peer, number] = max(int(expected[peer, number]), length)

    def entries_received(self, peer: int, number: int, end: int, length: int) -> None:
        """Note that a peer sent entries up to offset `end`, and so holds them; this robot holds `length`."""
        self._peers.acked[peer, number] = max(int(self._peers.acked[peer, number]), end)
        if end <= length:
            self._repeated.add(number)

    def store(self, peer: int, number: int, first: int, entries: list[bytes]) -> None:
        """Store entries that came behind a gap."""
        self._stored[number] |= {offset: (peer, entry) for offset, entry in enumerate(entries, first)}

    def stored(self, number: int, length: int) -> tuple[int, bytes] | None:
        """Take the stored entry at offset `length`; if there is none, drop those before it."""
        entry = self._stored[number].pop(length, None)
        if entry is None:
            self._stored[number] = {at: each for at, each in self._stored[number].items() if at > length}
        return entry

    def restarted(self, peer: int) -> None:
        """Expect nothing of a peer that lost its state."""
        self._expected_since[peer] = NEVER

    def dropped(self, peer: int, number: int) -> None:
        """Expect nothing of entries that a peer dropped."""
        self._expected_since[peer, number] = NEVER
