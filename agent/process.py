"""A robot's shell: it turns bus messages into calls of `Robot`, and its answers into messages."""

from __future__ import annotations

import time
from typing import Any

from agent.identity import Identity
from agent.journal import Journal
from agent.replication.frames import (
    EVERYONE,
    ConnectionReport,
    Delivery,
    OutgoingFrame,
    RoundReport,
    SendReport,
)
from agent.robot import Robot
from agent.settings import Settings
from agent.viewer_feed import SHOWN_EVERY, ViewerFeed
from protocol import keys as names
from protocol import rights
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.fields import clip
from protocol.keys import Keys
from protocol.messages import (
    Configure,
    End,
    Fault,
    FaultEvent,
    Heard,
    Maps,
    MediumNote,
    Open,
    Outcome,
    PhaseDelivery,
    Record,
    RobotStatus,
    Said,
    Sense,
    Shutdown,
    Watched,
    pack,
)

UNLIMITED = -1


class AgentNode:
    """One robot's process; `done` once it has been told to shut down, or has been `killed`.

    A robot that may begin more than once needs a journal (`agent.identity`). Robots that run in one process are given
    the same `common` memory (`Robot.share`).
    """

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        number: int,
        journal: Journal | None = None,
        common: dict[str, Any] | None = None,
    ) -> None:
        self.done = False
        self.killed = False
        """Whether it is to end at once, without another word."""
        self._identity = Identity(journal) if journal is not None else None
        self._common = common
        self._bus = bus
        self._number = number
        self._name = names.robot(number)
        self._to_air = keys.radio_tx(self._name)
        self._to_world = keys.body(names.WORLD, self._name)
        self._to_lab = keys.control(names.RECORDER, self._name)
        self._to_viewer = keys.control(names.VIEW, self._name)
        self.robot: Robot | None = None
        self._unconfigured: list[object] = []
        """Messages that arrived before this robot's settings."""
        self._frames: list[tuple[int, bytes]] = []
        self._early: list[MediumNote] = []
        """What the relay says of a step of which the world's message has not arrived yet."""
        self._viewer_feed: ViewerFeed | None = None
        self._step = 0
        self._work = 0.0

    def handle(self, message: Message) -> None:
        """Take one message from the bus."""
        if self.killed:
            return
        try:
            self._take(rights.read(*message))
        except ProtocolError as error:
            self._fault(str(error))

    def _take(self, said: object) -> None:
        """Take what relay or world says."""
        if isinstance(said, Configure):
            self._begin(Settings.decode(said.settings))
            waiting, self._unconfigured = self._unconfigured, []
            for message in waiting:
                self._take(message)
        elif isinstance(said, Shutdown):
            self.done = True
        elif isinstance(said, FaultEvent):
            self.killed = self.done = True
        elif isinstance(said, Watched):
            self._viewer_feed = ViewerFeed() if said.here else None
        elif self.robot is None:
            self._unconfigured.append(said)
        elif isinstance(said, Heard):
            self._frames += zip(said.senders, said.frames, strict=True)
            self._heed(self.robot, said.notes)
        elif isinstance(said, Sense):
            self._sense(self.robot, said)
        elif isinstance(said, End):
            self._show(said.step)
            self._hand_in_maps()

    def _begin(self, settings: Settings) -> None:
        """Begin a life; if there was one before, all of it but the journal is gone."""
        if self._identity is not None:
            settings = self._identity.begin(settings)
        self.robot = Robot(settings)
        if self._common is not None:
            self.robot.share(self._common)
        self._frames.clear()
        self._early.clear()
        self._step = 0

    def _sense(self, robot: Robot, sense: Sense) -> None:
        """Begin a step."""
        began = time.perf_counter()
        self._step = sense.step
        if self._identity is not None:
            self._identity.settle(sense.x, sense.y)
        robot.perceive(sense)
        self._work = time.perf_counter() - began
        early, self._early = self._early, []
        self._heed(robot, early)

    def _heed(self, robot: Robot, notes: list[MediumNote]) -> None:
        """Do what the relay's notes say."""
        behind = sum(map(_frames_of, notes))
        for note in notes:
            began = time.perf_counter()
            behind -= _frames_of(note)
            if note.step > self._step:
                self._early.append(note)
            elif isinstance(note, Open):
                self._offer(robot, note)
            elif isinstance(note, PhaseDelivery):
                self._take_turn(robot, note, self._take_frames(robot, len(note.connections), behind))
            elif isinstance(note, Outcome):
                heard = self._take_frames(robot, len(note.heard), behind)
                robot.close_round(round_report(note, heard))
            else:
                self._decide(robot, began)
            self._work += time.perf_counter() - began

    def _offer(self, robot: Robot, medium: Open) -> None:
        said = robot.announce(medium.peers) if medium.round == 0 else None
        room = None if medium.budget == UNLIMITED else medium.budget
        offers = robot.replication.open_round(medium.round, medium.peers, room)
        receivers, frames = [each.receiver for each in offers], [each.payload for each in offers]
        if said is not None and medium.peers:
            receivers.insert(0, EVERYONE)
            frames.insert(0, said)
        words = Said(
            medium.step,
            medium.round,
            "offers",
            [],
            robot.replication.priority,
            receivers,
            frames,
            robot.replication.speculative(),
        )
        self._say(words)

    def _take_turn(self, robot: Robot, turn: PhaseDelivery, heard: list[tuple[int, bytes]]) -> None:
        """Answer the offers, or send data for the answers, that were delivered in this phase."""
        phase = "answers" if turn.phase == "offers" else "data"
        frames: list[OutgoingFrame] = []
        try:
            named = zip(heard, turn.connections, turn.maps, strict=True)
            arrived = [Delivery(*frame, number, map_id) for frame, number, map_id in named]
            react = robot.replication.answer if turn.phase == "offers" else robot.replication.send_data
            frames = react(arrived)
        except ProtocolError as error:
            self._fault(str(error))
        if turn.spoken:
            return
        numbers, receivers = [each.connection for each in frames], [each.receiver for each in frames]
        payloads = [each.payload for each in frames]
        self._say(Said(turn.step, turn.round, phase, numbers, 0, receivers, payloads))

    def _decide(self, robot: Robot, began: float) -> None:
        self._take_frames(robot, 0)
        move = robot.decide()
        work = round(1e6 * (self._work + time.perf_counter() - began))
        self._bus.put(self._to_world, pack(move))
        for fault in robot.faults:
            self._fault(f"heard nonsense from {names.robot(fault.peer)}: {fault.reason}")
        robot.faults.clear()
        x, y = robot.target or (-1, -1)
        backlog = robot.replication.undelivered()
        exact = robot.exact_error()
        errors = robot.error(), -1 if exact is None else exact
        report = RobotStatus(self._step, x, y, robot.known_cells, *errors, backlog, robot.status, work)
        self._report(report)
        if self._step % SHOWN_EVERY == 0:
            self._show(self._step)

    def _take_frames(self, robot: Robot, count: int, behind: int = 0) -> list[tuple[int, bytes]]:
        """Take `count` of the frames received, all but the last `behind` ones.

        Those before them are the broadcasts of the beginning of a step.
        """
        end = len(self._frames) - behind
        broadcasts, frames = self._frames[: end - count], self._frames[end - count : end]
        del self._frames[:end]
        for peer, payload in broadcasts:
            robot.receive_broadcast(peer, payload)
        return frames

    def _hand_in_maps(self) -> None:
        if self.robot is not None:
            height, width = self.robot.own.shape
            own, planning = self.robot.own.tobytes(), self.robot.planning.tobytes()
            maps = Maps(self._number, width, height, own, planning)
            self._bus.put(self._to_lab, pack(maps))

    def _say(self, said: Said) -> None:
        self._bus.put(self._to_air, pack(said))

    def _fault(self, what: str) -> None:
        self._report(Fault(self._name, clip(what)))

    def _report(self, message: Record) -> None:
        """Tell the laboratory, and the viewer if there is one."""
        payload = pack(message)
        self._bus.put(self._to_lab, payload)
        if self._viewer_feed is not None:
            self._bus.put(self._to_viewer, payload)

    def _show(self, step: int) -> None:
        """Send the viewer, if there is one, the changes of the robot's maps."""
        if self._viewer_feed is not None and self.robot is not None:
            for news in self._viewer_feed.news(step, self.robot):
                self._bus.put(self._to_viewer, pack(news))


def _frames_of(note: MediumNote) -> int:
    """How many of the frames that a robot hears with a note belong to it."""
    if isinstance(note, PhaseDelivery):
        return len(note.connections)
    return len(note.heard) if isinstance(note, Outcome) else 0


def round_report(note: Outcome, heard: list[tuple[int, bytes]]) -> RoundReport:
    """Return what the relay reports of a round."""
    carried = zip(note.connections, note.offers, note.answers, note.data, strict=True)
    deliveries = [Delivery(*frame, number) for number, frame in zip(note.heard, heard, strict=True)]
    connections = [ConnectionReport(*each) for each in carried]
    sent = [SendReport(*each) for each in enumerate(note.data)]
    return RoundReport(note.step, note.round, connections, sent, deliveries, note.broadcast)
