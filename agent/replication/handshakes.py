"""Unicast dissemination on a perfect medium: offer, answer, data, in three phases a round.

The medium's send report says how much of each frame has arrived, so the peer table changes only with the report. A peer
answers an offer with its log length, and is sent the entries from there on (thesis, section 5.1.2, Algorithm 8). If it
claims fewer entries than it was sent, it does not want them, and counts as level.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import msgspec

from agent.replication.base import Replication, limited
from agent.replication.control_packets import answer, block_of, offer, read_answer, read_offer
from agent.replication.policies import MAX_WAIT, Rounds
from agent.replication.replica import Rejected, Replica
from protocol.errors import ProtocolError
from protocol.messages import Delivery, OutgoingFrame, RoundReport
from protocol.packet_codec import DECLINE

STUBBORN = 2
"""A peer that refused this robot's map more often than this in a row counts as up to date."""

State = Literal["idle", "offered", "sending", "refused", "taking", "declining"]
Event = Literal["news", "behind", "level", "declined", "first offer", "unwanted offer"]

TRANSITIONS: dict[tuple[State, Event], State] = {
    # The offerer, if the peer lacks entries: an answer of a length below its own log's length is "behind".
    ("idle", "news"): "offered",
    ("offered", "behind"): "sending",
    ("offered", "level"): "refused",
    ("offered", "declined"): "refused",
    # The receiver: unwanted are a further offer of the same map, offers of its own map, and those of a rejected peer.
    ("idle", "first offer"): "taking",
    ("idle", "unwanted offer"): "declining",
}
"""The states of a connection, which ends with its round. A missing transition is a protocol error."""


class Connection(msgspec.Struct, eq=False, gc=False):
    """One end of a connection, with the peer at the other end and the map's ID."""

    peer: int
    map_id: int
    length: int = 0
    """As offerer: entries that the peer holds, by its answer; before the answer, as expected."""
    state: State = "idle"

    def on(self, event: Event) -> State:
        """Follow the transition table."""
        self.state = TRANSITIONS[self.state, event]
        return self.state


class Handshakes(Replication):
    """One robot's ends of all connections."""

    def __init__(self, replica: Replica, rounds: Rounds) -> None:
        super().__init__(replica)
        self._rounds = rounds
        self._offered: dict[tuple[int, int], Connection] = {}
        self._answered: dict[int, Connection] = {}
        self._received: dict[int, Connection] = {}

    def open_round(self, number: int, in_range: list[int], budget: int | None) -> list[OutgoingFrame]:
        """Return this round's offers."""
        self._offered, self._answered, self._received = {}, {}, {}
        frames = []
        for peer, offered, first in self._rounds.open(number, in_range, budget):
            connection = self._offered[peer, offered] = Connection(peer, offered, first)
            connection.on("news")
            frames.append(OutgoingFrame(peer, offer(offered, first)))
        return frames

    def answer(self, offers: Sequence[Delivery]) -> list[OutgoingFrame]:
        """Answer offers; ProtocolError if a frame is no offer."""
        frames = []
        taken: set[int] = set()
        for delivery in offers:
            sender, offered = delivery.sender, read_offer(delivery.payload)
            map_id = offered.map
            if map_id >= len(self.logs):
                raise ProtocolError(offered.name, 0, f"map {map_id} of {len(self.logs)} maps")
            connection = self._received[delivery.connection] = Connection(sender, map_id)
            if map_id in taken or map_id in self.peers.own_maps or self.replica.refuses(sender, map_id):
                connection.on("unwanted offer")
                reply = DECLINE
            else:
                connection.on("first offer")
                taken.add(map_id)
                reply = answer(self.logs[map_id].length, offered.block)
            frames.append(OutgoingFrame(sender, reply, delivery.connection))
        return frames

    def send_data(self, answers: Sequence[Delivery]) -> list[OutgoingFrame]:
        """Send the entries that answers ask for, in all no more than the budget.

        The medium carries connections in the order of their numbers, so bytes beyond the budget would not be on the
        air. Raises ProtocolError if a frame is no answer, or answers no offer of this robot.
        """
        frames = []
        left = limited(self._rounds.budget)
        for delivery in answers:
            sender, map_id = delivery.sender, delivery.map_id
            connection = self._offered.get((sender, map_id))
            if connection is None or connection.state != "offered":
                raise ProtocolError("conn", 0, f"robot {sender} answers an offer that was not made")
            self._answered[delivery.connection] = connection
            if connection.on(self._read_answer(connection, delivery.payload)) == "sending":
                entries = self.logs[map_id].read(connection.length, left)
                if entries:
                    frames.append(OutgoingFrame(sender, entries, delivery.connection))
                left -= len(entries)
        return frames

    def close_round(self, report: RoundReport) -> list[Rejected]:
        """Update the peer table by the bytes that were carried, and accept the data that arrived."""
        for carried in report.connections:
            if carried.answer and (answered := self._answered.get(carried.connection)):
                self._settle(answered, carried.data)
        for carried in report.connections:
            if carried.offer and (received := self._received.get(carried.connection)):
                self.peers.restarted(received.peer, received.map_id)
        for delivery in report.deliveries:
            taken, sender = self._received.get(delivery.connection), delivery.sender
            if taken is None or taken.state != "taking":
                continue
            if self.replica.accept(sender, taken.map_id, delivery.payload):
                self.peers.expect(sender, taken.map_id, self.logs[taken.map_id].length)
        return self.replica.take_rejected()

    def delivered(self) -> bool:
        """Return whether all peers in range hold this robot's log, and there are any; see `STUBBORN`."""
        return self._rounds.delivered(STUBBORN)

    def _read_answer(self, connection: Connection, payload: bytes) -> Event:
        """Note the peer's log length, and compare it with this robot's."""
        expected, length = connection.length, self.logs[connection.map_id].length
        claimed = read_answer(payload, block_of(expected))
        if claimed is None:
            return "declined"
        connection.length = claimed if expected <= claimed < length else length
        return "behind" if connection.length < length else "level"

    def _settle(self, connection: Connection, sent: int) -> None:
        """An answer was carried, and so many bytes of data after it."""
        pair, reached = (connection.peer, connection.map_id), connection.length
        if connection.state == "refused":
            self._rounds.postpone(*pair, 1, MAX_WAIT)
        elif connection.state == "sending":
            self._rounds.tries[pair] = 0
            reached = self.logs[connection.map_id].offset_after(reached, sent)
        if connection.map_id == self.peers.own:
            self.own_log.sent(reached)
        self.peers.expect(*pair, reached)
