"""The interface of replication: frames in, frames and rejections out. It does no I/O and reads no clock.

A round begins with `open_round`, which returns frames. On a perfect medium, `answer` and `send_data` continue a
handshake. `close_round` takes the report of the medium: which bytes were on the air, and which frames arrived. Entries
that arrived go to the `consume` callback (`replica.Consume`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from agent.replication.control_packets import length_report, offset
from agent.replication.digests import INTERVAL
from agent.replication.replica import LONGEST, Rejected, Replica
from protocol import packet_codec
from protocol.errors import ProtocolError
from protocol.message_fields import MAX_LOAD
from protocol.messages import Delivery, OutgoingFrame, RoundReport
from protocol.packets import Held, LogDigest


def limited(budget: int | None) -> int:
    """Return how many bytes of entries a robot sends in a phase with this budget (None: unlimited)."""
    return MAX_LOAD if budget is None else min(budget, MAX_LOAD)


class Replication(ABC):
    """One robot's end of the replication of all maps."""

    def __init__(self, replica: Replica) -> None:
        self.replica = replica
        self.peers = replica.peers
        self.logs = replica.logs
        self.own_log = replica.own_log
        """The log of this robot, to which the caller appends entries."""
        self.announces_digests = self.announces_requests = True
        """Whether broadcasts have this robot's digests, and its requests for entries; else its frames have them."""
        self.priority = 0
        """Priority of this round's frames: the higher, the shorter a broadcast waits for a free medium."""
        self.salt: int | None = None
        """Salt of the next digest, below 2**7, which no other robot can predict; None: this robot sends no digests."""
        self.urgency: float | None = None
        """How much the entries appended last change the plans of peers, per byte; None: entries have no ranks."""
        self.ended: frozenset[int] = frozenset()
        """Peers that have ended, by the reports of the medium: nothing has to be delivered to them."""
        self._digest_turn = 0
        """This robot's turn in which the last regular digest was due; robots take turns."""
        self._asked: dict[tuple[int, int], tuple[int, int]] = {}
        """(peer, map ID): before which step a peer's next request is not answered, and the steps after that."""

    @abstractmethod
    def open_round(self, number: int, in_range: list[int], budget: int | None) -> list[OutgoingFrame]:
        """Return the frames to send in round `number` of a step, given the peers in radio range.

        `budget` is the number of bytes left in the step; None: no limit.
        """

    def answer(self, offers: Sequence[Delivery]) -> list[OutgoingFrame]:
        """Answer the offers of a round. Raises ProtocolError if one is malformed, or this dissemination has none."""
        raise ProtocolError("conn", 0, f"{len(offers)} offers, but maps travel without handshakes")

    def send_data(self, answers: Sequence[Delivery]) -> list[OutgoingFrame]:
        """Send the entries that answers ask for; ProtocolError as in `answer`."""
        raise ProtocolError("conn", 0, f"{len(answers)} answers, but maps travel without handshakes")

    @abstractmethod
    def close_round(self, report: RoundReport) -> list[Rejected]:
        """End a round: note which parts of this robot's frames were on the air, and decode the frames that arrived.

        Returns the rejections of peers' entries.
        """

    @abstractmethod
    def delivered(self) -> bool:
        """Return whether peers are in range, and all of them hold this robot's log."""

    def undelivered(self) -> int:
        """Count the entries of this robot's log that are not acknowledged, over all peers that have not ended."""
        length, gone = self.own_log.length, {self.peers.robot, *self.ended}
        acked: list[int] = self.peers.acked[:, self.peers.own].tolist()
        return sum([length - held for peer, held in enumerate(acked) if peer not in gone])

    def undelivered_to(self, peer: int) -> int:
        """Count the entries of this robot's log that a peer has not acknowledged."""
        return self.own_log.length - self.peers.acked.item(peer, self.peers.own)

    def announcements(self) -> bytes:
        """Return the packets about logs to broadcast in this step: the digest that is due, and requests for entries."""
        digest = self._next_digest() if self.announces_digests else b""
        asked = self.replica.maps_to_ask_for() if self.announces_requests else []
        return digest + b"".join(length_report(map_id, len(self.logs[map_id])) for map_id in asked)

    def announced(self) -> None:
        """Note that this step's broadcast was on the air."""
        if self.announces_digests:
            self.own_log.digest_length = 0
        for map_id in self.replica.maps_to_ask_for() if self.announces_requests else ():
            self.replica.asked(map_id)

    def receive_announcement(self, peer: int, packet: LogDigest | Held) -> list[Rejected]:
        """Process a packet about logs that a peer broadcast; return the rejections of entries that it refutes."""
        if isinstance(packet, LogDigest):
            self.replica.receive_digest(peer, packet)
        elif packet.map < len(self.logs):
            map_id, length = packet.map, offset(packet, len(self.logs[packet.map]))
            step, wait = self._asked.get((peer, map_id), (0, 2))
            if length < self.peers.expected.item(peer, map_id) and self.replica.step >= step:
                self._asked[peer, map_id] = self.replica.step + wait, min(2 * wait, LONGEST)
                self._peer_dropped(peer, map_id, length)
        return self.replica.take_rejected()

    def _next_digest(self) -> bytes:
        """Return the digest of this robot's log if one is due or a peer may hold other entries; else empty bytes."""
        if self.salt is None:
            return b""
        log, verifier = self.own_log, self.replica.verifiers[self.peers.own]
        turn = (self.replica.step + INTERVAL * self.peers.robot) // (INTERVAL * self.peers.robots)
        if turn > self._digest_turn:
            self._digest_turn = turn
            log.request_digest(log.length)
        length = min(log.digest_length, log.shared)
        if not length:
            return b""
        return packet_codec.encode([verifier.digest(length, self.salt, complete=length == log.shared)])

    def _possible(self, map_id: int, length: int) -> int:
        """Limit a log length that a peer claims: no robot holds entries of this robot's map that were not sent."""
        return min(length, self.own_log.shared) if map_id == self.peers.own else length

    def _peer_dropped(self, peer: int, map_id: int, length: int) -> None:
        """A peer dropped the entries of a map from offset `length` on."""
        if map_id == self.peers.own:
            self.own_log.request_digest(length)
        self.peers.dropped(peer, map_id, length)
