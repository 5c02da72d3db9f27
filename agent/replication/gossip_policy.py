"""The policy of gossip: which log ranges to broadcast, on whose behalf, and with which priority.

The peer that holds the most entries is served first; for it, this robot's own map, then the map of which it misses the
fewest. So peers that keep up receive new entries before others catch up with old ones.

Of several robots that could forward what a peer lacks, one does: the author if it is in range, else they take turns.
The others suppress their broadcasts, and join in if the peer still lacks the entries some steps later.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from operator import attrgetter

import numpy as np

from agent.encodings.base import Dependency
from agent.replication.delivery import Acks
from agent.replication.neighbors import Links
from agent.replication.peers import Table
from agent.replication.replica import Replica
from protocol.arrays import Int64Rows, Int64s
from protocol.kernels import kernel

Dependencies = Callable[[int], Sequence[Dependency]]
"""Returns, for a map ID, its log ranges that depend on other logs, in order (`MapEncoding.dependencies`)."""

Add = Callable[[int, int, int], int]
"""Adds a log range (map ID, first, end) to the frame; returns the offset after the last entry that fits."""

MAX_PRIORITY = 255

KEEPING_UP = 64
"""Entries: the fewer a peer lacks below this number, the higher the priority of serving it."""

LONG = 64
"""Bytes up to which a longer frame has a higher priority."""

AGING = 2
"""Priority added per step of waiting."""

HELD_PER_PRIORITY = 4
"""Entries held by the served peer for each unit of priority, once robots have been out of range."""

MAX_HELD_PRIORITY = 200

MAX_LENGTH = 1 << 62
"""Longer than any log; stands for what a peer holds of its own map."""


class GossipPolicy:
    """What peers in range lack, since when, and which of that this robot broadcasts."""

    def __init__(self, replica: Replica, links: Links, acks: Acks, dependencies: Dependencies) -> None:
        self._replica = replica
        self._peers = replica.peers
        self._logs = replica.logs
        self._links = links
        self._acks = acks
        self._dependencies = dependencies
        self._lacks: dict[int, dict[int, int]] = {}
        """By peer and map ID: how many entries this robot holds that the peer should not hold yet."""
        self._since = self._peers.new_table()
        """``_since[peer, map]``: the step since which the peer lacks some."""
        self._served: int | None = None
        """The peer that this round's frame serves first."""
        self._repairs = False
        """Whether this round's frame has entries of a gap."""
        self._sent: dict[int, tuple[int, int]] = {}
        """The range of each map that is in this round's frame."""
        self._too_long: set[tuple[int, int]] = set()
        """Map IDs and first offsets of entries for which this round's frame has no room."""

    def compare(self, known: list[int], lengths: Table) -> None:
        """Compare log lengths with the version vectors of the peers in range whose report is not awaited."""
        before, self._lacks = self._lacks, {}
        current = self._peers.current
        missing: Table = _missing(np.array(known, np.int64), self._peers.expected.T, lengths)
        for peer, map_id, count in missing.tolist():
            if map_id != current[peer]:
                self._lacks.setdefault(peer, {})[map_id] = count
                if map_id not in before.get(peer, ()):
                    self._since[peer, map_id] = self._replica.step

    def serve(self, add: Add) -> None:
        """Add what peers lack to this round's frame."""
        self._served, self._sent, self._too_long = None, {}, set()
        held: dict[int, list[int]] = {peer: self._peers.expected[peer].tolist() for peer in self._lacks}
        order = sorted(held, key=lambda each: (-sum(held[each]), each))
        for peer, will_hold in held.items():
            will_hold[self._peers.current[peer]] = MAX_LENGTH
        repairs = [] if self._peers.reliable else self._gaps()
        for peer, map_id, end in repairs:
            self._bring(add, peer, held[peer], map_id, end)
        self._repairs = bool(self._sent)
        for peer in order:
            will_hold, lacks = held[peer], self._lacks[peer]
            for map_id in sorted(lacks, key=lambda each: (each != self._peers.own, lacks[each], each)):
                if not self._acks.gap_end(peer, map_id):
                    self._bring(add, peer, will_hold, map_id, len(self._logs[map_id]))
            if self._served is None and self._sent:
                self._served = peer

    def _gaps(self) -> list[tuple[int, int, int]]:
        """Return the gaps in the logs of peers: the peer, the map ID, and the end of the gap."""
        return [
            (peer, map_id, end)
            for peer, lacks in sorted(self._lacks.items())
            for map_id in sorted(lacks)
            if (end := min(self._acks.gap_end(peer, map_id), len(self._logs[map_id])))
        ]

    def _bring(self, add: Add, peer: int, will_hold: list[int], map_id: int, end: int) -> None:
        """Send the entries of a map before offset `end` that a peer lacks, each range behind those on which it depends.

        `will_hold` are the peer's log lengths once it has received the frame.
        """
        dependencies = self._dependencies(map_id)
        for each in dependencies[bisect_right(dependencies, will_hold[map_id], key=attrgetter("end")) :]:
            if each.first >= end:
                break
            if _lacks_any(will_hold, each.requires):
                self._send(add, peer, will_hold, map_id, each.first)
                for other, length in each.requires:
                    self._bring(add, peer, will_hold, other, length)
                if _lacks_any(will_hold, each.requires):
                    return
        self._send(add, peer, will_hold, map_id, end)

    def _send(self, add: Add, peer: int, will_hold: list[int], map_id: int, end: int) -> None:
        """Send the entries of a map before offset `end` that a peer lacks, unless the frame has them already."""
        first = will_hold[map_id]
        if first >= end:
            return
        low, high = self._sent.get(map_id, (end, end))
        if low <= first:
            first = max(first, high)
        else:
            end = min(end, low)
        if first < end and (map_id == self._peers.own or self._is_forwarder(peer, map_id)):
            is_too_long = (map_id, first) in self._too_long
            end = first if is_too_long else add(map_id, first, end)
            if end > first:
                low, high = self._sent.get(map_id, (first, end))
                self._sent[map_id] = min(low, first), max(high, end)
            else:
                self._too_long.add((map_id, first))
        will_hold[map_id] = max(first, end)

    def _is_forwarder(self, peer: int, map_id: int) -> bool:
        """Return whether it is this robot's turn to forward what a peer lacks of a map.

        Candidates hold more of the map and are in range of the peer. After each `Acks.turn`, one more forwards it.
        """
        current, expected, robots = self._peers.current, self._peers.expected, self._peers.robots
        candidates = [
            each
            for each in self._links.in_range
            if self._links.near[each, peer]
            and (current[each] == map_id or expected[each, map_id] > expected[peer, map_id])
        ]
        candidates.append(self._peers.robot)
        candidates.sort(key=lambda each: (current[each] != map_id, (each - map_id) % robots))
        waited = self._acks.waited(peer, map_id, self._since.item(peer, map_id))
        return candidates.index(self._peers.robot) <= waited // self._acks.turn

    def priority(self, size: int, waited: int, urgency: float | None) -> int:
        """Return the priority of this round's frame, of `size` bytes, which waited for some steps.

        If robots have been out of range: the more the peer holds that is served first, the higher. Else frames come
        first if a part of the entries appended last has been on the air, and the rest has not; then those that fill a
        gap. Others rank by `urgency` of own entries and the steps that they waited, or else by how few entries the peer
        lacks, and by their size.
        """
        served, log = self._served, self._replica.own_log
        if self._links.have_parted:
            held = 0 if served is None else int(self._peers.expected[served].sum())
            priority = min(MAX_HELD_PRIORITY, held // HELD_PER_PRIORITY)
        elif log.last_append < log.shared < log.length:
            return MAX_PRIORITY
        elif self._repairs:
            return MAX_PRIORITY - 1
        elif urgency is not None and log.shared < log.length:
            return min(MAX_PRIORITY - 1, int(max(1.0, urgency) * (1 + waited)))
        else:
            lacks = 0 if served is None else sum(self._lacks[served].values())
            priority = max(0, KEEPING_UP - lacks) + min(LONG, size)
        return min(MAX_PRIORITY - 1, priority + AGING * waited)


def _lacks_any(held: list[int], requires: tuple[tuple[int, int], ...]) -> bool:
    """Return whether a peer that holds so many entries of each map lacks any of these dependencies."""
    for map_id, length in requires:  # noqa: SIM110  a generator takes twice as long
        if held[map_id] < length:
            return True
    return False


@kernel
def _missing(peers: Int64s, expected: Int64Rows, lengths: Int64s) -> Int64Rows:
    """Return rows (peer, map ID, count): how many entries of a map each of `peers` is expected to lack.

    `expected` has a row for each map.
    """
    rows = np.empty((len(peers) * len(lengths), 3), np.int64)
    count = 0
    for peer in peers:
        for map_id in range(len(lengths)):
            if expected[map_id, peer] < lengths[map_id]:
                rows[count] = peer, map_id, lengths[map_id] - expected[map_id, peer]
                count += 1
    return rows[:count].copy()
