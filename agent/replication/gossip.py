"""Gossip: dissemination by broadcast, so one transmission serves all robots in range (docs/replication.md).

Robots broadcast entries of their own logs as they write them, and forward others' entries to peers that lack them:
anti-entropy (Demers et al., 1987) over a shared medium. Each robot keeps a version vector for each peer and the radio
range of each peer; broadcasts keep both up to date. So robots in range of each other have the same tables and choose
the same forwarder (`gossip_policy`). A frame holds, in this order:

    event                                                     part of the frame
    this robot's range has changed                            near, gone: the robots that came and left
    a digest of this robot's log is due                       digest (`digests`)
    entries were dropped (`replica`)                          held: the length of that log
    a meeting owes reports (`neighbors`)                      held: each map of which the peer may know less
    entries arrived behind a gap                              held: this robot's log length, until the gap is filled
    some robot has been out of range before                   held: one map, in turn, every `REFRESH` steps
    peer acknowledgments are due (`delivery.Acks`)            held: the maps with news
    a peer in range lacks entries of this robot's log         from, and the entries
    this robot is to forward what a peer lacks                from, and the entries

`From` is left out where all receivers know the offset at which this robot's log continues (`BroadcastCursors`).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from agent.replication.base import Replication
from agent.replication.control_packets import Header, ParsedFrame, header, offset, parse, report
from agent.replication.delivery import PATIENCE, Acks
from agent.replication.frame_builder import FrameBuilder
from agent.replication.gossip_policy import Dependencies, GossipPolicy
from agent.replication.neighbors import BroadcastCursors, Meetings, Neighbors
from agent.replication.peers import Mask, Table
from agent.replication.replica import Rejected, Replica
from protocol import packet_codec
from protocol.arrays import Bools, Int64s
from protocol.errors import ProtocolError
from protocol.kernels import kernel
from protocol.messages import EVERYONE, OutgoingFrame, RoundReport
from protocol.packets import From, FromEarly, Gone, Held, HeldEarly, LogDigest, Near

REFRESH = 16
"""Steps after which a robot that has not always had all others in range reports one more map."""


class Gossip(Replication):
    """One robot's broadcasts, and its processing of those that it receives."""

    def __init__(self, replica: Replica, acks: Acks, dependencies: Dependencies) -> None:
        super().__init__(replica)
        peers = self.peers
        robot, robots, first_incarnation = peers.robot, peers.robots, peers.own < peers.robots
        self._acks = acks
        self._neighbors = Neighbors(robot, robots)
        self._meetings = Meetings(robots, settled=first_incarnation)
        self._cursors = BroadcastCursors(robot, robots, known=first_incarnation, reliable=acks.reliable)
        self._policy = GossipPolicy(peers, replica.logs, self._neighbors, dependencies)
        self._informed = peers.new_table()
        """``_informed[peer, map]``: entries that the peer knows this robot to hold."""
        self._in_range: list[int] = []
        self._parted = False
        """Whether any robot has ever been out of range."""
        self._gaps: set[int] = set()
        """Maps of which entries came behind others that this robot lacks."""
        self._reported: Table = np.full(peers.maps, -PATIENCE, np.int64)
        """The step in which this robot last reported each map."""
        self._idle_since = 0
        """The last step in which this robot had nothing to send, or sent something.

        Without ranks of entries, also one in which the rest of a budget was too small for it.
        """
        self._builder = FrameBuilder()

    def open_round(self, number: int, in_range: list[int], budget: int | None) -> list[OutgoingFrame]:
        """Return the broadcast of this round, if there is anything to send."""
        self.replica.step += number == 0
        step = self.replica.step
        if number == 0:
            self._meetings.begin_step(step, in_range)
            self._cursors.begin_step(in_range)
            self._in_range = in_range
            self._parted = self._parted or len(in_range) < self.peers.robots - 1
        for dropped in self.replica.take_dropped():
            self._entries_dropped(dropped)
        self._acks.open_round(step, budget if number == 0 else None)
        lengths = self.replica.lengths()
        self._policy.compare(step, self._meetings.known(self._in_range), lengths)
        self._builder = FrameBuilder(budget)
        if not in_range:
            return []
        self._add_reports(lengths)
        served = self._policy.serve(self._in_range, self._acks.turn, self._add_range)
        payload = self._builder.payload
        if not payload:
            self._builder = FrameBuilder()  # without handlers, which refer to this object
            if number == 0 or self.urgency is None:
                self._idle_since = step
        has_own = self.shared < len(self.replica.own_log)
        self.priority = self._policy.priority(
            served,
            len(payload),
            step - self._idle_since,
            parted=self._parted,
            unfinished=has_own and self.replica.last_append < self.shared,
            urgency=self.urgency if has_own else None,
        )
        return [OutgoingFrame(EVERYONE, payload)] if payload else []

    def announcements(self) -> bytes:
        """Return the requests for dropped entries, unless frames of gossip have them: a late report is no request."""
        return b"" if self._acks.reliable else self._requests()

    def announced(self) -> None:
        """Note that this step's broadcast was on the air."""
        if not self._acks.reliable:
            self._requests_sent()

    def close_round(self, report: RoundReport) -> list[Rejected]:
        """Update the tables by the parts that were on the air, and accept the entries that arrived."""
        frames: list[tuple[int, ParsedFrame]] = []
        for delivery in report.deliveries:
            try:
                frames.append((delivery.sender, parse(delivery.payload)))
            except ProtocolError as error:
                self._reject_frame(delivery.sender, str(error))
        for peer, frame in frames:
            self._note_restart(peer, frame)
        for peer, frame in frames:  # reports describe the state before this round
            self._read_reports(peer, frame)
        sent = max((each.sent for each in report.sent), default=0)
        self._builder.sent(sent)
        if sent:
            self._idle_since = self.replica.step
        self._builder = FrameBuilder()
        for peer, frame in frames:
            for control in frame.controls:
                if isinstance(control, LogDigest):
                    self.replica.receive_digest(peer, control)
        for peer, frame in frames:
            for head, entries in frame.sections:
                self._read_entries(peer, head, entries)
        return self.replica.take_rejected()

    def delivered(self) -> bool:
        """Return whether peers are in range and all of this robot's log has been on the air."""
        return bool(self._in_range) and self.shared == len(self.replica.own_log)

    # --- sending

    def _add_reports(self, lengths: Table) -> None:
        """Add reports of this robot's range and of its log lengths to the frame."""
        builder, owed = self._builder, self._meetings.owed()
        for robot, here in self._neighbors.news(self._in_range):
            near = packet_codec.encode([Near(robot) if here else Gone(robot)])
            if builder.fits(near):
                builder.add(near, partial(self._neighbors.inform, self._in_range, robot, here))
        digest = self._next_digest()
        if digest and builder.fits(digest):
            builder.add(digest, self._digest_sent)
        end = 0
        for number in self._reports_due(lengths, owed).nonzero()[0].tolist():
            held = report(number, len(self.logs[number]))
            if builder.fits(held):
                end = builder.add(held, partial(self._report_sent, number))
        builder.add_marker(end, partial(self._reports_sent, owed))

    def _reports_due(self, lengths: Table, owed: list[int]) -> Mask:
        """Return the mask of maps of which some peer should know how much this robot holds."""
        robots, step = self.peers.robots, self.replica.step
        due = np.zeros(len(lengths), np.bool_)
        for peer in owed:
            due |= self._informed[peer] < lengths
        if self._acks.reliable:
            due[self.replica.maps_to_ask_for()] = True
        for number in self._gaps:
            due[number] |= step >= self._reported[number] + self._acks.gap_interval
        if self._parted and step % REFRESH == self.peers.robot % REFRESH:
            numbers = np.arange(len(lengths))
            due |= (numbers % robots == step // REFRESH % robots) & ((numbers < robots) | (lengths > 0))
        self._acks.add_due(due, lengths, step, self._reported)
        due[self.peers.own] = False
        return due

    def _add_range(self, number: int, first: int, end: int) -> int:
        """Add entries of a map to the frame, behind a header where one is needed; return the offset after the last."""
        own = number == self.peers.own
        continues = own and not self._builder.has_entries and self._cursors.known(first, self._in_range)
        head = b"" if continues else header(number, first)
        return self._builder.add_entries(
            self.logs[number], first, end, head, partial(self._entries_sent, number)
        )

    # --- what was on the air

    def _report_sent(self, number: int) -> None:
        """This robot's report of a map was on the air."""
        self.replica.asked(number)
        length = len(self.logs[number])
        self._reported[number] = self.replica.step
        self._gaps.discard(number)
        self._inform(self._listeners(), number, length)
        self._acks.report_sent(number, length)

    def _reports_sent(self, owed: list[int]) -> None:
        """All reports that this robot owed to peers were on the air."""
        for peer in owed:
            self._meetings.on(peer, "informed")

    def _entries_sent(self, number: int, first: int, end: int) -> None:
        """Entries `first` to `end` - 1 of a map were on the air."""
        listeners = self._listeners()
        self._inform(listeners, number, end)
        _raise_lengths(self.peers.expected.T[number], listeners, first, end)
        if number == self.peers.own:
            self._cursors.sent(end, self._in_range)
            self.shared = max(self.shared, end)
        elif self.peers.author(number) == self.peers.robot:
            self._cursors.sent_earlier_incarnation()

    def _listeners(self) -> Mask:
        """Return the mask of the robots in range."""
        listeners = np.zeros(self.peers.robots, np.bool_)
        listeners[self._in_range] = True
        return listeners

    # --- receiving

    def _reject_frame(self, peer: int, reason: str) -> None:
        """Reject a frame that is malformed; where the peer's next broadcast begins is no longer known."""
        self._cursors.missed(peer)
        self.replica.reject(peer, self.peers.current[peer], reason)

    def _entries_dropped(self, number: int) -> None:
        """This robot dropped entries of a map, so peers know that it holds more than it does."""
        length = len(self.logs[number])
        self._informed[:, number] = np.minimum(self._informed[:, number], length)
        self._acks.report_sent(number, length)

    def _peer_dropped(self, peer: int, number: int, length: int) -> None:
        """A peer dropped entries, so it lacks them."""
        super()._peer_dropped(peer, number, length)
        self._acks.dropped(peer, number)

    def _note_restart(self, peer: int, frame: ParsedFrame) -> None:
        """A peer that broadcasts a map of a new incarnation of its own lost its state."""
        for control in frame.controls:
            if isinstance(control, Header) and self.peers.restarted(peer, control.map):
                self._informed[peer] = 0
                for part in (self._acks, self._cursors, self._neighbors):
                    part.restarted(peer)
                self._meetings.on(peer, "restarted")

    def _read_reports(self, peer: int, frame: ParsedFrame) -> None:
        """Note a peer's range and its log lengths; reject the peer's entries if it sends other control packets."""
        logs, robots = self.logs, self.peers.robots
        for control in frame.controls:
            match control:
                case Near(robot) | Gone(robot) if robot < robots:
                    self._neighbors.near[peer, robot] = isinstance(control, Near)
                case (Held(number, _) | HeldEarly(number, _)) as held if number < len(logs) and (
                    number != peer or self.peers.may_restart
                ):
                    length = self._possible(number, offset(held, len(logs[number])))
                    dropped = length < self.peers.expected.item(peer, number)
                    if dropped and number == self.peers.own and self._acks.reliable:
                        self.replica.request_digest(length)
                    self._acks.report_received(peer, number, length, self.replica.step)
                    self._meetings.on(peer, "reported")
                    self._neighbors.near[peer, self.peers.robot] = True
                case LogDigest():
                    pass
                case From(number, _) | FromEarly(number, _) if number < len(logs):
                    pass
                case other:
                    reason = f"{other} is not valid in gossip of {robots} robots"
                    self._reject_frame(peer, reason)

    def _read_entries(self, peer: int, head: Header | None, entries: list[bytes]) -> None:
        """Accept new entries of a map, and note which peers received them and know that this robot did."""
        number = self.peers.current[peer] if head is None else head.map
        if number >= len(self.logs):
            return
        log, replica = self.logs[number], self.replica
        first = self._cursors.of(peer) if head is None else offset(head, log.length)
        if first is None:
            self._gaps.add(number)
            return
        if number == self.peers.own:
            replica.check_own(peer, first, entries)
        end = max(first, self._possible(number, first + len(entries)))
        if end == first:
            return
        self._acks.entries_received(peer, number, end, log.length)
        if number == self.peers.current[peer]:
            self._cursors.received(peer, end)
        self.peers.expect(peer, number, end)
        if first > log.length:
            self._gaps.add(number)
            if not replica.refuses(peer, number):
                self._acks.store(peer, number, first, entries)
        else:
            self._gaps.discard(number)
        if first <= log.length < end and number not in self.peers.own_maps:
            replica.accept(peer, number, b"".join(entries[log.length - first :]))
        _note_receivers(
            self._neighbors.near[peer],
            self.peers.expected.T[number],
            self._informed.T[number],
            peer,
            self.peers.robot,
            first,
            end,
            log.length >= end,
        )
        while (stored := self._acks.stored(number, log.length)) is not None:
            self._gaps.add(number)
            replica.accept(stored[0], number, stored[1])

    def _inform(self, peers: Mask, number: int, length: int) -> None:
        """Peers know that this robot holds so many entries of a map."""
        _raise_lengths(self._informed.T[number], peers, 0, length)


@kernel
def _note_receivers(
    near: Bools,
    expected: Int64s,
    informed: Int64s,
    peer: int,
    robot: int,
    first: int,
    end: int,
    holds: bool,
) -> None:
    """Note that a peer sent entries `first` to `end` - 1 of a map, which the robots `near` it received.

    Receivers take the entries unless they lack earlier ones. If this robot `holds` the entries now, the peer and its
    receivers know that. `expected` and `informed` are the columns of this map in the tables of the same names.
    """
    for other in range(len(near)):
        if near[other] and other != robot and expected[other] >= first:
            expected[other] = max(expected[other], end)
        if holds and (near[other] or other in (peer, robot)):
            informed[other] = max(informed[other], end)


@kernel
def _raise_lengths(lengths: Int64s, peers: Bools, first: int, end: int) -> None:
    """Raise the lengths of a map to `end`, for those of `peers` where they are at least `first`."""
    for peer in range(len(peers)):
        if peers[peer] and lengths[peer] >= first:
            lengths[peer] = max(lengths[peer], end)
