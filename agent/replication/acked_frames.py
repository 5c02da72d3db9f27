"""Unicast dissemination on a medium that may lose, delay, repeat and reorder frames: peers acknowledge.

There are no phases: each frame names its logs and offsets, so it is valid whenever, however often and in whatever order
it arrives. One frame a round goes to each peer; it holds, in this order:

    event                                                    sent to the peer in the next round
    the peer offered or sent a map                           held: entries that this robot holds of it
    the peer lacks entries, no acknowledgment is pending     offer: the map, and the expected block
    the peer reported recently, and lacks entries            from, and the entries from there on
    no report within the retransmission timeout              offer again; the timeout doubles

The peer table moves by the peer's own reports, and by entries that it sends, and by nothing else. Entries that this
robot holds already are ignored, and so are those behind a gap: the next report makes the peer send them again. The
retransmission timeout follows the measured round trip, as in TCP; a retransmitted frame measures nothing (Karn).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from agent.replication.control_packets import from_packet, held_packet, offset, parse
from agent.replication.frame_builder import FrameBuilder
from agent.replication.handshake_packets import offer
from agent.replication.policies import LogRange, Policy, Round, offerable
from agent.replication.replica import Replica
from protocol.errors import ProtocolError
from protocol.messages import OutgoingFrame, RoundReport
from protocol.packets import From, FromEarly, Held, HeldEarly, Offer

MAX_WAIT = 64
"""Rounds between two transmissions at most, while no round trip is known."""

MIN_TIMEOUT = 2
"""Rounds in which a report can come back at the soonest."""

MAX_TIMEOUT = 16
"""Rounds between two transmissions at most, once a round trip that is much shorter is known."""

RECENT = 8
"""Rounds for which a report is recent enough to send entries without asking again."""

UNREACHABLE = 4
"""Transmissions without a report after which a peer is not waited for."""

Pair = tuple[int, int]
"""A peer and a map number."""


@dataclass(slots=True)
class _Timer:
    """Acknowledgments of one map by one peer, in rounds."""

    reported: int = -MAX_WAIT
    """When the peer last reported, unless entries were sent since."""
    sent: int | None = None
    """When the last frame was sent that no report followed."""
    tries: int = 0
    """Transmissions since the last report."""
    round_trip: int | None = None


class AckedFrames:
    """One robot's unicast frames to all peers."""

    priority = 0

    def __init__(self, replica: Replica, policy: Policy, *, forwards: bool = True) -> None:
        self._replica = replica
        self._peers = replica.peers
        self._peers.wait = self._peers.new_table(MIN_TIMEOUT)
        self._policy = policy
        self._forwards = forwards
        self._round = Round(replica.peers.robot + 1)
        self._reports_due: set[Pair] = set()
        """Peers that must be sent a report of a map."""
        self._timers: dict[Pair, _Timer] = {}
        self._builders: list[FrameBuilder] = []
        self.shared = 0
        """Offset in this robot's log before which entries were on the air."""

    def open_round(self, round_number: int, in_range: list[int], budget: int | None) -> list[OutgoingFrame]:
        """Return one frame for each peer that is to be sent anything."""
        now = self._round
        now.open(round_number, in_range, budget)
        lengths = self._replica.lengths()
        ranges: list[LogRange] = []
        if in_range and lengths.any():
            ranges = self._policy(self._peers, now, offerable(self._peers, lengths, forwards=self._forwards))
        due = [each for each in ranges if now.now >= self._peers.due[each.receiver, each.number]]
        frames = []
        self._builders = []
        for peer in in_range:
            builder = FrameBuilder(budget)
            self._fill(builder, peer, [each for each in due if each.receiver == peer])
            if builder.payload:
                self._builders.append(builder)
                frames.append(OutgoingFrame(peer, builder.payload))
                budget = None if budget is None else max(0, budget - len(builder.payload))
        return frames

    def close_round(self, report: RoundReport) -> None:
        """Note what was on the air, and process the received frames."""
        sent = {each.frame: each.sent for each in report.sent}
        for frame, builder in enumerate(self._builders):
            builder.sent(sent.get(frame, 0))
        self._builders = []
        for delivery in report.deliveries:
            self._receive(delivery.sender, delivery.payload)

    def delivered(self) -> bool:
        """Return whether all peers in range reported to hold this robot's log, but for those that are `UNREACHABLE`."""
        length, own, in_range = len(self._replica.own_log), self._peers.own, self._round.in_range
        if not in_range or not length:
            return bool(in_range)
        return all(
            self._peers.expected[peer, own] >= length
            or ((peer, own) in self._timers and self._timers[peer, own].tries > UNREACHABLE)
            for peer in in_range
        )

    # --- sending

    def _fill(self, builder: FrameBuilder, peer: int, ranges: list[LogRange]) -> None:
        """Add reports, then offers, then entries to a peer's frame; only entries stop at the budget."""
        for number in sorted(number for receiver, number in self._reports_due if receiver == peer):
            report = held_packet(number, len(self._replica.logs[number]))
            builder.add(report, partial(self._reports_due.discard, (peer, number)))
        recent = self._round.now - RECENT
        asked = [each for each in ranges if self._timer((peer, each.number)).reported < recent]
        for each in asked:
            pair = peer, each.number
            builder.add(offer(each.number, each.first), partial(self._transmitted, pair))
        for each in ranges:
            if each not in asked:
                log, pair = self._replica.logs[each.number], (peer, each.number)
                first = max(each.first, log.start)
                header = from_packet(each.number, first)
                builder.add_entries(log, first, len(log), header, partial(self._entries_sent, pair))

    def _timer(self, pair: Pair) -> _Timer:
        return self._timers.setdefault(pair, _Timer())

    def _entries_sent(self, pair: Pair, first: int, reached: int) -> None:
        """Entries of a map, before offset `reached`, were on the air."""
        del first
        self._transmitted(pair)
        self._timer(pair).reported = -MAX_WAIT
        if pair[1] == self._peers.own:
            self.shared = max(self.shared, reached)

    def _transmitted(self, pair: Pair) -> None:
        """Start the retransmission timeout of a map; it doubles with every transmission that no report follows."""
        timer, wait = self._timer(pair), self._peers.wait
        timer.tries += 1
        if timer.tries > 1:
            longest = MAX_WAIT if timer.round_trip is None else max(MAX_TIMEOUT, 4 * timer.round_trip)
            wait[pair] = min(2 * int(wait[pair]), longest)
        timer.sent = self._round.now
        self._peers.due[pair] = self._round.now + wait[pair]

    # --- receiving

    def _receive(self, peer: int, frame: bytes) -> None:
        logs = self._replica.logs
        try:
            parsed = parse(frame)
        except ProtocolError as error:
            self._replica.reject(peer, peer, error)
            return
        for control in parsed.controls:
            match control:
                case (Held(number, _) | HeldEarly(number, _)) as held if number < len(logs):
                    self._reported((peer, number), offset(held, len(logs[number])))
                case Offer(number, _) if number < len(logs):
                    self._note_restart(peer, number)
                    self._owe_report((peer, number))
                case From(number, _) | FromEarly(number, _) if number < len(logs):
                    self._note_restart(peer, number)
        for header, entries in parsed.sections:
            if header is None or header.map >= len(logs):
                continue
            number, length = header.map, len(logs[header.map])
            first = offset(header, length)
            end = first + len(entries.ends)
            self._owe_report((peer, number))
            self._learn((peer, number), end)
            if first <= length < end and not self._peers.is_own(number):
                self._replica.accept(peer, number, entries.after(length - first))

    def _owe_report(self, pair: Pair) -> None:
        """A peer must be sent a report, unless its entries of that map are not accepted."""
        if not self._peers.is_own(pair[1]) and pair not in self._replica.refused:
            self._reports_due.add(pair)

    def _note_restart(self, peer: int, number: int) -> None:
        """A peer that offers or sends a map of a new incarnation of its own lost all: none of its reports holds."""
        if self._peers.restarted(peer, number):
            self._peers.due[peer] = 0
            self._peers.wait[peer] = MIN_TIMEOUT
            for pair in [pair for pair in self._timers if pair[0] == peer]:
                del self._timers[pair]

    def _reported(self, pair: Pair, length: int) -> None:
        """A peer reports how many entries of a map it holds."""
        if len(self._replica.logs) > self._peers.robots:
            self._peers.expected[pair] = (
                0  # a report of an earlier incarnation, which held more, may arrive late
            )
        self._learn(pair, length)
        timer, now = self._timer(pair), self._round.now
        timer.reported = now
        if timer.sent is not None and (timer.tries == 1 or timer.round_trip is None):
            timer.round_trip = now - timer.sent
        timer.sent, timer.tries = None, 0
        if timer.round_trip is not None:
            self._peers.wait[pair] = min(max(MIN_TIMEOUT, timer.round_trip + 1), MAX_TIMEOUT)
        self._peers.due[pair] = now

    def _learn(self, pair: Pair, length: int) -> None:
        """A peer holds at least so many entries; of this robot's map none that was not on the air."""
        if pair[1] == self._peers.own:
            length = min(length, self.shared)
        self._peers.expected[pair] = max(int(self._peers.expected[pair]), length)
