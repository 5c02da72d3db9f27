"""The peer table: how many entries of each map every peer holds, as far as this robot knows.

A row of the table is a peer's version vector: one log length for each map. A robot that restarts without its state
begins a new log (`agent.identity`), so a robot may have several maps. The ID of a map is its author's plus
`robots` times the author's incarnation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Bools, Int64s
from protocol.kernels import kernel

NEVER = -1
"""The time of something that has not happened, and the duration of something that has not been measured."""

Table = NDArray[np.int64]
Mask = NDArray[np.bool_]


class PeerTable:
    """One robot's knowledge of its peers' logs. Tables have a row for each robot and a column for each map ID.

    `own`: the ID of this robot's map; `maps`: how many maps the team may write; `reliable`: the medium loses
    nothing, and keeps the order of a robot's frames; `round_trip`: the most steps after a broadcast in
    which a report may arrive that its sender sent before it received the broadcast.
    """

    def __init__(
        self, own: int, robots: int, maps: int, *, reliable: bool = True, round_trip: int = 0
    ) -> None:
        self.own = own
        self.robots = robots
        self.maps = maps
        self.reliable = reliable
        self.round_trip = round_trip
        self.robot = self.author(own)
        """This robot."""
        self.own_maps = range(own, maps, robots)
        """IDs of the maps that only this robot may write: its own, and those of its later incarnations."""
        self.may_restart = maps > robots
        """Whether robots may lose their state: an old report of a peer then claims more than the peer holds."""
        self.current = list(range(robots))
        """The ID of each robot's map in its current incarnation, as far as this robot has received it."""
        self.current[self.robot] = own
        self.expected = self.new_table()
        """``expected[peer, map]``: entries that the peer should hold by now."""
        self.acked = self.expected
        """``acked[peer, map]``: entries that the peer certainly holds; the same table where nothing is lost."""
        self._deliveries: list[tuple[Table, int]] = []
        """The tables of `delivery_table`, with the values that they start from."""

    def author(self, map_id: int) -> int:
        """Return the robot that writes a map."""
        return map_id % self.robots

    def new_table(self) -> Table:
        """Return a table of zeros, which takes no memory before it is used; columns are contiguous, as maps arrive."""
        return np.zeros((self.maps, self.robots), np.int64).T

    def delivery_table(self, start: int = 0) -> Table:
        """Return a table of the state of deliveries, which begins again from `start` where a peer loses entries."""
        table = self.new_table()
        if start:
            table[:] = start
        self._deliveries.append((table, start))
        return table

    def expect(self, peer: int, map_id: int, length: int) -> None:
        """Note that a peer should hold at least so many entries of a map."""
        if length > self.expected.item(peer, map_id):
            self.expected[peer, map_id] = length

    def acknowledge(self, peer: int, map_id: int, length: int) -> None:
        """Note that a peer certainly holds so many entries of a map."""
        if length > self.acked.item(peer, map_id):
            self.acked[peer, map_id] = length
        self.expect(peer, map_id, length)

    def restarted(self, peer: int, map_id: int) -> bool:
        """Return whether a peer's use of a map ID shows that it restarted; it lost all received entries then."""
        if not self.current[peer] < map_id < self.maps or self.author(map_id) != peer:
            return False
        self.current[peer] = map_id
        self.expected[peer] = self.acked[peer] = 0
        for table, start in self._deliveries:
            table[peer] = start
        return True

    def dropped(self, peer: int, map_id: int, length: int) -> None:
        """Note that a peer dropped the entries of a map from offset `length` on."""
        self.expected[peer, map_id] = length
        self.acked[peer, map_id] = min(self.acked.item(peer, map_id), length)
        for table, start in self._deliveries:
            table[peer, map_id] = start


@kernel
def raise_lengths(lengths: Int64s, peers: Bools, first: int, end: int) -> None:
    """Raise the lengths of a map to `end`, for those of `peers` where they are at least `first`."""
    for peer in range(len(peers)):
        if peers[peer] and lengths[peer] >= first:
            lengths[peer] = max(lengths[peer], end)
