"""The peer table: how many entries of each map every peer holds, as far as this robot knows.

A row is a peer's version vector, as in anti-entropy protocols: one log length for each map. `acked` has the lengths
that are certain; `expected` adds what was sent and should have arrived. On a medium that loses nothing the two are one.
Scuttlebutt (van Renesse et al., 2008) reconciles replicas by comparing such vectors.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from agent.replication.map_ids import MapId
from protocol.arrays import Int64Rows, Int64s
from protocol.kernels import kernel

Table = NDArray[np.int64]
Mask = NDArray[np.bool_]


class PeerTable:
    """What one robot knows of its peers' logs. Tables have a row for each robot and a column for each map number.

    Parameters
    ----------
    own : MapId
        This robot's map.
    maps : list of MapId
        All maps that the team may write, by number.
    """

    def __init__(self, own: MapId, maps: list[MapId]) -> None:
        self.own = own.number
        self.robot = own.robot
        self.maps = maps
        self.robots = maps[-1].robot + 1
        self.current = list(range(self.robots))
        """The number of each robot's map in its current incarnation, as far as this robot has received it."""
        self.current[self.robot] = self.own

    # The tables are created on first use: runs without map exchange do not need them.

    @cached_property
    def expected(self) -> Table:
        """``expected[peer, map]``: entries that the peer should hold by now."""
        return self.new_table()

    @cached_property
    def acked(self) -> Table:
        """``acked[peer, map]``: entries that the peer certainly holds; the same table where nothing is lost."""
        return self.expected

    @cached_property
    def informed(self) -> Table:
        """``informed[peer, map]``: entries that the peer knows this robot to hold."""
        return self.new_table()

    @cached_property
    def wait(self) -> Table:
        """``wait[peer, map]``: rounds until the next offer of a map, after the next refusal or timeout."""
        return self.new_table(1)

    @cached_property
    def due(self) -> Table:
        """``due[peer, map]``: the round before which a map is not offered to the peer again."""
        return self.new_table()

    def new_table(self, value: int = 0) -> Table:
        """Return a table filled with one value."""
        return np.full((self.robots, len(self.maps)), value, np.int64)

    def is_own(self, number: int) -> bool:
        """Return whether only this robot may write a map: its own one, or that of one of its later incarnations."""
        return number >= self.own and self.maps[number].robot == self.robot

    def restarted(self, peer: int, number: int) -> bool:
        """Return whether a peer's use of a map number shows that it restarted; it lost what it had received then."""
        if not self.current[peer] < number < len(self.maps) or self.maps[number].robot != peer:
            return False
        self.current[peer] = number
        self.expected[peer] = 0
        self.acked[peer] = 0
        return True

    def unacked(self, length: int) -> int:
        """Count the entries of this robot's log, of that length, that peers have not acknowledged, over all peers."""
        return length * (self.robots - 1) - int(self.acked[:, self.own].sum()) if length else 0

    def held_by_all(self) -> list[int]:
        """Return for each map of a first incarnation how many entries all robots hold that need them."""
        held = np.empty(self.robots, np.int64)
        held_by_all(self.acked, self.robot, held)
        lengths: list[int] = held.tolist()
        return lengths


@kernel
def held_by_all(acked: Int64Rows, robot: int, held: Int64s) -> None:
    """Write for each map the least that any robot but `robot` and the map's author holds."""
    robots = len(acked)
    held[:] = np.iinfo(np.int64).max
    for peer in range(robots):
        if peer == robot:
            continue
        for number in range(robots):
            if number != peer:
                held[number] = min(held[number], acked[peer, number])
