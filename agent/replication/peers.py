"""Maps, and the peer table: how many entries of each map every peer holds, as far as this robot knows.

A robot that restarts after losing its state starts a new log (`agent.identity`). Packets name a log by one number:
robot plus `robots` times incarnation.

A row of the peer table is a peer's version vector, as in anti-entropy protocols: one log length for each map. `acked`
has the lengths that are certain; `expected` adds entries that should have arrived. On a medium that loses nothing
the two are one. Scuttlebutt (van Renesse et al., 2008) reconciles replicas by comparing such vectors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Table = NDArray[np.int64]
Mask = NDArray[np.bool_]


class MapId(NamedTuple):
    """One robot's map in one of its incarnations."""

    robot: int
    """The robot that writes the map."""
    incarnation: int
    """How often that robot had restarted when it began the map."""
    number: int
    """The number of the map in packets, and its row or column in tables."""


def map_ids(robots: int, incarnations: int = 1) -> list[MapId]:
    """Return all maps that a team may write, ascending by number."""
    return [MapId(number % robots, number // robots, number) for number in range(robots * incarnations)]


class PeerTable:
    """One robot's knowledge of its peers' logs. Tables have a row for each robot and a column for each map number."""

    def __init__(self, own: MapId, maps: list[MapId]) -> None:
        self.own = own.number
        """The number of this robot's map."""
        self.robot = own.robot
        self.maps = maps
        """All maps that the team may write, by number."""
        self.robots = maps[-1].robot + 1
        self.own_maps = {each.number for each in maps[self.own :] if each.robot == self.robot}
        """Numbers of the maps that only this robot may write: its own, and those of its later incarnations."""
        self.current = list(range(self.robots))
        """The number of each robot's map in its current incarnation, as far as this robot has received it."""
        self.current[self.robot] = self.own
        self.rows = np.arange(self.robots)
        """The row of each robot in tables."""
        self.expected = self.new_table()
        """``expected[peer, map]``: entries that the peer should hold by now."""
        self.acked = self.expected
        """``acked[peer, map]``: entries that the peer certainly holds; the same table where nothing is lost."""

    def new_table(self) -> Table:
        """Return a table of zeros; it takes no memory before it is used.

        Its columns are contiguous: an entry that arrives concerns all peers, but one map.
        """
        return np.zeros((len(self.maps), self.robots), np.int64).T

    def expect(self, peer: int, number: int, length: int) -> None:
        """Note that a peer should hold at least so many entries of a map."""
        if length > self.expected.item(peer, number):
            self.expected[peer, number] = length

    def restarted(self, peer: int, number: int) -> bool:
        """Return whether a peer's use of a map number shows that it restarted; it lost all received entries then."""
        if not self.current[peer] < number < len(self.maps) or self.maps[number].robot != peer:
            return False
        self.current[peer] = number
        self.expected[peer] = self.acked[peer] = 0
        return True
