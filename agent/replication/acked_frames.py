"""Unicast dissemination on a medium that may lose, delay, repeat and reorder frames: peers acknowledge.

Each frame names its logs and offsets, so it is valid whenever, however often and in whatever order it arrives. In each
round, one frame goes to each peer; it holds, in this order:

    event                                                    sent to the peer in the next round
    the peer offered or sent a map                           held: entries that this robot holds of it
    the peer lacks entries, no acknowledgment is pending     offer: the map, and the expected block
    the peer reported recently, and lacks entries            from, and the entries from there on
    no report within the retransmission timeout              offer again; the timeout doubles

The peer table follows the peer's own reports, and the entries that it sends. Entries behind a gap are ignored: the next
report makes the peer send them again. The retransmission timeout follows the measured round trip, as in TCP; a
retransmitted frame measures nothing (Karn).
"""

from __future__ import annotations

from collections.abc import Iterator

from agent.replication.base import Replication, limited
from agent.replication.control_packets import ParsedFrame, header, length_report, offer, offset, parse
from agent.replication.peers import NEVER
from agent.replication.policies import MAX_WAIT, Offer, Rounds
from agent.replication.replica import Rejected, Replica
from protocol import packet_index, packets
from protocol.errors import ProtocolError
from protocol.messages import OutgoingFrame, RoundReport
from protocol.packets import From, Held

MIN_TIMEOUT = 2
"""Minimum number of rounds until a report can come back."""

MAX_TIMEOUT = 16
"""Rounds between two transmissions at most, once a round trip that is much shorter is known."""

RECENT = 8
"""Rounds for which a report is recent enough to send entries without asking again."""

UNREACHABLE = 4
"""Transmissions without a report after which a peer is not waited for."""


class AckedFrames(Replication):
    """One robot's unicast frames to all peers."""

    def __init__(self, replica: Replica, rounds: Rounds) -> None:
        super().__init__(replica)
        self._rounds = rounds
        self._reports_due: set[tuple[int, int]] = set()
        """Peers that must be sent a report of a map, as pairs (peer, map)."""
        self._reported = self.peers.delivery_table(-RECENT)
        """``_reported[peer, map]``: the round of the peer's last report."""
        self._sent = self.peers.delivery_table()
        """``_sent[peer, map]``: the round of the last transmission."""
        self._round_trip = self.peers.delivery_table(NEVER)
        """``_round_trip[peer, map]``: the rounds from a transmission to the report that followed it."""
        self._frames: list[OutgoingFrame] = []
        """The frames of this round."""

    def open_round(self, number: int, in_range: list[int], budget: int | None) -> list[OutgoingFrame]:
        """Return one frame for each peer that is to be sent anything."""
        rounds = self._rounds
        offers = rounds.open(number, in_range, budget)
        due = [each for each in offers if rounds.now >= rounds.due[each.peer, each.number]]
        self._frames, left = [], limited(budget)
        for peer in in_range:
            payload = self._frame_to(peer, [each for each in due if each.peer == peer], left)
            if payload:
                self._frames.append(OutgoingFrame(peer, payload))
                left = max(0, left - len(payload))
        return self._frames

    def close_round(self, report: RoundReport) -> list[Rejected]:
        """Note which parts of the frames were on the air, and process the received frames."""
        sent = {each.frame: each.sent for each in report.sent}
        for number, frame in enumerate(self._frames):
            self._note_sent(frame.receiver, parse(packet_index.fitting(frame.payload, sent.get(number, 0))))
        self._frames = []
        for delivery in report.deliveries:
            self._receive(delivery.sender, delivery.payload)
        return self.replica.take_rejected()

    def delivered(self) -> bool:
        """Return whether all peers in range reported to hold this robot's log, but for those that are `UNREACHABLE`."""
        return self._rounds.delivered(UNREACHABLE)

    # --- sending

    def _frame_to(self, peer: int, offers: list[Offer], budget: int) -> bytes:
        """Return a peer's frame: reports, then offers, then entries; only entries stop at the budget."""
        frame = b""
        for map_id in sorted(map_id for receiver, map_id in self._reports_due if receiver == peer):
            frame += length_report(map_id, len(self.logs[map_id]))
        answered = []
        for each in offers:
            is_recent = self._reported[peer, each.number] >= self._rounds.now - RECENT
            if is_recent and not self._rounds.tries[peer, each.number]:
                answered.append(each)
            else:
                frame += offer(each.number, each.first)
        for _, map_id, first in answered:
            frame += self.logs[map_id].read(first, budget - len(frame), head=header(map_id, first))
        return frame

    def _note_sent(self, peer: int, frame: ParsedFrame) -> None:
        """Read the part of a frame to a peer that was on the air."""
        for control in frame.controls:
            if isinstance(control, Held):
                self._reports_due.discard((peer, control.map))
            elif isinstance(control, packets.Offer):
                self._transmitted(peer, control.map)
        for map_id, first, entries in self._sections(frame):
            end = min(first + len(entries), len(self.logs[map_id]))
            if end > first:  # else they were dropped meanwhile
                self._transmitted(peer, map_id)
                if map_id == self.peers.own:
                    self.own_log.sent(end)

    def _transmitted(self, peer: int, map_id: int) -> None:
        """Start the retransmission timeout of a map; it doubles with every transmission that no report follows."""
        round_trip = self._round_trip.item(peer, map_id)
        timeout = min(max(MIN_TIMEOUT, round_trip + 1), MAX_TIMEOUT)
        longest = MAX_WAIT if round_trip == NEVER else max(MAX_TIMEOUT, 4 * round_trip)
        self._sent[peer, map_id] = self._rounds.now
        self._rounds.postpone(peer, map_id, timeout, longest)

    # --- receiving

    def _receive(self, peer: int, frame: bytes) -> None:
        logs = self.logs
        try:
            parsed = parse(frame)
        except ProtocolError as error:
            self.replica.reject(peer, self.peers.current[peer], str(error))
            return
        for control in parsed.controls:
            match control:
                case Held(map_id, _) if map_id < len(logs):
                    self._read_report(peer, map_id, offset(control, len(logs[map_id])))
                case packets.Offer(map_id, _) if map_id < len(logs):
                    self.peers.restarted(peer, map_id)
                    self._owe_report(peer, map_id)
                case From(map_id, _):
                    self.peers.restarted(peer, map_id)
        for map_id, first, entries in self._sections(parsed):
            self._owe_report(peer, map_id)
            self.peers.expect(peer, map_id, self._possible(map_id, first + len(entries)))
            self.replica.receive(peer, map_id, first, entries)

    def _sections(self, frame: ParsedFrame) -> Iterator[tuple[int, int, list[bytes]]]:
        """Yield the map ID, the first offset and the entries of each section of a frame that has a header."""
        for head, entries in frame.sections:
            if head is not None and head.map < len(self.logs):
                yield head.map, offset(head, len(self.logs[head.map])), entries

    def _owe_report(self, peer: int, map_id: int) -> None:
        """A peer must be sent a report, unless its entries of that map are not accepted."""
        if map_id not in self.peers.own_maps and not self.replica.refuses(peer, map_id):
            self._reports_due.add((peer, map_id))

    def _read_report(self, peer: int, map_id: int, length: int) -> None:
        """A peer reports how many entries of a map it holds; after restarts, a late report may claim too many."""
        if self.peers.may_restart:
            self.peers.expected[peer, map_id] = 0
        self.peers.expect(peer, map_id, self._possible(map_id, length))
        rounds, tries = self._rounds, self._rounds.tries[peer, map_id]
        if tries == 1 or (tries and self._round_trip[peer, map_id] == NEVER):
            self._round_trip[peer, map_id] = rounds.now - self._sent[peer, map_id]
        self._reported[peer, map_id] = rounds.due[peer, map_id] = rounds.now
        rounds.tries[peer, map_id] = 0
