"""Reports of gossip: of which maps a robot tells its peers how many entries it holds, and when.

    situation                                              a report is due
    a meeting owes reports (`neighbors.Meetings`)          at once, of all maps of which the peer may know less
    entries were dropped (`replica`), reliable medium      when the replica asks for them again
    entries came behind a gap                              at once, and every few steps until the gap is filled
    some robot has been out of range before                of one map, in turn, every `REFRESH` steps
    peers acknowledge entries, and some are new,           within the interval of `delivery.Acks`
    or came though this robot held them

On a lossy medium, robots ask for dropped entries in their broadcasts (`base.Replication.announcements`).
"""

from __future__ import annotations

import numpy as np

from agent.replication.delivery import PATIENCE, Acks
from agent.replication.peers import Mask, Table, raise_lengths
from agent.replication.replica import Replica

GAP_REPORTS = 2
"""Steps after which a gap is reported again where the medium may lose the report; elsewhere `PATIENCE`."""

REFRESH = 16
"""Steps after which a robot that has not always had all others in range reports one more map."""


class Reports:
    """What each peer knows of this robot's logs, and the reports that are due."""

    def __init__(self, replica: Replica, acks: Acks) -> None:
        self._replica = replica
        self._acks = acks
        self._informed = replica.peers.new_table()
        """``_informed[peer, map]``: entries that the peer knows this robot to hold."""
        self.gaps: Mask = np.zeros(replica.peers.maps, np.bool_)
        """Maps of which entries came behind others that this robot lacks."""
        self.repeated: Mask = np.zeros(replica.peers.maps, np.bool_)
        """Maps of which entries came that this robot held, so their sender lacks its report."""
        self._steps: Table = np.full(replica.peers.maps, -PATIENCE, np.int64)
        """The step of each map's last report."""
        self._lengths: Table = np.zeros(replica.peers.maps, np.int64)
        """The length of the log in it."""

    def due(self, lengths: Table, owed: list[int], *, parted: bool) -> list[int]:
        """Return the numbers of the maps to report in this round, ascending.

        `lengths`: of this robot's logs. `owed`: the peers to which meetings owe reports. `parted`: whether any robot
        has been out of range before.
        """
        peers, step = self._replica.peers, self._replica.step
        is_turn = parted and step % REFRESH == peers.robot % REFRESH
        asked = self._replica.maps_to_ask_for() if peers.reliable else []
        if peers.reliable and not (owed or is_turn or asked or self.gaps.any()):
            return []
        waited = step - self._steps
        due = self.gaps & (waited >= (PATIENCE if peers.reliable else GAP_REPORTS))
        for peer in owed:
            due |= self._informed[peer] < lengths
        if is_turn:
            numbers = np.arange(peers.maps)
            in_turn = numbers % peers.robots == step // REFRESH % peers.robots
            due |= in_turn & ((numbers < peers.robots) | (lengths > 0))
        due[asked] = True
        if not peers.reliable:
            news = self.repeated | (lengths > self._lengths)
            due |= news & (waited >= self._acks.interval)
        due[peers.own] = False
        return [int(number) for number in due.nonzero()[0]]

    def sent(self, number: int, receivers: Mask) -> None:
        """Note that a report was on the air."""
        self._replica.asked(number)
        self._steps[number] = self._replica.step
        self._lengths[number] = length = len(self._replica.logs[number])
        self.gaps[number] = self.repeated[number] = False
        self.inform(receivers, number, length)

    def inform(self, peers: Mask, number: int, length: int) -> None:
        """Note that peers know that this robot holds so many entries of a map."""
        raise_lengths(self._informed.T[number], peers, 0, length)

    def dropped(self, number: int) -> None:
        """Note that this robot dropped entries of a map, so peers know that it holds more than it does."""
        self._lengths[number] = length = len(self._replica.logs[number])
        self.repeated[number] = False
        self._informed[:, number] = np.minimum(self._informed[:, number], length)

    def restarted(self, peer: int) -> None:
        """Note that a peer lost its state: it has received no report."""
        self._informed[peer] = 0
