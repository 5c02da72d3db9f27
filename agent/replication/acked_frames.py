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

from collections import defaultdict
from dataclasses import dataclass
from functools import partial

from agent.replication.base import Replication
from agent.replication.control_packets import header, offer, offset, parse, report
from agent.replication.frame_builder import FrameBuilder, limited
from agent.replication.policies import Offer, Rounds
from agent.replication.replica import Rejected, Replica
from protocol import packets
from protocol.errors import ProtocolError
from protocol.messages import OutgoingFrame, RoundReport
from protocol.packets import From, Held

MAX_WAIT = 64
"""Rounds between two transmissions at most, while no round trip is known."""

MIN_TIMEOUT = 2
"""Minimum number of rounds until a report can come back."""

MAX_TIMEOUT = 16
"""Rounds between two transmissions at most, once a round trip that is much shorter is known."""

RECENT = 8
"""Rounds for which a report is recent enough to send entries without asking again."""

UNREACHABLE = 4
"""Transmissions without a report after which a peer is not waited for."""


@dataclass(slots=True)
class _Timer:
    """Acknowledgments of one map by one peer, in rounds."""

    reported: int = -MAX_WAIT
    """When the peer last reported, unless entries were sent since."""
    sent: int | None = None
    """When the last frame was sent that no report followed."""
    tries: int = 0
    """Transmissions since the last report."""
    wait: int = MIN_TIMEOUT
    """The retransmission timeout."""
    round_trip: int | None = None


class AckedFrames(Replication):
    """One robot's unicast frames to all peers."""

    def __init__(self, replica: Replica, rounds: Rounds) -> None:
        super().__init__(replica)
        self._rounds = rounds
        self._reports_due: set[tuple[int, int]] = set()
        """Peers that must be sent a report of a map, as pairs (peer, map)."""
        self._timers: defaultdict[tuple[int, int], _Timer] = defaultdict(_Timer)
        self._builders: list[FrameBuilder] = []

    def open_round(self, number: int, in_range: list[int], budget: int | None) -> list[OutgoingFrame]:
        """Return one frame for each peer that is to be sent anything."""
        rounds = self._rounds
        offers = rounds.open(number, in_range, budget)
        due = [each for each in offers if rounds.now >= rounds.due[each.peer, each.number]]
        frames, self._builders, left = [], [], limited(budget)
        for peer in in_range:
            builder = FrameBuilder(left)
            self._fill(builder, peer, [each for each in due if each.peer == peer])
            if builder.payload:
                self._builders.append(builder)
                frames.append(OutgoingFrame(peer, builder.payload))
                left = max(0, left - len(builder.payload))
        return frames

    def close_round(self, report: RoundReport) -> list[Rejected]:
        """Note which parts of the frames were on the air, and process the received frames."""
        sent = {each.frame: each.sent for each in report.sent}
        for frame, builder in enumerate(self._builders):
            builder.sent(sent.get(frame, 0))
        self._builders = []
        for delivery in report.deliveries:
            self._receive(delivery.sender, delivery.payload)
        return self.replica.take_rejected()

    def delivered(self) -> bool:
        """Return whether all peers in range reported to hold this robot's log, but for those that are `UNREACHABLE`."""
        length, own, in_range = self.own_log.length, self.peers.own, self._rounds.in_range
        return bool(in_range) and all(
            self.peers.expected[peer, own] >= length or self._timers[peer, own].tries > UNREACHABLE
            for peer in in_range
        )

    # --- sending

    def _fill(self, builder: FrameBuilder, peer: int, offers: list[Offer]) -> None:
        """Add reports, then offers, then entries to a peer's frame; only entries stop at the budget."""
        for number in sorted(number for receiver, number in self._reports_due if receiver == peer):
            held = report(number, len(self.logs[number]))
            builder.add(held, partial(self._reports_due.discard, (peer, number)))
        answered = []
        for each in offers:
            if self._timers[peer, each.number].reported >= self._rounds.now - RECENT:
                answered.append(each)
            else:
                builder.add(offer(each.number, each.first), partial(self._transmitted, peer, each.number))
        for _, number, first in answered:
            on_sent = partial(self._entries_sent, peer, number)
            builder.add_entries(self.logs[number], first, header(number, first), on_sent)

    def _entries_sent(self, peer: int, number: int, _first: int, end: int) -> None:
        """Entries of a map, before offset `end`, were on the air."""
        self._transmitted(peer, number)
        self._timers[peer, number].reported = -MAX_WAIT
        if number == self.peers.own:
            self.own_log.sent(end)

    def _transmitted(self, peer: int, number: int) -> None:
        """Start the retransmission timeout of a map; it doubles with every transmission that no report follows."""
        timer = self._timers[peer, number]
        timer.tries += 1
        if timer.tries > 1:
            longest = MAX_WAIT if timer.round_trip is None else max(MAX_TIMEOUT, 4 * timer.round_trip)
            timer.wait = min(2 * timer.wait, longest)
        timer.sent = self._rounds.now
        self._rounds.due[peer, number] = self._rounds.now + timer.wait

    # --- receiving

    def _receive(self, peer: int, frame: bytes) -> None:
        logs = self.logs
        try:
            parsed = parse(frame)
        except ProtocolError as error:
            self.replica.reject(peer, self.peers.current[peer], str(error))
            return
        for control in parsed.controls:
            if not isinstance(control, Held | packets.Offer | From) or control.map >= len(logs):
                continue
            if isinstance(control, Held):
                self._reported(peer, control.map, offset(control, len(logs[control.map])))
                continue
            self._note_restart(peer, control.map)
            if isinstance(control, packets.Offer):
                self._owe_report(peer, control.map)
        for head, entries in parsed.sections:
            if head is None or head.map >= len(logs):
                continue
            number, length = head.map, len(logs[head.map])
            first = offset(head, length)
            end = first + len(entries)
            if number == self.peers.own:
                self.replica.check_own(peer, first, entries)
            self._owe_report(peer, number)
            self.peers.expect(peer, number, self._possible(number, end))
            if first <= length < end and number not in self.peers.own_maps:
                self.replica.accept(peer, number, b"".join(entries[length - first :]))

    def _owe_report(self, peer: int, number: int) -> None:
        """A peer must be sent a report, unless its entries of that map are not accepted."""
        if number not in self.peers.own_maps and not self.replica.refuses(peer, number):
            self._reports_due.add((peer, number))

    def _peer_dropped(self, peer: int, number: int, length: int) -> None:
        super()._peer_dropped(peer, number, length)
        self._rounds.due[peer, number] = self._rounds.now  # offer them at once
        self._timers.pop((peer, number), None)

    def _note_restart(self, peer: int, number: int) -> None:
        """A peer that offers or sends a map of a new incarnation of its own lost all: none of its reports holds."""
        if self.peers.restarted(peer, number):
            self._rounds.due[peer] = 0
            for each in range(len(self.logs)):
                self._timers.pop((peer, each), None)

    def _reported(self, peer: int, number: int, length: int) -> None:
        """A peer reports how many entries of a map it holds; after restarts, a late report may claim too many."""
        if self.peers.may_restart:
            self.peers.expected[peer, number] = 0
        self.peers.expect(peer, number, self._possible(number, length))
        timer, now = self._timers[peer, number], self._rounds.now
        timer.reported = now
        if timer.sent is not None and (timer.tries == 1 or timer.round_trip is None):
            timer.round_trip = now - timer.sent
        timer.sent, timer.tries = None, 0
        if timer.round_trip is not None:
            timer.wait = min(max(MIN_TIMEOUT, timer.round_trip + 1), MAX_TIMEOUT)
        self._rounds.due[peer, number] = now
