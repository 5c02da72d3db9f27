"""Gossip: dissemination by broadcast, so one transmission serves all robots in range (docs/replication.md).

Each robot keeps a version vector for each peer and the radio range of each peer; broadcasts keep both up to date. So
robots in range of each other have the same tables and choose the same forwarder (`gossip_policy`). A frame holds, in
this order:

    event                                                     part of the frame
    this robot's range has changed                            near, gone: the robots that came and left
    a digest of this robot's log is due                       digest (`digests`)
    peers should know what this robot holds (`reports`)       held: the lengths of some of its logs
    a peer in range lacks entries of this robot's log         from, and the entries
    this robot is to forward what a peer lacks                from, and the entries

`From` is left out where all receivers know the offset at which this robot's log continues (`BroadcastCursors`).
"""

from __future__ import annotations

from agent.replication.base import Replication, limited
from agent.replication.control_packets import ParsedFrame, header, length_report, offset, parse
from agent.replication.delivery import Acks
from agent.replication.gossip_policy import Dependencies, GossipPolicy
from agent.replication.neighbors import BroadcastCursors, Links, Meetings
from agent.replication.peers import Table
from agent.replication.replica import Rejected, Replica
from agent.replication.reports import REFRESH, Reports
from protocol import packet_codec, packet_index
from protocol.errors import ProtocolError
from protocol.messages import EVERYONE, OutgoingFrame, RoundReport
from protocol.packets import AnyPacket, From, Gone, Held, LogDigest, Near


class Gossip(Replication):
    """One robot's broadcasts, and its processing of those that it receives."""

    def __init__(self, replica: Replica, dependencies: Dependencies) -> None:
        super().__init__(replica)
        peers, robots, reliable = self.peers, self.peers.robots, self.peers.reliable
        first_incarnation = peers.own < robots
        self.announces_digests, self.announces_requests = False, not reliable  # a late report is no request
        self._acks = Acks(replica)
        self._reports = Reports(replica, self._acks)
        self._links = Links(peers.robot, robots)
        self._meetings = Meetings(robots, settled=first_incarnation)
        self._cursors = BroadcastCursors(robots, known=first_incarnation, reliable=reliable)
        self._policy = GossipPolicy(replica, self._links, self._acks, dependencies)
        self._frame = b""
        """The broadcast of this round, of `_budget` bytes at most."""
        self._budget = 0
        self._owed: list[int] = []
        """Peers to which the reports of this round's frame were owed."""
        self._idle_since = 0
        """The last step in which this robot had nothing to send, or sent something; without ranks of entries, also one
        in which the rest of a budget was too small for it."""

    def open_round(self, number: int, in_range: list[int], budget: int | None) -> list[OutgoingFrame]:
        """Return the broadcast of this round, if there is anything to send."""
        self.replica.step += number == 0
        step = self.replica.step
        if number == 0:
            self._links.begin_step(in_range)
            self._meetings.begin_step(step, in_range)
            self._cursors.begin_step(in_range)
            self._acks.begin_step(budget)
            if not self.peers.reliable and self._links.have_parted and self._reports.is_turn():
                self._links.repeat(step // REFRESH % self.peers.robots)
        for dropped in self.replica.dropped:
            self._reports.dropped(dropped)
        self.replica.dropped.clear()
        lengths = self.replica.lengths()
        self._policy.compare(self._meetings.known(in_range), lengths)
        self._frame, self._budget = b"", limited(budget)
        if not in_range:
            return []
        self._add_reports(lengths)
        self._policy.serve(self._add_range)
        if not self._frame and (number == 0 or self.urgency is None):
            self._idle_since = step
        self.priority = self._policy.priority(len(self._frame), step - self._idle_since, self.urgency)
        return [OutgoingFrame(EVERYONE, self._frame)] if self._frame else []

    def close_round(self, report: RoundReport) -> list[Rejected]:
        """Update the tables by the parts that were on the air, and accept the entries that arrived."""
        frames: list[tuple[int, ParsedFrame]] = []
        for delivery in report.deliveries:
            try:
                frames.append((delivery.sender, parse(delivery.payload)))
            except ProtocolError as error:
                self._reject_frame(delivery.sender, str(error))
        controls = [(peer, control) for peer, frame in frames for control in frame.controls]
        for peer, control in controls:
            if isinstance(control, From):
                self._note_restart(peer, control.map)
        for peer, frame in frames:  # reports describe the state before this round
            named = {head.map: head for head in frame.named}
            for control in frame.controls:
                self._read_report(peer, control, named)
        sent = max((each.sent for each in report.sent), default=0)
        self._note_sent(sent)
        if sent:
            self._idle_since = self.replica.step
        self._frame = b""
        for peer, control in controls:
            if isinstance(control, LogDigest):
                self.replica.receive_digest(peer, control)
        for peer, frame in frames:
            for head, entries in frame.sections:
                self._read_entries(peer, head, entries)
        return self.replica.take_rejected()

    def delivered(self) -> bool:
        """Return whether peers are in range and all of this robot's log has been on the air."""
        return bool(self._links.in_range) and self.own_log.shared == self.own_log.length

    # --- sending

    def _add_reports(self, lengths: Table) -> None:
        """Add reports of this robot's range and of its log lengths to the frame."""
        self._owed = sorted(self._meetings.owed)
        for robot, here in self._links.news:
            self._add(packet_codec.encode([Near(robot) if here else Gone(robot)]))
        self._add(self._next_digest())
        in_range, parted = self._links.in_range, self._links.have_parted
        for map_id in self._reports.due(lengths, in_range, self._owed, parted=parted):
            stored = self._acks.first_stored(map_id)
            gap = b"" if stored is None else header(map_id, stored)
            length = self.own_log.shared if map_id == self.peers.own else len(self.logs[map_id])
            self._add(gap + length_report(map_id, length))

    def _add(self, packet: bytes) -> None:
        """Add a packet to the frame if it fits."""
        if len(self._frame) + len(packet) <= self._budget:
            self._frame += packet

    def _add_range(self, map_id: int, first: int, end: int) -> int:
        """Add entries of a map to the frame, behind a header where one is needed; return the offset after the last."""
        log, in_range = self.logs[map_id], self._links.in_range
        is_known = map_id == self.peers.own and self._cursors.known(first, in_range)
        head = b"" if is_known and not parse(self._frame).sections else header(map_id, first)
        added = log.read(first, self._budget - len(self._frame), end, head)
        self._frame += added
        return log.offset_after(first, len(added) - len(head)) if added else first

    def _note_sent(self, size: int) -> None:
        """Read the part of this round's frame that was on the air, its first `size` bytes, as receivers do."""
        frame = parse(packet_index.fitting(self._frame, size))
        for control in frame.controls:
            match control:
                case Near(robot) | Gone(robot):
                    self._links.inform(robot, here=isinstance(control, Near))
                case LogDigest():
                    self.own_log.digest_length = 0
                case Held(map_id, _):
                    self._acks.asked(map_id)
                    self._reports.sent(map_id, self._links.near[self.peers.robot])
        unsent = parse(self._frame).controls[len(frame.controls) :]
        if self._frame and not any(isinstance(control, Held) for control in unsent):
            self._meetings.on("informed", *self._owed)
        for head, entries in frame.sections:
            map_id = self.peers.own if head is None else head.map
            first = self._cursors.own if head is None else offset(head, len(self.logs[map_id]))
            end = first + len(entries)
            self._note_receivers(self.peers.robot, map_id, first, end)
            self._acks.broadcast(map_id)
            if map_id == self.peers.own:
                self._cursors.sent(end, self._links.in_range)
                self.own_log.sent(end)
            elif self.peers.author(map_id) == self.peers.robot:
                self._cursors.sent(end, [])  # receivers may take an earlier log for the current one

    def _note_receivers(self, sender: int, map_id: int, first: int, end: int) -> None:
        """Note that all in range of a sender received entries `first` to `end` - 1 of a map, if they held those before.

        If this robot holds the entries, they know that.
        """
        receivers = self._links.near[sender]
        self._acks.sent(map_id, receivers, first, end)
        if len(self.logs[map_id]) >= end:
            self._reports.inform(receivers, map_id, end)

    # --- receiving

    def _reject_frame(self, peer: int, reason: str) -> None:
        """Reject a frame that is malformed; where the peer's next broadcast begins is no longer known."""
        self._cursors.others.pop(peer, None)
        self.replica.reject(peer, self.peers.current[peer], reason)

    def _note_restart(self, peer: int, map_id: int) -> None:
        """A peer that broadcasts a map of a new incarnation of its own lost its state."""
        if self.peers.restarted(peer, map_id):
            self._cursors.forget(peer)
            self._links.restarted(peer)
            self._reports.restarted(peer)
            self._meetings.on("restarted", peer)

    def _read_report(self, peer: int, control: AnyPacket, named: dict[int, From]) -> None:
        """Note a peer's range or a log length; reject the peer's entries if it sends another control packet.

        `named`: by map, the headers of its frame without entries. In front of a report, such a header names the first
        entry behind a gap. By a report of its own map, a peer asks for reports of it.
        """
        logs, robots, is_lossy = self.logs, self.peers.robots, not self.peers.reliable
        match control:
            case Near(robot) | Gone(robot) if robot < robots:
                self._links.near[peer, robot] = is_near = robot == peer or isinstance(control, Near)
                self._links.have_parted |= is_lossy and not is_near
            case Held(map_id, _) if map_id < len(logs) and (
                map_id != peer or self.peers.may_restart or is_lossy
            ):
                length = self._possible(map_id, offset(control, len(logs[map_id])))
                if is_lossy:
                    is_question = map_id == self.peers.current[peer]
                    self._reports.urgent[map_id] |= is_question or length > len(logs[map_id])
                elif length < self.peers.expected.item(peer, map_id):
                    self._peer_dropped(peer, map_id, length)
                gap_end = offset(named[map_id], len(logs[map_id])) if map_id in named else 0
                self._acks.report_received(peer, map_id, length, gap_end)
                self._meetings.on("reported", peer)
            case LogDigest():
                pass
            case From(map_id, _) if map_id < len(logs):
                pass
            case _:
                self._reject_frame(peer, f"{control} is not valid in gossip of {robots} robots")

    def _read_entries(self, peer: int, head: From | None, entries: list[bytes]) -> None:
        """Accept new entries of a map, and note which peers received them and know that this robot did."""
        map_id = self.peers.current[peer] if head is None else head.map
        if map_id >= len(self.logs):
            return
        log, replica, reports = self.logs[map_id], self.replica, self._reports
        first = self._cursors.others.get(peer) if head is None else offset(head, log.length)
        if first is None:
            reports.urgent[map_id] = True
            return
        length = log.length
        replica.receive(peer, map_id, first, entries)
        end = max(first, self._possible(map_id, first + len(entries)))
        if end == first:
            return
        if map_id == self.peers.current[peer]:
            self._cursors.received(peer, end)
        self.peers.acknowledge(peer, map_id, end)
        if self.peers.reliable:
            reports.urgent[map_id] = first > length
        if first > length and not replica.refuses(peer, map_id):
            self._acks.store(peer, map_id, first, entries)
        self._note_receivers(peer, map_id, first, end)
        while (stored := self._acks.stored(map_id, log.length)) is not None:
            reports.urgent[map_id] = True
            replica.accept(stored[0], map_id, stored[1])
