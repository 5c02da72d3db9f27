"""Acknowledgments in gossip: how a robot learns that entries arrived.

On a reliable medium, which loses nothing, the send report is the acknowledgment. If the medium may lose, delay,
repeat or reorder frames, a broadcast only raises the number of entries that a peer is *expected* to hold. Peers
acknowledge by reports (`reports`), or by sending entries themselves. Only entries that a report shows to be lost are
sent again, as with negative acknowledgments (NORM, RFC 5740):

    event                                                       reaction
    entries came behind a gap                                   store them until the gap is filled, report the gap
    a peer reports a gap                                        send the entries of the gap again
    a peer reports fewer entries than expected, without a gap,  send all entries again from there on
    longer after the last broadcast than frames may take
    this robot sent entries of a map, and a peer in range has   ask for reports of this map (`Acks.unacknowledged`)
    not acknowledged them `turn` steps later
"""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np

from agent.replication.peers import NEVER, Mask, Table, raise_lengths
from agent.replication.replica import Replica
from protocol.packets import Held

PATIENCE = 6
"""Least steps within which entries are acknowledged, and after which the next peer forwards missing entries; on a
reliable medium, also those after which a map is reported again."""

URGENT = 2
"""Least steps after which a robot repeats its report of a gap on a lossy medium."""

SHARE = 8
"""The part of the medium that all reports together may take, as a divisor; as for receivers of RTP (RFC 3550)."""

WINDOW = 4096
"""Entries are stored only if they begin fewer than so many entries after the end of a log; else a forger could fill
the memory."""


class Acks:
    """Acknowledgments of all peers, by the medium (`PeerTable.reliable`) or by reports.

    On a reliable medium all peers in range receive what is on the air, so nothing times out, and nothing is stored.
    """

    def __init__(self, replica: Replica) -> None:
        peers = self._peers = replica.peers
        self.interval = PATIENCE
        """Steps within which a robot acknowledges entries; longer on a narrow medium."""
        self.urgent_interval = PATIENCE if peers.reliable else URGENT
        """Steps after which a map may be reported again if entries are missing."""
        self.turn = PATIENCE
        """Steps after which a robot asks a silent peer for a report, and after which the next peer may forward entries
        that another lacks."""
        self._replica = replica
        if not peers.reliable:
            peers.acked = peers.new_table()
        self._sent_at = peers.delivery_table(NEVER)
        """The step in which a peer was last sent entries that it has not acknowledged."""
        self._asked_at: Table = np.full(peers.maps, NEVER, np.int64)
        """The step in which this robot last sent entries of each map, or asked for reports of it; `NEVER`: it need not
        ask."""
        self._repaired_at = peers.delivery_table(NEVER)
        """The step in which a peer was last sent the entries of a gap."""
        self._reported_at = peers.delivery_table(NEVER)
        """The step of a peer's last report."""
        self._gap_ends = peers.delivery_table()
        """The offset of the first entry behind a gap in a peer's log; 0: there is no gap."""
        self._sent_end = peers.delivery_table()
        """The offset after the last entry that a peer was sent: it should hold so many once its gap is filled."""
        self._stored: defaultdict[int, dict[int, tuple[int, bytes]]] = defaultdict(dict)
        """Entries of each map that came behind a gap, by offset, with their senders."""

    def begin_step(self, budget: int | None) -> None:
        """Adapt intervals to the bytes that the team may send in this step (None: no limit)."""
        if budget and not self._peers.reliable:
            robots = self._peers.robots
            self.interval = max(PATIENCE, math.ceil(SHARE * Held.size * robots * (robots - 1) / budget))
            self.urgent_interval = max(URGENT, self.interval // SHARE)
            self.turn = self.interval + PATIENCE

    def sent(self, map_id: int, receivers: Mask, first: int, end: int) -> None:
        """Note that receivers were sent entries `first` to `end` - 1 of a map, by which their gaps may be filled."""
        expected = self._peers.expected.T[map_id]
        raise_lengths(expected, receivers, first, end)
        if self._peers.reliable:
            return
        sent_end, gap_ends, step = self._sent_end.T[map_id], self._gap_ends.T[map_id], self._replica.step
        gap_ends[receivers & (gap_ends == 0) & (expected < first)] = first
        raise_lengths(sent_end, receivers, 0, end)
        filled = (gap_ends > 0) & (expected >= gap_ends)
        expected[filled] = np.maximum(expected, sent_end)[filled]
        self._repaired_at.T[map_id][filled] = step
        gap_ends[filled] = 0
        self._sent_at.T[map_id][receivers & (expected > self._peers.acked.T[map_id])] = step

    def gap_end(self, peer: int, map_id: int) -> int:
        """Return the offset of the first entry of a map that a peer holds behind a gap; 0: no gap is known."""
        return self._gap_ends.item(peer, map_id)

    def waited(self, peer: int, map_id: int, since: int) -> int:
        """Return for how many steps after `since` a peer has lacked entries; on a lossy medium, by its last report."""
        end = self._replica.step if self._peers.reliable else self._reported_at.item(peer, map_id)
        return max(0, end - since)

    def broadcast(self, map_id: int) -> None:
        """Note that this robot sent entries of a map, of which it may have to ask for reports."""
        self._asked_at[map_id] = self._replica.step

    def unacknowledged(self, in_range: list[int]) -> Mask:
        """Return for each map whether a peer in range has not acknowledged entries of it that it was sent.

        This robot was the last to send these entries, `turn` steps ago or earlier.
        """
        latest = self._replica.step - self.turn
        unacknowledged = (self._asked_at > NEVER) & (self._asked_at < latest)
        late = unacknowledged.nonzero()[0]
        expected, acked = self._peers.expected.T[late], self._peers.acked.T[late]
        is_open = (expected > acked) & (self._sent_at.T[late] < latest)
        unacknowledged[late] = is_open[:, in_range].any(axis=1)
        return unacknowledged

    def asked(self, map_id: int) -> None:
        """Note that this robot asked for reports of a map: of its own it asks again and again, of others once."""
        self._asked_at[map_id] = self._replica.step if map_id == self._peers.own else NEVER

    def report_received(self, peer: int, map_id: int, length: int, gap_end: int) -> None:
        """Take a report that a peer holds so many entries of a map, and those from `gap_end` on if there is a gap."""
        expected, acked, step = self._peers.expected, self._peers.acked, self._replica.step
        if length > acked.item(peer, map_id) or self._peers.may_restart:
            acked[peer, map_id] = length
        self._reported_at[peer, map_id] = step
        if 0 < self.gap_end(peer, map_id) <= length:
            self._gap_ends[peer, map_id] = 0
            self._peers.expect(peer, map_id, self._sent_end.item(peer, map_id))
        before = int(expected.item(peer, map_id))
        is_gap = gap_end > length
        sent_at = (self._repaired_at if is_gap else self._sent_at).item(peer, map_id)
        if length <= before and (sent_at == NEVER or step - sent_at > self._peers.round_trip):
            expected[peer, map_id] = length
            self._gap_ends[peer, map_id] = gap_end if is_gap else 0
        self._peers.expect(peer, map_id, length)

    def is_behind(self, lengths: Table, in_range: list[int]) -> Mask:
        """Return for each map whether a peer in range certainly holds more entries of it than this robot."""
        return np.asarray((self._peers.acked[in_range] > lengths).any(axis=0))

    def store(self, peer: int, map_id: int, first: int, entries: list[bytes]) -> None:
        """Store entries that came behind a gap; on a reliable medium their sender sends them again."""
        if not self._peers.reliable and first < len(self._replica.logs[map_id]) + WINDOW:
            self._stored[map_id] |= {offset: (peer, entry) for offset, entry in enumerate(entries, first)}

    def gaps(self) -> list[int]:
        """Return the IDs of the maps of which entries are stored behind a gap."""
        return [map_id for map_id, stored in self._stored.items() if stored]

    def first_stored(self, map_id: int) -> int | None:
        """Return the offset of the first entry of a map that is stored behind a gap; None if there is none."""
        return min(self._stored[map_id], default=None)

    def stored(self, map_id: int, length: int) -> tuple[int, bytes] | None:
        """Take the stored entry at offset `length`, with its sender; if there is none, drop those before it."""
        stored = self._stored[map_id]
        if stored and length not in stored:
            self._stored[map_id] = {at: each for at, each in stored.items() if at > length}
        return stored.pop(length, None)
