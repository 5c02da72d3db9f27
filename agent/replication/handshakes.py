"""Unicast dissemination on a perfect medium: offer, answer, data, in three phases a round.

The medium acknowledges: its send report says how much of each frame was carried, and what was carried has arrived. What
was not carried did not happen, so the peer table moves only with the report. A policy chooses the offers; a peer that
answers with its log length is sent the entries from there on (thesis, section 5.1.2, Algorithm 8). `connection` has the
states of both ends. A peer that claims fewer entries than it was sent does not want them: it counts as level.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from agent.replication.connection import Connection, Event, State
from agent.replication.frame_builder import FrameBuilder
from agent.replication.handshake_packets import DECLINE, answer, block_of, offer, read_answer, read_offer
from agent.replication.policies import Policy, Round, backoff, offerable
from agent.replication.replica import Replica
from protocol.errors import ProtocolError
from protocol.messages import (
    NO_REPLIES,
    AnswerReply,
    Delivery,
    OfferReply,
    OutgoingFrame,
    Replies,
    RoundReport,
)

MAX_WAIT = 64
"""Rounds that an offer is postponed at most."""

STUBBORN = 4
"""A peer that refused this robot's map so often that offers wait for more rounds than these counts as up to date."""

MAX_SPECULATIVE = 1 << 16
"""Bytes of data that are handed over speculatively, before it is known which peers lack them."""


class Handshakes:
    """One robot's ends of all connections."""

    priority = 0

    def __init__(self, replica: Replica, policy: Policy, *, forwards: bool = True) -> None:
        self._replica = replica
        self._peers = replica.peers
        self._policy = policy
        self._forwards = forwards
        """Whether maps of other robots are offered as well as this robot's own."""
        self._round = Round(replica.peers.robot + 1)
        self._offered: dict[tuple[int, int], Connection] = {}
        self._answered: dict[int, Connection] = {}
        self._received: dict[int, Connection] = {}
        self._taking: set[int] = set()
        """Maps that are received in this round."""
        self._forgotten = 0
        """Entries of this robot's log that peers held before they restarted."""

    @property
    def shared(self) -> int:
        """Offset in this robot's log before which other robots may hold entries."""
        return max(self._forgotten, int(self._peers.expected[:, self._peers.own].max()))

    def open_round(self, round_number: int, in_range: list[int], budget: int | None) -> list[OutgoingFrame]:
        """Return this round's offers."""
        self._round.open(round_number, in_range, budget)
        self._end_round()
        lengths = self._replica.lengths() if in_range else np.empty(0, np.int64)
        if not lengths.any():
            return []
        lengths = offerable(self._peers, lengths, forwards=self._forwards)
        frames = []
        for receiver, number, first, _ in self._policy(self._peers, self._round, lengths):
            connection = self._offered[receiver, number] = Connection(receiver, number, length=first)
            connection.on(Event.NEWS)
            frames.append(OutgoingFrame(receiver, offer(number, first)))
        return frames

    def speculative(self) -> Replies:
        """Return the answers and data that this robot will send if all is as it expects.

        The relay plays them without asking (`answer` and `send_data` would return the same). Data only of this robot's
        map: of others', peers mostly hold by now what this robot expects them to lack.
        """
        logs, own, peers = self._replica.logs, self._peers.own, self._peers
        if not self._round.in_range or self._policy is not backoff or not any(logs):
            return NO_REPLIES
        declined = {number for _, number in self._replica.refused}
        declined.update(range(own, len(logs), peers.robots))
        held = [(number, len(log)) for number, log in enumerate(logs) if number not in declined]
        offers = [
            OfferReply(offer(number, length), answer(length, block_of(length))) for number, length in held
        ]
        replies: list[tuple[bytes, bytes, int]] = []
        loads: dict[int, bytes] = {}
        for connection in self._offered.values():
            number, expected = connection.number, connection.length
            if number == own and expected not in loads:
                loads[expected] = logs[own].read(expected, self._round.budget)
            load = list(loads).index(expected) if number == own else -1
            up_to_date = answer(len(logs[number]), block_of(expected))
            replies.append((up_to_date, answer(expected, block_of(expected)), load))
        if sum(map(len, loads.values())) > MAX_SPECULATIVE:
            replies, loads = [(*each[:2], -1) for each in replies], {}
        return Replies(offers, DECLINE, [AnswerReply(*each) for each in replies], list(loads.values()))

    def answer(self, offers: Sequence[Delivery]) -> list[OutgoingFrame]:
        """Answer offers; ProtocolError if a frame is no offer."""
        frames = []
        for delivery in offers:
            sender, offered = delivery.sender, read_offer(delivery.payload)
            if offered.map >= len(self._replica.logs):
                reason = f"map {offered.map} of {len(self._replica.logs)} robots"
                raise ProtocolError(offered.name, 0, reason)
            connection = self._received[delivery.connection] = Connection(sender, offered.map)
            unwanted = (
                self._peers.is_own(offered.map)
                or offered.map in self._taking
                or (sender, offered.map) in self._replica.refused
            )
            reply = DECLINE
            if connection.on(Event.UNWANTED_OFFER if unwanted else Event.FIRST_OFFER) is State.TAKING:
                self._taking.add(offered.map)
                reply = answer(len(self._replica.logs[offered.map]), offered.block)
            frames.append(OutgoingFrame(sender, reply, delivery.connection))
        return frames

    def send_data(self, answers: Sequence[Delivery]) -> list[OutgoingFrame]:
        """Send the entries that answers ask for, in all no more than the budget.

        The medium plays connections by their numbers, so it could not carry what is beyond.

        Raises
        ------
        ProtocolError
            A frame is no answer, or not to an offer of this robot.
        """
        frames = []
        left = self._round.budget
        for delivery in answers:
            sender, number = delivery.sender, delivery.map_id
            connection = self._offered.get((sender, number))
            if connection is None or connection.state is not State.OFFERED:
                raise ProtocolError("conn", 0, f"robot {sender} answers an offer that was not made")
            self._answered[delivery.connection] = connection
            if connection.on(self._read_answer(connection, delivery.payload)) is State.SENDING:
                log, builder = self._replica.logs[number], FrameBuilder(left)
                connection.frame = builder
                builder.add_entries(log, connection.length, len(log), b"", partial(self._arrived, connection))
                if builder.payload:
                    frames.append(OutgoingFrame(sender, builder.payload, delivery.connection))
                if left is not None:
                    left -= len(builder.payload)
        return frames

    def close_round(self, report: RoundReport) -> None:
        """Update the peer table by what was carried, and accept the data that arrived."""
        for carried in report.connections:
            connection = self._answered.get(carried.connection)
            if connection is not None and carried.answer:
                self._settle(connection, carried.data)
        if len(self._replica.logs) > self._peers.robots:
            for carried in report.connections:
                connection = self._received.get(carried.connection)
                if connection is not None and carried.offer:
                    self._note_restart(connection.peer, connection.number)
        for delivery in report.deliveries:
            connection = self._received.get(delivery.connection)
            if connection is None or connection.state is not State.TAKING:
                continue
            sender, number = delivery.sender, connection.number
            if self._replica.accept(sender, number, delivery.payload):
                expected, length = self._peers.expected, len(self._replica.logs[number])
                expected[sender, number] = max(expected[sender, number], length)
        self._end_round()

    def _end_round(self) -> None:
        """Drop all connections; the handlers of their frames refer to this object."""
        for of_this_round in (self._offered, self._answered, self._received, self._taking):
            of_this_round.clear()

    def delivered(self) -> bool:
        """Return whether all peers in range hold this robot's log, and there are any; see `STUBBORN`."""
        length, in_range = len(self._replica.own_log), self._round.in_range
        if not in_range or not length:
            return bool(in_range)
        expected = self._peers.expected[:, self._peers.own].tolist()
        wait = self._peers.wait[:, self._peers.own].tolist()
        return all(expected[peer] == length or wait[peer] > STUBBORN for peer in in_range)

    def _note_restart(self, peer: int, number: int) -> None:
        """A peer that offers a map of a new incarnation of its own lost all entries that it was sent."""
        held = int(self._peers.expected[peer, self._peers.own])
        if self._peers.restarted(peer, number):
            self._forgotten = max(self._forgotten, held)
            self._peers.due[peer] = 0
            self._peers.wait[peer] = 1

    def _read_answer(self, connection: Connection, payload: bytes) -> Event:
        """Note the peer's log length, and compare it with this robot's."""
        expected, length = connection.length, len(self._replica.logs[connection.number])
        claimed = read_answer(payload, block_of(expected))
        if claimed is None:
            return Event.DECLINED
        connection.length = claimed if expected <= claimed < length else length
        return Event.BEHIND if connection.length < length else Event.LEVEL

    def _settle(self, connection: Connection, sent: int) -> None:
        """An answer was carried, and so many bytes of data after it."""
        pair = connection.peer, connection.number
        if connection.state is State.REFUSED:
            wait = int(self._peers.wait[pair])
            self._peers.due[pair], self._peers.wait[pair] = self._round.now + wait, min(2 * wait, MAX_WAIT)
        elif connection.state is State.SENDING:
            self._peers.wait[pair] = 1
        self._arrived(connection, 0, connection.length)
        if connection.frame is not None:
            connection.frame.sent(sent)

    def _arrived(self, connection: Connection, first: int, reached: int) -> None:
        """A peer holds the entries of a map before offset `reached`."""
        del first
        expected, pair = self._peers.expected, (connection.peer, connection.number)
        expected[pair] = max(expected[pair], reached)
