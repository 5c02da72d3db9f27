"""The relay's mind: one step of the radio, phase by phase (docs/architecture.md, A step).

    offers    all robots say their targets (first exchange) and offers; targets go on the air first
    answers   each receiver has heard its offers, in the seeded order, and answers every one
    data      each sender has heard the answers and sends what is news
    (played)  the connections go on the air in the seeded order until the budget is spent; both sides are told

A further exchange is opened while something is left of the budget.

Where maps travel by gossip there are no connections (`netshaper.gossip_radio`).

A phase ends when all whom it concerns have spoken or are known to be dead. Nothing that robots say is
believed: a frame that is malformed, out of range or out of turn is booked as such and passed on to nobody.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import NamedTuple, TypeVar

import msgspec

from netshaper import airtime, connectivity, replies
from netshaper.frames import is_broadcast, read_offer, wrong_in_answer, wrong_in_data
from netshaper.ledger import EVERYONE
from netshaper.medium import ANSWER, BROADCAST, DATA, OFFER, UNLIMITED, Connections, Medium
from netshaper.radio_options import RadioOptions
from netshaper.replies import Beforehand
from protocol import packet_index, packets
from protocol.grid import Grid
from protocol.keyed_random import keyed_random
from protocol.messages import Change, Close, MediumNote, Open, Outcome, PhaseDelivery, Said

Item = TypeVar("Item")

_WHEN = attrgetter("step")

PHASES = ("offers", "answers", "data")


@dataclass(frozen=True, eq=False)
class RadioSettings:
    """What the radio is like.

    Attributes
    ----------
    robots : int
    seed : int
    range_cells : float
        Communication range in cells; infinite where everyone hears everyone.
    budget : int
        Bytes a step that the team shares, `UNLIMITED` for no limit.
    exchanges : int
        Exchanges a step (R).
    """

    robots: int
    seed: int
    range_cells: float
    budget: int = UNLIMITED
    rounds: int = 2
    gossip: bool = False
    """Whether news of maps are broadcast; else robots offer them to each other."""
    incarnations: int = 1
    """How often a robot may begin; each of its lives has a map of its own."""
    options: RadioOptions = field(default_factory=RadioOptions)
    cell_m: float = 1.0
    """Side of a cell in metres."""
    walls: Grid | None = None
    """The world's cells, where links depend on them."""
    send: tuple[int, ...] = ()
    """Bytes a step that each robot can send, 0 for no limit; nothing where none has one."""
    receive: tuple[int, ...] = ()
    """Bytes a step that each robot can take, likewise."""
    changes: tuple[Change, ...] = ()
    """When budget and range become others, as the scenario has it."""

    @property
    def maps(self) -> int:
        """How many maps can be spoken of."""
        return self.robots * self.incarnations

    @property
    def perfect(self) -> bool:
        """Whether what is put on the air is heard at once by all in range, and one budget is all there is."""
        return self.options.perfect and not any(self.send) and not any(self.receive)

    @property
    def packet_bytes(self) -> int | None:
        """Bytes that a packet may have for a frame to hold it; None: any number."""
        tail = packets.Check.size if self.options.sums else 0
        return self.options.frame_bytes - tail if self.options.frame_bytes else None


class Frame(NamedTuple):
    """A payload to hand to all `receivers` as heard from `sender`."""

    receivers: Sequence[int]
    sender: int
    payload: bytes


class Note(NamedTuple):
    """What a robot is told, and before it the frames that it hears, each as from its sender."""

    receiver: int
    message: MediumNote
    senders: Sequence[int] = ()
    frames: Sequence[bytes] = ()


Outgoing = Frame | Note | Medium
"""What is to be passed on, in this order: at the end of a step its medium, whose report the laboratory gets."""


class Radio:
    """The radio of one run; feed it positions and what robots say, pass on what it returns."""

    def __init__(self, settings: RadioSettings) -> None:
        self.settings = settings
        self.faults: list[tuple[int, str]] = []
        """Who said what that made no sense, since this list was last emptied."""
        self.changed: list[Change] = []
        """What has changed with this step, since this list was last emptied."""
        self._changes = sorted(settings.changes, key=_WHEN)
        """What is still to change."""
        self._dead: set[int] = set()
        self._step = 0
        self._round = 0
        self._phase = ""
        self._reach: dict[int, list[int]] = {}
        self._mute: set[int] = set()
        self._deaf: set[int] = set()
        self._medium = self._new_medium(0, 0)
        self._shares = airtime.Shares(settings.budget)
        self._waiting: set[int] = set()
        self._asked: list[int] = []
        """Whom the phase under way concerns."""
        self._spoken: dict[int, Said] = {}
        """What they have said in it."""
        self._beforehand: dict[int, Beforehand] = {}
        """What they have said of what they are going to say in this exchange."""
        self._opened_with = UNLIMITED
        """What was left of the budget when the exchange was opened."""
        self._connections = Connections()
        self._broadcast_carried: dict[int, bool] = {}

    def begin(
        self,
        step: int,
        cells: Mapping[int, tuple[int, int]],
        mute: Sequence[int] = (),
        deaf: Sequence[int] = (),
    ) -> list[Outgoing]:
        """Open the medium for a step, with the true cell (x, y) of each living robot.

        Radios of `mute` robots cannot send in it, those of `deaf` robots cannot hear.
        What was said while it was closed is booked here, and refused. For a robot alone it is closed at once.
        """
        self._step = step
        while self._changes and self._changes[0].step <= step:
            self._apply(msgspec.structs.replace(self._changes.pop(0), step=step))
        self._round = 0
        self._mute, self._deaf = set(mute), set(deaf)
        self._connections = Connections()
        living = {robot: cell for robot, cell in cells.items() if robot not in self._dead}
        self._reach = self._who_hears_whom(living)
        between = self._medium
        self._medium = self._new_medium(step, self.settings.budget)
        self._medium.predictiveings = between.predictiveings
        self._next_step()
        return self._open() if self.settings.robots > 1 else self._close()

    def change(self, change: Change) -> None:
        """Have budget or range be others from a step on that has not begun."""
        coming = msgspec.structs.replace(change, step=max(change.step, self._step + 1))
        self._changes = sorted([*self._changes, coming], key=_WHEN)

    def _apply(self, change: Change) -> None:
        self.changed.append(change)
        if change.budget >= UNLIMITED:
            self._set_budget(change.budget)
        if change.range_mm >= 0:
            cells = change.range_mm / 1000 / self.settings.cell_m
            self.settings = replace(self.settings, range_cells=cells)

    def _set_budget(self, budget: int) -> None:
        self.settings = replace(self.settings, budget=budget)
        self._shares.budget = budget

    def said(self, sender: int, said: Said) -> list[Outgoing]:
        """Take all that a robot has to say in this phase."""
        if sender in self._dead:
            return []
        if sender not in self._waiting or said.phase != self._phase:
            self.faults.append((sender, f"spoke in phase {said.phase!r} of step {said.step} out of turn"))
            for receiver, payload in said.puts():
                self._refuse(sender, receiver, DATA, payload, "protocol", "spoke out of turn")
            return []
        self._spoken[sender] = said
        self._waiting.discard(sender)
        return self._advance()

    def lost(self, robot: int) -> list[Outgoing]:
        """A robot is dead: nobody waits for it any more."""
        self._dead.add(robot)
        self._waiting.discard(robot)
        return self._advance() if self._phase else []

    def back(self, robot: int) -> None:
        """A robot that was lost is here again; it takes part from the next step on."""
        self._dead.discard(robot)

    @property
    def phase(self) -> tuple[int, int, str]:
        """Step, exchange and phase under way."""
        return self._step, self._round, self._phase

    def waiting_for(self) -> list[int]:
        """Robots which have not spoken in this phase yet."""
        return sorted(self._waiting)

    def _new_medium(self, step: int, budget: int) -> Medium:
        return Medium(step, budget, self.settings.options.frame_bytes)

    def _who_hears_whom(self, cells: Mapping[int, tuple[int, int]]) -> dict[int, list[int]]:
        """For each robot those in its range, by the model of the radio and the partitions of this step."""
        settings, options = self.settings, self.settings.options
        robots, places = sorted(cells), connectivity.places_of(cells)
        if options.model == "disc" or settings.walls is None:
            hears = connectivity.disc(places, settings.range_cells)
        elif options.model == "line-of-sight":
            hears = connectivity.line_of_predictive(places, settings.range_cells, settings.walls)
        else:
            extra = connectivity.shadowing(
                places, settings.cell_m, settings.seed, options.shadowing_db, options.shadowing_m
            )
            hears = connectivity.log_distance(
                places, settings.range_cells, settings.walls, settings.cell_m,
                exponent=options.exponent, db_per_metre=options.db_per_metre, db_per_wall=options.db_per_wall,
                extra_db=extra,
            )  # fmt: skip
        if options.partition:
            hears = hears & connectivity.parted(robots, options.partition, self._step)
        return connectivity.named(robots, hears)

    def _next_step(self) -> None:
        """Make what is kept over steps ready for the next one."""
        self._shares.next_step()

    def _room(self, _robot: int) -> int:
        """What a robot may still put on the air, as it is told."""
        return self._medium.left

    def _too_long(self, payload: bytes) -> str:
        """Say which packet of a frame of whole packets no frame on the air has room for; nothing if none."""
        most = self.settings.options.frame_bytes
        size = packet_index.longest(payload) if most else 0
        return f"a packet of {size} bytes, where a frame holds {most}" if size > most else ""

    def _advance(self) -> list[Outgoing]:
        out: list[Outgoing] = []
        while self._phase and not self._waiting:
            out += {"offers": self._end_offers, "answers": self._end_answers, "data": self._end_data}[
                self._phase
            ]()
        return out

    def _expect(self, phase: str, robots: Sequence[int]) -> None:
        self._phase = phase
        self._asked = [robot for robot in robots if robot not in self._dead]
        self._waiting = set(self._asked)
        self._spoken = {}

    def _open(self) -> list[Outgoing]:
        self._connections = Connections(self._connections.first + len(self._connections))
        self._broadcast_carried = {}
        self._beforehand = {}
        self._opened_with = self._medium.left
        living = sorted(set(self._reach) - self._dead)
        self._expect("offers", living)
        if not living:
            return self._advance()
        return [
            Note(
                robot,
                Open(
                    self._step,
                    self._round,
                    self._heard_by(robot),
                    self._room(robot),
                ),
            )
            for robot in living
        ]

    def _heard_by(self, robot: int) -> list[int]:
        """Teammates in range of which a robot can notice that they are."""
        if robot in self._deaf:
            return []
        return [peer for peer in self._reach[robot] if peer not in self._dead and peer not in self._mute]

    def _hearers(self, sender: int) -> list[int]:
        """Who hears what a robot broadcasts."""
        return [peer for peer in self._reach[sender] if peer not in self._dead and peer not in self._deaf]

    def _end_offers(self) -> list[Outgoing]:
        broadcasts: list[tuple[int, bytes]] = []
        offers: dict[tuple[int, int, int], bytes] = {}
        for sender, said in sorted(self._spoken.items()):
            reach = set(self._reach.get(sender, ()))
            offered: dict[tuple[int, int], int] = {}
            self._beforehand[sender] = Beforehand(said.replies, offered)
            count = -1
            for receiver, payload in said.puts():
                if receiver == EVERYONE:
                    broadcasts.append((sender, payload))
                    continue
                count += 1
                if receiver not in reach or sender in self._mute:
                    cause = "range" if receiver not in reach else "mute"
                    self._refuse(sender, receiver, OFFER, payload, cause, "")
                    continue
                map_id, problem = read_offer(payload, self.settings.maps)
                if not problem and (sender, receiver, map_id) in offers:
                    problem = f"map {map_id} was offered to robot {receiver} twice in an exchange"
                if problem:
                    self._refuse(sender, receiver, OFFER, payload, "protocol", problem)
                else:
                    offers[sender, receiver, map_id] = payload
                    offered[receiver, map_id] = count
        out = self._put_broadcasts_on_air(broadcasts)
        ends = self._drawn("contention", sorted(offers))
        self._connections.add(ends, [offers[each] for each in ends])
        return out + self._pass_on(OFFER, "answers")

    def _priority(self, sender: int) -> int:
        return self._spoken[sender].priority

    def _put_broadcasts_on_air(self, said: list[tuple[int, bytes]], share: int = UNLIMITED) -> list[Outgoing]:
        """Put targets and poses, of (sender, payload), on the air; behind the first no more bytes than `share`."""
        out: list[Outgoing] = []
        for sender, payload in self._drawn("targets", said):
            if not is_broadcast(payload) or self._round or sender in self._broadcast_carried:
                reason = "broadcast something other than a target or a pose, at the start of a step"
                self._refuse(sender, EVERYONE, BROADCAST, payload, "protocol", reason)
                continue
            if sender in self._mute:
                self._refuse(sender, EVERYONE, BROADCAST, payload, "mute", "")
                continue
            hearers = self._hearers(sender)
            if self._waits(payload, share):
                self._medium.leave_out(self._round, sender, payload)
                self._broadcast_carried[sender] = False
                continue
            carried = self._medium.broadcast(self._round, sender, payload, hearers)
            self._broadcast_carried[sender] = carried
            if carried:
                out.append(Frame(hearers, sender, payload))
        return out

    def _fair_share(self) -> int:
        """Bytes of targets and poses in a step where news travel by gossip, as if these were one robot more."""
        return self._medium.left // (len(self._asked) + 1)

    def _waits(self, payload: bytes, share: int) -> bool:
        """Whether a broadcast is to leave the rest of the step to news."""
        carried = self._medium.carried
        return carried > 0 and carried + len(payload) > share >= 0

    def _drawn(self, purpose: str, items: list[Item]) -> list[Item]:
        """Put things into an order that is drawn for this exchange."""
        if len(items) < 2:
            return items
        draw = keyed_random(self.settings.seed, purpose, self._step, self._round)
        return [items[index] for index in draw.permutation(len(items)).tolist()]

    def _pass_on(self, frame: int, phase: str) -> list[Outgoing]:
        """Hand all frames of one kind to their receivers, in the seeded order, and give these the turn.

        For those who have said beforehand what they are going to say it is said at once.
        """
        heard: defaultdict[int, tuple[list[int], list[bytes], list[int], list[int]]]
        heard = defaultdict(lambda: ([], [], [], []))
        these = self._connections
        senders, receivers = these.senders, these.receivers
        if frame == ANSWER:
            senders, receivers = receivers, senders
        away = self._dead | self._deaf
        said = zip(senders, receivers, these.maps, these.frames[frame], strict=True)
        for number, (sender, receiver, map_id, payload) in enumerate(said, these.first):
            if payload is None:
                continue
            if receiver in away:
                these.lost[number - these.first] = frame
                continue
            whose, frames, numbers, maps = heard[receiver]
            whose.append(sender)
            frames.append(payload)
            numbers.append(number)
            maps.append(map_id)
        robots = sorted(heard)
        self._expect(phase, robots)
        out: list[Outgoing] = []
        for robot in robots:
            whose, frames, numbers, maps = heard[robot]
            turn = PhaseDelivery(self._step, self._round, PHASES[frame], numbers, maps)
            said_for = self._reply(robot, frame, turn, whose, frames)
            if said_for is not None:
                self._spoken[robot] = said_for
                self._waiting.discard(robot)
                turn = msgspec.structs.replace(turn, spoken=True)
            out.append(Note(robot, turn, whose, frames))
        return out

    def _reply(
        self, robot: int, frame: int, turn: PhaseDelivery, peers: Sequence[int], heard: Sequence[bytes]
    ) -> Said | None:
        """Say for a robot what it has said beforehand; None if it has to be asked."""
        beforehand = self._beforehand.get(robot)
        if beforehand is None:
            return None
        if frame == OFFER:
            return replies.answers(beforehand, turn, peers, heard)
        return replies.data(beforehand, turn, peers, heard, self._opened_with)

    def _end_answers(self) -> list[Outgoing]:
        self._collect(ANSWER, wrong_in_answer)
        return self._pass_on(ANSWER, "data")

    def _end_data(self) -> list[Outgoing]:
        self._collect(DATA, lambda payload: wrong_in_data(payload) or self._too_long(payload))
        these = self._connections
        for at, (receiver, payload) in enumerate(zip(these.receivers, these.frames[DATA], strict=True)):
            if payload is not None and receiver in self._dead:
                these.lost[at] = DATA
        offers, answers, data = self._medium.play(self._round, these).T.tolist()
        heard: defaultdict[int, tuple[list[int], list[bytes], list[int]]]
        heard = defaultdict(lambda: ([], [], []))
        concerned: defaultdict[int, list[int]] = defaultdict(list)
        concerned.update({robot: [] for robot in self._broadcast_carried})
        played = zip(these.senders, these.receivers, these.frames[DATA], data, strict=True)
        for at, (sender, receiver, payload, size) in enumerate(played):
            concerned[sender].append(at)
            concerned[receiver].append(at)
            if payload is not None and size:
                whose, frames, numbers = heard[receiver]
                whose.append(sender)
                frames.append(payload[:size])
                numbers.append(these.first + at)
        out: list[Outgoing] = []
        for robot in sorted(concerned.keys() - self._dead):
            mine = concerned[robot]
            whose, frames, numbers = heard[robot]
            outcome = Outcome(
                self._step,
                self._round,
                [these.first + at for at in mine],
                [offers[at] for at in mine],
                [answers[at] for at in mine],
                [data[at] for at in mine],
                numbers,
                self._broadcast_carried.get(robot, False),
            )
            out.append(Note(robot, outcome, whose, frames))
        self._round += 1
        if self._round < self.settings.rounds and self._medium.left:
            return out + self._open()
        return out + self._close()

    def _tell(self, robot: int, own: list[int], heard: int) -> Note:
        """Tell a robot how much of its frames was on the air, and how many it hears; none is of a connection."""
        nothing = [0] * len(own)
        outcome = Outcome(
            self._step, self._round, [-1] * len(own), nothing, nothing, own, [-1] * heard,
            self._broadcast_carried.get(robot, False),
        )  # fmt: skip
        return Note(robot, outcome)

    def _close(self) -> list[Outgoing]:
        self._phase = ""
        living = sorted(set(self._reach) - self._dead)
        out: list[Outgoing] = [Note(robot, Close(self._step)) for robot in living]
        out.append(self._medium)
        self._medium = self._new_medium(self._step, 0)
        return out

    def _collect(self, frame: int, valid: Callable[[bytes], str]) -> None:
        """Match the frames that were said to their connections; refuse those that do not belong."""
        these = self._connections
        senders, receivers = these.senders, these.receivers
        if frame == ANSWER:
            senders, receivers = receivers, senders
        asked, said = these.frames[frame - 1], these.frames[frame]
        count = len(these)
        for sender, words in sorted(self._spoken.items()):
            numbers = words.connections
            for index, (receiver, payload) in enumerate(words.puts()):
                at = numbers[index] - these.first if index < len(numbers) else -1
                if (
                    not 0 <= at < count
                    or (senders[at], receivers[at]) != (sender, receiver)
                    or said[at] is not None
                    or asked[at] is None
                ):
                    reason = "a frame of no connection of its own"
                    self._refuse(sender, receiver, frame, payload, "protocol", reason)
                elif problem := valid(payload):
                    self._refuse(sender, receiver, frame, payload, "protocol", problem)
                else:
                    said[at] = payload

    def _refuse(
        self, sender: int, receiver: int, frame: int, payload: bytes, cause: str, reason: str
    ) -> None:
        self._medium.refuse(self._round, frame, sender, receiver, payload, cause, reason)
        if reason:
            self.faults.append((sender, reason))
