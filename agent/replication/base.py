"""The interface of replication: frames in, frames out, rejections as events. It does no I/O and reads no clock.

A round begins with `open_round`, which returns frames. On a perfect medium, `answer` and `send_data` continue a
handshake. `close_round` takes the report of the medium: which bytes were on the air, and which frames arrived. Entries
that arrived go to the `consume` callback (`replica.Consume`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from agent.replication.replica import Rejected, Replica
from protocol.errors import ProtocolError
from protocol.messages import NO_REPLIES, Delivery, OutgoingFrame, Replies, RoundReport


class Replication(ABC):
    """One robot's end of the replication of all maps."""

    priority = 0
    """Priority of this round's frames: the higher, the shorter a broadcast waits for a free medium."""
    shared = 0
    """Offset in this robot's log before which other robots may hold entries; those from there on may change."""

    def __init__(self, replica: Replica) -> None:
        self.replica = replica
        self.peers = replica.peers
        self.logs = replica.logs

    def append(self, entries: list[bytes]) -> None:
        """Append entries to this robot's log."""
        self.replica.append(entries)

    def retract(self, count: int) -> bool:
        """Remove the last `count` entries of this robot's log if no other robot can hold any; return whether it did."""
        return self.replica.own_log.retract(count, self.shared)

    @abstractmethod
    def open_round(self, number: int, in_range: list[int], budget: int | None) -> list[OutgoingFrame]:
        """Return the frames to send in round `number` of a step.

        `in_range` are the peers in radio range. `budget` is the number of bytes left in the step; None: no limit.
        """

    def speculative(self) -> Replies:
        """Return the answers and data that this robot would send in this round, so that the relay need not ask."""
        return NO_REPLIES

    def answer(self, offers: Sequence[Delivery]) -> list[OutgoingFrame]:
        """Answer the offers of a round. Raises ProtocolError if one is malformed, or if no offers are used."""
        raise ProtocolError("conn", 0, f"{len(offers)} offers, but maps travel without handshakes")

    def send_data(self, answers: Sequence[Delivery]) -> list[OutgoingFrame]:
        """Send the entries that answers ask for; ProtocolError as in `answer`."""
        raise ProtocolError("conn", 0, f"{len(answers)} answers, but maps travel without handshakes")

    @abstractmethod
    def close_round(self, report: RoundReport) -> list[Rejected]:
        """End a round: note which parts of this robot's frames were on the air, and decode the frames that arrived.

        Returns the rejections of peers' entries.
        """

    def undelivered(self) -> int:
        """Count the entries of this robot's log that peers have not acknowledged, over all peers."""
        length, acked = len(self.replica.own_log), self.peers.acked[:, self.peers.own]
        return length * (self.peers.robots - 1) - int(acked.sum())

    def truncate(self) -> None:
        """Drop the entries that all robots acknowledged; a robot that may restart needs them again, so none then."""
        if len(self.logs) == self.peers.robots and any(self.logs):
            for log, before in zip(self.logs, self.peers.held_by_all().tolist(), strict=True):
                log.truncate(before)

    @abstractmethod
    def delivered(self) -> bool:
        """Return whether peers are in range, and all of them hold this robot's log."""
