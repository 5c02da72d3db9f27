"""A robot's shell: it turns bus messages into calls of `Robot`, and its answers into messages."""

from __future__ import annotations

import time
from typing import Any

from agent.identity import Identity
from agent.journal import Journal
from agent.radio_events import respond
from agent.robot import Robot
from agent.settings import Settings
from agent.viewer_feed import SHOWN_EVERY, RecorderFeed, ViewerFeed
from protocol import keys as names
from protocol import rights
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.fields import clip
from protocol.keys import Keys
from protocol.messages import (
    Close,
    Configure,
    End,
    Fault,
    FaultEvent,
    Maps,
    MediumEvent,
    Record,
    RelayUpdate,
    RobotStatus,
    Sense,
    Shutdown,
    Watched,
    pack,
)


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
        self._early: list[MediumEvent] = []
        """Events of a step for which the world's message has not arrived yet."""
        self._viewer_feed: ViewerFeed | None = None
        self._recorder_feed: RecorderFeed | None = None
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
        elif isinstance(said, RelayUpdate):
            self._take_events(self.robot, said.events)
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
        self._recorder_feed = RecorderFeed(settings) if settings.record_maps else None
        if self._common is not None:
            self.robot.share(self._common)
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
        self._take_events(robot, early)

    def _take_events(self, robot: Robot, events: list[MediumEvent]) -> None:
        """Take events of the medium in their order."""
        for event in events:
            began = time.perf_counter()
            if event.step > self._step:
                self._early.append(event)
            elif isinstance(event, Close):
                self._decide(robot, began)
            else:
                frames = respond(robot, event, self._fault)
                if frames is not None:
                    self._bus.put(self._to_air, pack(frames))
            self._work += time.perf_counter() - began

    def _decide(self, robot: Robot, began: float) -> None:
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

    def _hand_in_maps(self) -> None:
        if self.robot is not None:
            height, width = self.robot.own.shape
            own, planning = self.robot.own.tobytes(), self.robot.planning.tobytes()
            maps = Maps(self._number, width, height, own, planning)
            self._bus.put(self._to_lab, pack(maps))

    def _fault(self, what: str) -> None:
        self._report(Fault(self._name, clip(what)))

    def _report(self, message: Record) -> None:
        """Tell the laboratory, and the viewer if there is one."""
        payload = pack(message)
        self._bus.put(self._to_lab, payload)
        if self._viewer_feed is not None:
            self._bus.put(self._to_viewer, payload)

    def _show(self, step: int) -> None:
        """Send changes of this robot's maps to the recorder, if it stores them, and to a viewer, if there is one."""
        if self.robot is None:
            return
        if self._recorder_feed is not None:
            for report in self._recorder_feed.changes(step, self.robot):
                self._bus.put(self._to_lab, pack(report))
        if self._viewer_feed is not None:
            for news in self._viewer_feed.news(step, self.robot):
                self._bus.put(self._to_viewer, pack(news))
