"""The radio of a run: it runs the rounds of a step, phase by phase (docs/architecture.md, A step).

Each step goes through one pipeline. The relay admits frames (`netshaper.admission`), draws their order, carries them as
far as the budget and the channel allow (`netshaper.medium`), and accounts for every byte (`netshaper.frame_log`).

A round of handshakes, on a perfect radio without gossip, has three phases:

    offers    all robots send their poses and targets (first round) and offers; poses and targets go on the air
    answers   each receiver of offers answers every one, in the drawn order
    data      each sender of offers has the answers, and sends missing entries
    (end)     the connections go on the air in the drawn order until the budget is spent; both ends get reports

All other rounds have one phase: robots broadcast, or send frames to one robot, and the relay puts them on the air by
priority and fair share. Replies follow in the next round. Senders learn which bytes were on the air, not which arrived.

A phase ends when all robots that it concerns have answered or are dead. By the wall clock, it ends without robots that
are late (`netshaper.phase_clock`): they miss the step's further phases, as if their radios were mute. A further round
begins while some budget is left. A frame that is malformed, out of range or out of turn is logged as such and delivered
to no robot.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import TypeVar

import msgspec

from netshaper.admission import content_of, read_broadcast, readers
from netshaper.airtime import Shares
from netshaper.frame_log import Connection, Frame
from netshaper.ledger import ANSWER, BROADCAST, DATA, EVERYONE, NEWS, OFFER
from netshaper.medium import Account, Medium
from netshaper.phase_clock import PHASES
from netshaper.settings import RadioSettings
from netshaper.topology import Topology
from protocol import messages
from protocol.faults import RADIO_KINDS, FaultSchedule
from protocol.grid import Cell
from protocol.keyed_random import keyed_random

Item = TypeVar("Item")

_STEP = attrgetter("step")
_FRAME = attrgetter("frame")
_PAIR = attrgetter("sender", "receiver", "map_id")

NOT_FOR_ALL = "sent to all, where maps are offered to one robot"
NOT_FOR_ONE = "news are a broadcast: sent to one robot"
TWICE = "more than one frame, or more than one offer of a map, for a receiver in a round"


class Radio:
    """The radio of one run: it takes positions and the frames of robots, and makes events and accounts of them."""

    def __init__(self, settings: RadioSettings) -> None:
        self.settings = settings
        self.events: list[tuple[int, messages.MediumEvent]] = []
        """Events, each with its robot, in order, since this list was last emptied."""
        self.accounts: list[Account] = []
        """Accounts of the steps that ended since this list was last emptied."""
        self.protocol_errors: list[tuple[int, str]] = []
        """Robots that broke the protocol, and how, since this list was last emptied."""
        self.changed: list[messages.Change | messages.FaultEvent] = []
        """Changes and faults of radios that apply from this step on, since this list was last emptied."""
        self._changes = sorted(settings.changes, key=_STEP)
        """Changes of later steps."""
        self._faults = FaultSchedule(settings.faults)
        self._topology = Topology()
        self._readers = readers(settings)
        """For each kind of frame the function that reads it."""
        self._medium = Medium(settings)
        self._shares = Shares()
        self._step = 0
        self._round = 0
        self._phase = ""
        self._asked: list[int] = []
        """The robots that the current phase concerns."""
        self._waiting: set[int] = set()
        """Those of them that have not answered yet."""
        self._submitted: dict[int, messages.RobotFrames] = {}
        """The frames of the others."""
        self._connections: list[Connection] = []
        self._first = 0
        """Number of the round's first connection; they are counted through a step."""
        self._broadcast_sent: dict[int, bool] = {}
        """Robots that broadcast a pose or target in this round, and whether it was on the air."""

    # --- events from outside

    def begin(self, step: int, cells: Mapping[int, Cell]) -> None:
        """Open the medium for a step, with the true cell (x, y) of each living robot.

        The account of this step includes the frames that robots sent while the medium was closed. A single robot's
        medium closes at once.
        """
        self._step, self._round = step, 0
        while self._changes and self._changes[0].step <= step:
            self._apply(msgspec.structs.replace(self._changes.pop(0), step=step))
        self.changed += [
            msgspec.structs.replace(fault, step=step)
            for fault in self._faults.due(step, range(self.settings.robots))
        ]
        self._topology.begin(self.settings, step, cells, *(self._faults.active[kind] for kind in RADIO_KINDS))
        self._medium.begin_step(step, self._topology.in_range)
        self._shares.next_step()
        self._connections, self._first = [], 0
        if self.settings.robots > 1:
            self._open()
            self._shares.broadcasts.next_step(self.settings.budget.limit or 0, len(self._asked))
        else:
            self._close()
        self._advance()

    def change(self, change: messages.Change | messages.FaultEvent) -> None:
        """Schedule a change of budget or range, or a radio's fault, for a step that has not begun."""
        coming = msgspec.structs.replace(change, step=max(change.step, self._step + 1))
        if isinstance(coming, messages.FaultEvent):
            self._faults.add(coming)
        else:
            self._changes = sorted([*self._changes, coming], key=_STEP)

    def submit(self, sender: int, submitted: messages.RobotFrames) -> None:
        """Take all frames that a robot sends in this phase."""
        if sender in self._topology.dead:
            return
        if sender not in self._waiting or (submitted.step, submitted.round, submitted.phase) != self.phase:
            is_late = sender in self._topology.late and submitted.step <= self._step
            if not is_late:
                self._refuse_out_of_turn(sender, submitted)
            return
        self._submitted[sender] = submitted
        self._waiting.discard(sender)
        self._advance()

    def lost(self, robot: int) -> None:
        """Stop waiting for a robot that is dead."""
        self._topology.dead.add(robot)
        self._waiting.discard(robot)
        self._advance()

    def skip(self, robots: Collection[int]) -> None:
        """Stop waiting for robots that miss this phase; they take no part in the step's further phases."""
        self._topology.note_missed(robots)
        self._waiting.difference_update(robots)
        self._advance()

    def back(self, robot: int) -> None:
        """Let a robot that was lost take part again from the next step on."""
        self._topology.dead.discard(robot)

    @property
    def phase(self) -> tuple[int, int, str]:
        """The current step, round and phase."""
        return self._step, self._round, self._phase

    def waiting_for(self) -> list[int]:
        """Return the robots that have not answered in this phase yet."""
        return sorted(self._waiting)

    def _apply(self, change: messages.Change) -> None:
        self.changed.append(change)
        if change.budget is not None:
            self.settings = replace(self.settings, budget=change.budget)
            self._medium.airtime.set_budget(change.budget)
        if change.range_mm is not None:
            cells = change.range_mm / 1000 / self.settings.cell_m
            self.settings = replace(self.settings, range_cells=cells)

    # --- rounds and phases

    def _open(self) -> None:
        """Begin a round."""
        self._first += len(self._connections)
        self._connections = []
        self._broadcast_sent = {}
        participants = self._topology.participants()
        self._expect("offers", participants)
        detected, room = self._topology.detected_by, self._medium.airtime.room
        for robot in participants:
            event = messages.Open(self._step, self._round, detected(robot), room(robot))
            self.events.append((robot, event))

    def _expect(self, phase: str, robots: Sequence[int]) -> None:
        self._phase = phase
        self._asked = [robot for robot in robots if robot not in self._topology.dead]
        self._waiting = set(self._asked)
        self._submitted = {}

    def _advance(self) -> None:
        """End phases while none of the robots that they concern is still to answer."""
        while self._phase and not self._waiting:
            if self._phase == "data":
                self._end_data()
            elif self._phase == "answers":
                self._collect(ANSWER)
                self._deliver(ANSWER)
            elif self.settings.handshakes:
                self._end_offers()
            else:
                self._end_only_phase()

    def _next_round(self, *, busy: bool) -> None:
        """Begin a further round, or close the medium if none is allowed or of use."""
        self._round += 1
        self._medium.next_round()
        left = any(not self._medium.airtime.room(robot).spent for robot in self._topology.in_range)
        if busy and left and self._round < self.settings.rounds:
            self._open()
        else:
            self._close()

    def _close(self) -> None:
        self._phase = ""
        self.events += [(robot, messages.Close(self._step)) for robot in self._topology.living()]
        self.accounts.append(self._medium.close())

    # --- admission and order

    def _refuse(self, frame: Frame, cause: str, reason: str = "") -> None:
        self._medium.refuse(frame, cause, reason)
        if reason:
            self.protocol_errors.append((frame.sender, reason))

    def _refuse_out_of_turn(self, sender: int, submitted: messages.RobotFrames) -> None:
        at = f"round {submitted.round} of step {submitted.step}"
        error = f"sent frames of phase {submitted.phase!r}, {at}, out of turn in step {self._step}"
        self.protocol_errors.append((sender, error))
        frames = [messages.OutgoingFrame(EVERYONE, submitted.broadcast)] if submitted.broadcast else []
        reason = "spoke out of turn"
        for each in [*frames, *submitted.frames]:
            self._refuse(Frame(sender, each.receiver, content_of(DATA, each.payload)), "protocol", reason)

    def _admit(self, kind: int) -> tuple[list[Frame], list[Frame]]:
        """Return the admitted broadcasts of poses and targets, and the other admitted frames of the first phase."""
        broadcasts: list[Frame] = []
        frames: list[Frame] = []
        read, receiving = self._readers[kind], self._topology.receiving()
        for sender, submitted in sorted(self._submitted.items()):
            if submitted.broadcast:
                frame = Frame(sender, EVERYONE, read_broadcast(submitted.broadcast, self._round))
                if frame.content.problem:
                    self._refuse(frame, "protocol", frame.content.problem)
                else:
                    broadcasts.append(frame)
            reachable = {EVERYONE, *self._topology.in_range.get(sender, ())}
            mute, first = sender in self._topology.mute, int(bool(submitted.broadcast))
            sent: set[tuple[int, int]] = set()
            for position, each in enumerate(submitted.frames):
                receiver, content = each.receiver, read(each.payload)
                pair = receiver, content.map_id if kind == OFFER else -1
                problem = content.problem or (TWICE if pair in sent else "")
                if (receiver == EVERYONE) != self.settings.gossip:
                    problem = NOT_FOR_ALL if receiver == EVERYONE else NOT_FOR_ONE
                if receiver not in reachable:
                    self._refuse(Frame(sender, receiver, content), "range")
                elif problem:
                    self._refuse(Frame(sender, receiver, content), "protocol", problem)
                elif mute:
                    self._refuse(Frame(sender, receiver, content), "mute")
                elif kind != OFFER and receiver != EVERYONE and receiver not in receiving:
                    self._refuse(Frame(sender, receiver, content), "lost")
                else:
                    sent.add(pair)
                    frames.append(
                        Frame(sender, receiver, content, content.map_id, -1, position, first + position)
                    )
        return broadcasts, frames

    def _drawn(self, purpose: str, items: list[Item]) -> list[Item]:
        """Put items into an order that is drawn for this round."""
        if len(items) < 2:
            return items
        draw = keyed_random(self.settings.seed, purpose, self._step, self._round)
        return [items[index] for index in draw.permutation(len(items)).tolist()]

    # --- broadcasts of poses and targets

    def _send_broadcasts(self, broadcasts: list[Frame]) -> list[Frame]:
        """Put poses and targets on the air; return those that wait until maps have been sent.

        With gossip and a limited budget, all broadcasts together get a limited share (`BroadcastShare`).
        """
        waiting: list[Frame] = []
        share, medium, limit = self._shares.broadcasts, self._medium, self.settings.budget.limit
        is_limited = self.settings.gossip and limit is not None
        for frame in self._drawn("targets", broadcasts):
            sender, size = frame.sender, len(frame.content.payload)
            if sender in self._topology.mute:
                self._refuse(frame, "mute")
            elif is_limited and not medium.carried and share.owes:
                waiting.append(frame)
            elif is_limited and medium.carried and not share.fits(size):
                self._refuse_broadcast(frame)
            else:
                sent = medium.carry(frame, self._topology.receivers_of(sender))
                self._broadcast_sent[sender] = sent > 0
                if is_limited:
                    share.book(sent)
        return waiting

    def _send_waiting(self, waiting: Sequence[Frame]) -> None:
        """Put the first broadcast on the air that fits into what maps have left of the budget; refuse the others."""
        sent = 0
        for frame in waiting:
            room = self._medium.airtime.room(frame.sender)
            if not sent and room.fits(len(frame.content.payload)):
                sent = self._medium.carry(frame, self._topology.receivers_of(frame.sender))
                self._broadcast_sent[frame.sender] = sent > 0
            else:
                self._refuse_broadcast(frame)

    def _refuse_broadcast(self, frame: Frame) -> None:
        """Refuse a broadcast for which there is no budget."""
        self._refuse(frame, "budget")
        self._broadcast_sent[frame.sender] = False

    def _deliver_broadcasts(self) -> dict[int, list[messages.Delivery]]:
        """Deliver the broadcasts that have arrived by now, and return for each robot the other arrivals."""
        poses: defaultdict[int, list[messages.Delivery]] = defaultdict(list)
        others: defaultdict[int, list[messages.Delivery]] = defaultdict(list)
        receiving = self._topology.receiving()
        for arrival in self._medium.arrivals():
            by_robot = poses if arrival.kind == BROADCAST else others
            for robot in arrival.receivers:
                if robot in receiving:
                    by_robot[robot].append(arrival.delivery)
        self.events += [(robot, messages.Broadcasts(self._step, poses[robot])) for robot in sorted(poses)]
        return others

    # --- rounds with one phase

    def _end_only_phase(self) -> None:
        """Put all frames on the air, deliver those that have arrived by now, and report to their senders."""
        broadcasts, frames = self._admit(NEWS)
        waiting = self._send_broadcasts(broadcasts)
        before = self._medium.carried
        reports: defaultdict[int, list[messages.SendReport]] = defaultdict(list)
        for frame in self._by_priority(frames):
            sender, receiver = frame.sender, frame.receiver
            receivers = self._topology.receivers_of(sender) if receiver == EVERYONE else [receiver]
            sent = self._medium.carry(frame, receivers)
            self._shares.book(sender, sent)
            reports[sender].append(messages.SendReport(frame.position, sent))
        if broadcasts and before and self._medium.carried == before:
            self._pay_unused(frames)
        self._send_waiting(waiting)
        arrived = self._deliver_broadcasts()
        self._report({}, reports, arrived)
        self._next_round(
            busy=bool(arrived) or any(report.sent for mine in reports.values() for report in mine)
        )

    def _pay_unused(self, frames: Sequence[Frame]) -> None:
        """Let broadcasts pay for the rest of a budget that none of these frames could use.

        That is so if a packet of them would have fitted before the broadcasts.
        """
        medium, budget = self._medium, self.settings.budget
        rooms = ((budget.least(medium.airtime.own(frame.sender)), frame) for frame in frames)
        tail = self.settings.checksum_bytes
        if any(room.fits(frame.content.packets.sizes[0] + tail) for room, frame in rooms):
            self._shares.broadcasts.book_unused(budget.minus(medium.carried).limit or 0)

    def _by_priority(self, frames: list[Frame]) -> list[Frame]:
        """Put frames into the order in which they go on the air: acknowledgments first, then by rank."""
        ranks = {
            sender: self._shares.rank(sender, submitted.priority, self.settings.budget)
            for sender, submitted in self._submitted.items()
        }
        order = self._drawn("back-off" if self.settings.perfect else "contention", frames)
        return sorted(order, key=lambda frame: (frame.content.kind != ANSWER, ranks[frame.sender]))

    def _report(
        self,
        connections: Mapping[int, list[messages.ConnectionReport]],
        sent: Mapping[int, list[messages.SendReport]],
        arrived: Mapping[int, list[messages.Delivery]],
    ) -> None:
        """Report the end of a round to each robot that sent or received anything."""
        for robot in sorted({*connections, *sent, *arrived, *self._broadcast_sent} - self._topology.dead):
            mine = sorted(sent.get(robot, ()), key=_FRAME)
            deliveries, broadcast = arrived.get(robot, []), self._broadcast_sent.get(robot, False)
            report = messages.RoundReport(
                self._step, self._round, connections.get(robot, []), mine, deliveries, broadcast
            )
            self.events.append((robot, report))

    # --- rounds of handshakes

    def _end_offers(self) -> None:
        """Put poses and targets on the air, open connections, and deliver their offers."""
        broadcasts, offers = self._admit(OFFER)
        self._send_broadcasts(broadcasts)
        self._deliver_broadcasts()
        offers.sort(key=_PAIR)
        for number, frame in enumerate(self._drawn("contention", offers), self._first):
            self._connections.append(Connection(number, [msgspec.structs.replace(frame, connection=number)]))
        self._deliver(OFFER)

    def _deliver(self, kind: int) -> None:
        """Deliver all frames of a kind in the drawn order, and ask their receivers for the next phase."""
        receiving = self._topology.receiving() - self._topology.absent
        arrived: defaultdict[int, list[messages.Delivery]] = defaultdict(list)
        for connection in self._connections:
            if len(connection.frames) > kind:
                frame = connection.frames[kind]
                if frame.receiver in receiving:
                    payload = frame.content.payload
                    arrived[frame.receiver].append(
                        messages.Delivery(frame.sender, payload, frame.connection, frame.map_id)
                    )
                else:
                    connection.lost = True
        self._expect(PHASES[kind + 1], sorted(arrived))
        for robot, deliveries in sorted(arrived.items()):
            event = messages.PhaseDelivery(self._step, self._round, PHASES[kind], deliveries)
            self.events.append((robot, event))

    def _collect(self, kind: int) -> None:
        """Match the submitted frames to their connections; refuse frames that belong to none."""
        for sender, submitted in sorted(self._submitted.items()):
            for each in submitted.frames:
                receiver, content = each.receiver, self._readers[kind](each.payload)
                at = each.connection - self._first
                connection = self._connections[at] if 0 <= at < len(self._connections) else None
                if connection is None or not connection.accepts(kind, sender, receiver):
                    reason = "a frame of no connection of its own"
                    self._refuse(Frame(sender, receiver, content), "protocol", reason)
                elif content.problem:
                    self._refuse(Frame(sender, receiver, content), "protocol", content.problem)
                else:
                    map_id = connection.offer.map_id
                    connection.frames.append(Frame(sender, receiver, content, map_id, connection.number))

    def _end_data(self) -> None:
        """Play the connections, and report to both ends of each."""
        self._collect(DATA)
        reports: defaultdict[int, list[messages.ConnectionReport]] = defaultdict(list)
        dead = self._topology.dead
        for connection in self._connections:
            offer = connection.offer
            if offer.receiver in dead and len(connection.frames) > DATA:
                connection.lost = True
            report = self._medium.play(connection)
            reports[offer.sender].append(report)
            reports[offer.receiver].append(report)
        self._report(reports, {}, self._deliver_broadcasts())
        self._next_round(busy=True)
