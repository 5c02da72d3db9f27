"""This robot's replica of all maps: the logs, the peer table, and the peers whose entries are no longer accepted.

A log entry is attributed to the robot that forwarded it. If a peer sends entries that cannot be decoded, the replica
rejects everything from that peer, unless others forwarded entries of the same map before: theirs may be the false ones,
so only this map is then rejected.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from agent.replication.log import Log
from agent.replication.peers import MapId, PeerTable, Table
from protocol.errors import ProtocolError

Consume = Callable[[int, MapId, bytes], Sequence[int]]
"""Decodes the next entries of a map, given the sender and a frame; returns where in the frame each entry ends.

Raises ProtocolError, and changes nothing, if they are malformed or impossible.
"""


class Rejected(NamedTuple):
    """Event: entries that a peer sent were malformed or impossible."""

    peer: int
    map: MapId
    reason: str


class Replica:
    """Logs by map number, and what peers hold of them."""

    def __init__(self, own: MapId, maps: list[MapId], consume: Consume) -> None:
        self.peers = PeerTable(own, maps)
        self.logs = [Log() for _ in maps]
        self.own_log = self.logs[own.number]
        self.last_append = 0
        """Offset in this robot's log of the entries that were appended last."""
        self.refused: set[tuple[int, int]] = set()
        """(peer, map number): entries that are no longer accepted."""
        self.distrusted: set[int] = set()
        """Peers from which no entries are accepted at all."""
        self._senders: dict[int, set[int]] = {}
        """Peers that sent entries of each map."""
        self._consume = consume
        self._rejected: list[Rejected] = []

    def append(self, entries: list[bytes]) -> None:
        """Append to this robot's log."""
        if entries:
            self.last_append = len(self.own_log)
        self.own_log.append(entries)

    def lengths(self) -> Table:
        """Return the number of entries of each log."""
        return np.array([len(log) for log in self.logs], np.int64)

    def accept(self, peer: int, number: int, frame: bytes) -> bool:
        """Decode and append the next entries of a map that a peer sent; return whether they were accepted."""
        if (peer, number) in self.refused:
            return False
        try:
            ends = self._consume(peer, self.peers.maps[number], frame)
        except ProtocolError as error:
            self.reject(peer, number, error)
            return False
        self.logs[number].extend(frame, ends)
        self._senders.setdefault(number, set()).add(peer)
        return True

    def reject(self, peer: int, number: int, error: ProtocolError) -> None:
        """Accept no more entries of a map from a peer, or none at all if no other peer sent entries of that map."""
        if (peer, number) in self.refused:
            return
        self._rejected.append(Rejected(peer, self.peers.maps[number], str(error)))
        self.refused.add((peer, number))
        if self._senders.get(number, set()) <= {peer}:
            self.distrusted.add(peer)
            self.refused.update((peer, each.number) for each in self.peers.maps)

    def take_rejected(self) -> list[Rejected]:
        """Return the rejections since the last call."""
        rejected, self._rejected = self._rejected, []
        return rejected
