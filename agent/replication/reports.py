"""Reports of gossip: of which maps a robot tells its peers how many entries it holds, and when.

    situation                                              a report is due
    a meeting owes reports (`neighbors.Meetings`)          at once, of all maps of which the peer may know less
    entries were dropped (`replica`), reliable medium      when the replica asks for them again
    entries came behind a gap                              at once, and every few steps until the gap is filled
    a peer reports more entries                            at once, and every `Acks.turn` steps until they arrive
    a peer asks for a report                               at once
    this robot asks for reports (`Acks.unacknowledged`)    of the map concerned
    some robot has been out of range before                of one map, in turn, every `REFRESH` steps
    peers acknowledge entries, and some are new            within the interval of `delivery.Acks`

On a lossy medium, robots ask for dropped entries in their broadcasts (`base.Replication.announcements`).
"""

from __future__ import annotations

import numpy as np

from agent.replication.delivery import PATIENCE, Acks
from agent.replication.peers import Mask, Table, raise_lengths
from agent.replication.replica import Replica

QUICK_REPEATS, MAX_DELAY = 8, 64
"""How often a gap is reported again after an urgent interval each (`Acks.urgent_interval`); then after two, three, and
more, up to a maximum: the entries may not exist."""

REFRESH = 16
"""Steps after which a robot that has not always had all others in range reports one more map, and on a lossy medium
whether one more robot is in its range."""


class Reports:
    """What each peer knows of this robot's logs, and the reports that are due."""

    def __init__(self, replica: Replica, acks: Acks) -> None:
        self._replica = replica
        self._acks = acks
        self._informed = replica.peers.new_table()
        """``_informed[peer, map]``: entries that the peer knows this robot to hold."""
        self.urgent: Mask = np.zeros(replica.peers.maps, np.bool_)
        """Maps of which this robot lacks entries, or for whose report a peer asked."""
        self._steps: Table = np.full(replica.peers.maps, -PATIENCE, np.int64)
        """The step of each map's last report."""
        self._lengths: Table = np.zeros(replica.peers.maps, np.int64)
        """The length of the log in it."""
        self._repeats: Table = np.zeros(replica.peers.maps, np.int64)
        """How often this length has been reported again."""

    def is_turn(self) -> bool:
        """Return whether this step is this robot's turn to repeat a report."""
        return self._replica.step % REFRESH == self._replica.peers.robot % REFRESH

    def due(self, lengths: Table, in_range: list[int], owed: list[int], *, parted: bool) -> list[int]:
        """Return the IDs of the maps to report in this round, ascending.

        `lengths`: of this robot's logs. `owed`: the peers to which meetings owe reports. `parted`: whether any robot
        has been out of another's range before.
        """
        peers, step = self._replica.peers, self._replica.step
        is_turn = parted and self.is_turn()
        asked = self._replica.maps_to_ask_for() if peers.reliable else []
        if peers.reliable and not (owed or is_turn or asked or self.urgent.any()):
            return []
        waited = step - self._steps
        self.urgent[self._acks.gaps()] = True
        delays = 1 if peers.reliable else (self._repeats - QUICK_REPEATS).clip(1, MAX_DELAY)
        due = self.urgent & (waited >= self._acks.urgent_interval * delays)
        for peer in owed:
            due |= self._informed[peer] < lengths
        if is_turn:
            map_ids = np.arange(peers.maps)
            in_turn = map_ids % peers.robots == step // REFRESH % peers.robots
            due |= in_turn & ((map_ids < peers.robots) | (lengths > 0))
        due[asked] = True
        if not peers.reliable:
            due |= self._acks.is_behind(lengths, in_range) & (waited >= self._acks.turn * delays)
            due |= (lengths > self._lengths) & (waited >= self._acks.interval)
        due[peers.own] = False
        if not peers.reliable:
            due |= self._acks.unacknowledged(in_range)
        return [int(map_id) for map_id in due.nonzero()[0]]

    def sent(self, map_id: int, receivers: Mask) -> None:
        """Note that a report was on the air."""
        self._replica.asked(map_id)
        self._steps[map_id] = self._replica.step
        length = len(self._replica.logs[map_id])
        self._repeats[map_id] = self._repeats[map_id] + 1 if length == self._lengths[map_id] else 0
        self._lengths[map_id] = length
        self.urgent[map_id] = False
        self.inform(receivers, map_id, length)

    def inform(self, peers: Mask, map_id: int, length: int) -> None:
        """Note that peers know that this robot holds so many entries of a map."""
        raise_lengths(self._informed.T[map_id], peers, 0, length)

    def dropped(self, map_id: int) -> None:
        """Note that this robot dropped entries of a map, so peers know that it holds more than it does."""
        self._lengths[map_id] = length = len(self._replica.logs[map_id])
        self._informed[:, map_id] = np.minimum(self._informed[:, map_id], length)

    def restarted(self, peer: int) -> None:
        """Note that a peer lost its state: it has received no report."""
        self._informed[peer] = 0
