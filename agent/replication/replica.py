"""This robot's replica of all maps: the logs, the peer table, and the check of received entries.

Entries are decoded as they arrive, and verified later by digests, which only the author can send
(`agent.replication.digests`):

    event                                              reaction
    an author's digest matches                         the entries are verified; their forwarders are trusted again
    it does not match                                  drop all entries that are not verified; suspect the forwarders
    entries cannot be decoded                          drop them; suspect the sender
    entries at the same offset fail again and again    drop all entries that are not verified: they may be wrong

A robot that dropped entries broadcasts the length of its log (`packets.Held`). Peers then send the entries again, and
the author sends a digest. From a suspected sender the robot accepts no entries of that map for a while, which doubles
with every suspicion.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from agent.replication.digests import LogVerifier
from agent.replication.log import Log, OwnLog
from agent.replication.peers import PeerTable, Table
from protocol.errors import ProtocolError
from protocol.packets import LogDigest

Consume = Callable[[int, int, bytes], Sequence[int]]
"""Decodes the next entries of a map, given the sender, the map's ID, and a frame of whole entries; returns where
each entry ends. Raises ProtocolError, and changes nothing, if entries are malformed or impossible."""

Rebuild = Callable[[Sequence[bytes]], object]
"""Decodes all logs, by map ID, again from their beginnings: entries that were decoded have been dropped."""

TRIES = 3
"""Failures at the same offset after which one more drops the entries in front of it, without a digest."""

MANY = 5
"""Suspicions after which a sender counts as distrusted."""

LONGEST = 64
"""The most steps for which a suspected sender's entries are not accepted, and until a robot asks again."""

ASK_AGAIN = 4
"""Steps until a robot asks again for entries for the first time; then it waits twice as long each time."""


class Rejected(NamedTuple):
    """Event: entries that a peer sent were malformed, impossible, or not written by their author."""

    peer: int
    reason: str


class Replica:
    """Logs by map ID, and the number of entries that peers hold of each.

    `rebuild` is called after decoded entries were dropped.
    """

    def __init__(self, peers: PeerTable, consume: Consume, rebuild: Rebuild) -> None:
        self.peers = peers
        self.own_log = OwnLog()
        self.logs = [self.own_log if map_id == peers.own else Log() for map_id in range(peers.maps)]
        self.verifiers = [LogVerifier(log, ordered=peers.reliable) for log in self.logs]
        self.step = 0
        """Steps so far."""
        self._requests: dict[int, tuple[int, int, int]] = {}
        """By ID of a map of which entries were dropped: the length of the log that ends the request, the step in
        which to ask, and the steps from then until this robot asks again."""
        self._suspicions: Counter[tuple[int, int]] = Counter()
        """How often entries of a (peer, map ID) were wrong."""
        self._until: dict[tuple[int, int], int] = {}
        """(peer, map ID): the step before which no entries are accepted."""
        self._senders: defaultdict[int, set[int]] = defaultdict(set)
        """Peers that sent entries of each map which are not verified."""
        self._failed: dict[int, tuple[int, int]] = {}
        """Length of a log at which entries could not be decoded, and how often."""
        self.dropped: set[int] = set()
        """IDs of the maps of which entries were dropped, until the caller removes them."""
        self._consume = consume
        self._rebuild = rebuild
        self._rejected: list[Rejected] = []

    @property
    def distrusted(self) -> set[int]:
        """Peers that sent wrong entries `MANY` times."""
        return {peer for (peer, _), count in self._suspicions.items() if count >= MANY}

    def has_forwarded(self) -> bool:
        """Return whether entries that are not verified may come from a peer that is not their author."""
        return any(senders - {self.peers.author(map_id)} for map_id, senders in self._senders.items())

    def lengths(self) -> Table:
        """Return the number of entries of each log."""
        return np.array([log.length for log in self.logs], np.int64)

    def refuses(self, peer: int, map_id: int) -> bool:
        """Return whether a peer's entries of a map are not accepted in this step."""
        return self.step < self._until.get((peer, map_id), 0)

    def accept(self, peer: int, map_id: int, frame: bytes) -> bool:
        """Decode and append the next entries of a map that a peer sent; return whether they were accepted."""
        if self.refuses(peer, map_id):
            return False
        log = self.logs[map_id]
        try:
            ends = self._consume(peer, map_id, frame)
        except ProtocolError as error:
            self.reject(peer, map_id, str(error))
            return False
        log.extend(frame, ends)
        self._senders[map_id].add(peer)
        self._verify(map_id)
        return True

    def receive(self, peer: int, map_id: int, first: int, entries: list[bytes]) -> None:
        """Accept those of a peer's entries, from offset `first` on, that are next in the log of a map."""
        length = len(self.logs[map_id])
        if map_id == self.peers.own:
            self._check_own(peer, first, entries)
        elif first <= length < first + len(entries) and map_id not in self.peers.own_maps:
            self.accept(peer, map_id, b"".join(entries[length - first :]))

    def receive_digest(self, peer: int, digest: LogDigest) -> None:
        """Take the digest that a peer broadcasts of its own log."""
        map_id = self.peers.current[peer]
        self.verifiers[map_id].receive(digest)
        self._verify(map_id)

    def reject(self, peer: int, map_id: int, reason: str) -> None:
        """Suspect a peer of wrong entries of a map, which were not appended."""
        if self.refuses(peer, map_id):
            return
        self._suspect(peer, map_id, reason)
        length = len(self.logs[map_id])
        before, tries = self._failed.get(map_id, (length, 0))
        self._failed[map_id] = length, tries + 1 if before == length else 1
        if tries >= TRIES and length > self.verifiers[map_id].length:
            self._drop(map_id)
        else:
            self._ask(map_id, length + 1)

    def take_rejected(self) -> list[Rejected]:
        """Return the rejections since the last call."""
        rejected, self._rejected = self._rejected, []
        return rejected

    def maps_to_ask_for(self) -> list[int]:
        """Return the IDs of the maps to ask for in this step: entries of them were dropped, and have not come."""
        for map_id, (length, _, _) in list(self._requests.items()):
            held = len(self.logs[map_id])
            if held >= length or held == self.verifiers[map_id].complete_length:
                del self._requests[map_id]
        return [map_id for map_id, (_, step, _) in self._requests.items() if self.step >= step]

    def asked(self, map_id: int) -> None:
        """Note that peers received a request for entries of a map."""
        if map_id in self._requests:
            length, _, wait = self._requests[map_id]
            self._requests[map_id] = length, self.step + wait, min(2 * wait, LONGEST)

    def _check_own(self, peer: int, first: int, entries: list[bytes]) -> None:
        """Compare entries of this robot's log that a peer sent, from offset `first` on; report forged ones."""
        if self.own_log.read(min(first, len(self.own_log)), None, first + len(entries)) != b"".join(entries):
            self.own_log.request_digest(first + len(entries))
            reason = "sent entries of this robot's map that this robot did not write"
            self._rejected.append(Rejected(peer, reason))

    def _verify(self, map_id: int) -> None:
        """Check the digests of a log whose entries have arrived."""
        verified = self.verifiers[map_id].check()
        if verified and self.verifiers[map_id].length == len(self.logs[map_id]):
            self._failed.pop(map_id, None)
            for peer in self._senders.pop(map_id, ()):
                self._suspicions.pop((peer, map_id), None)
        elif verified is False:
            forwarders = self._senders[map_id] - {self.peers.author(map_id)}
            reason = "entries were damaged on the air"
            if forwarders:
                reason = "forwarded entries that their author did not write, or they were damaged"
            for peer in sorted(forwarders or self._senders[map_id]):
                self._suspect(peer, map_id, reason)
            self._drop(map_id)

    def _suspect(self, peer: int, map_id: int, reason: str) -> None:
        """Accept no entries of a map from a peer for a while; the author may send them again at once the first time."""
        self._rejected.append(Rejected(peer, reason))
        self._suspicions[peer, map_id] += 1
        wait = 1 << self._suspicions[peer, map_id]
        author = self.peers.author(map_id)
        self._until[peer, map_id] = self.step + min(wait - 2 if peer == author else 2 * wait, LONGEST)

    def _drop(self, map_id: int) -> None:
        """Drop all entries of a log that are not verified."""
        before = len(self.logs[map_id])
        self.logs[map_id].cut(self.verifiers[map_id].length)
        self._senders.pop(map_id, None)
        self._failed.pop(map_id, None)
        self._ask(map_id, before)
        self.dropped.add(map_id)
        self._rebuild([log.read(0) for log in self.logs])

    def _ask(self, map_id: int, length: int) -> None:
        """Ask for entries from the next step on, until the log has that many."""
        before, _, _ = self._requests.get(map_id, (0, 0, 0))
        self._requests[map_id] = max(length, before), self.step + 1, ASK_AGAIN
