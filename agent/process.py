"""The agent process: it turns bus messages into calls of `Robot`, and the results into messages."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from agent.identity import Identity
from agent.journal import Journal
from agent.radio_events import respond
from agent.robot import Robot
from agent.settings import Settings
from agent.strategies.base import Situation
from agent.viewer_feed import SHOWN_EVERY, RecorderFeed, ViewerFeed
from protocol import keys as names
from protocol import map_parts, rights
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.keys import Keys
from protocol.map_parts import FinalMaps
from protocol.message_codec import pack
from protocol.message_fields import clip
from protocol.messages import (
    Close,
    Configure,
    ErrorReport,
    FaultEvent,
    MapPart,
    MediumEvent,
    Reconnected,
    Record,
    RelayUpdate,
    RequestMaps,
    RobotStatus,
    Sense,
    Shutdown,
    Watched,
)


class AgentNode:
    """One robot's process; `done` once it has received `Shutdown` or a fault has `killed` it.

    A robot that may restart needs a journal (`agent.identity`). Robots in one process share the memory `common`
    (`Robot.share`). After its connection was cut and restored, it calls `resend` to send its last messages again. A
    robot that is `held` waits at the end of each step until its owner calls `decide`.
    """

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        number: int,
        journal: Journal | None = None,
        common: dict[str, Any] | None = None,
        resend: Callable[[], object] = lambda: None,
        *,
        held: bool = False,
    ) -> None:
        self.done = False
        self.killed = False
        """Whether the process must end at once, without sending another message."""
        self._identity = Identity(journal) if journal is not None else None
        self._common = common
        self._resend = resend
        self._bus = bus
        self._name = names.robot(number)
        self._keys = keys
        self._held = held
        self.robot: Robot | None = None
        self.situation: Situation | None = None
        """The situation of a robot that waits for `decide`; None if it does not wait."""
        self._unconfigured: list[object] = []
        """Messages that arrived before this robot's settings."""
        self._early: list[MediumEvent] = []
        """Events of a step for which the world's message has not arrived yet."""
        self._viewer_feed: ViewerFeed | None = None
        self._recorder_feed: RecorderFeed | None = None
        self._final_maps = np.zeros(0, np.uint8)
        """All maps at the end, once the recorder has requested them (`protocol.map_parts`)."""
        self._step = 0
        self._work = 0.0

    def handle(self, message: Message) -> None:
        """Take one message from the bus."""
        if self.killed:
            return
        try:
            self._take(rights.read(*message))
        except ProtocolError as error:
            self._report_error(str(error))

    def _take(self, message: object) -> None:
        """Take a decoded message of relay or world."""
        if self.robot is not None and isinstance(message, RelayUpdate):
            self._take_events(self.robot, message.events)
        elif self.robot is not None and isinstance(message, Sense):
            self._sense(self.robot, message)
        elif isinstance(message, Configure):
            self._begin(Settings.decode(message.settings))
            waiting, self._unconfigured = self._unconfigured, []
            for earlier in waiting:
                self._take(earlier)
        elif isinstance(message, Shutdown):
            self.done = True
        elif isinstance(message, FaultEvent):
            self.killed = self.done = True
        elif isinstance(message, Reconnected):
            self._resend()
        elif isinstance(message, Watched):
            self._viewer_feed = ViewerFeed() if message.here else None
        elif self.robot is None:
            self._unconfigured.append(message)
        elif isinstance(message, RequestMaps):
            self._send_maps(self.robot, message)

    def _begin(self, settings: Settings) -> None:
        """Begin an incarnation; of an earlier one, only the journal remains."""
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
        began = time.perf_counter()
        for event in events:
            if event.step > self._step:
                self._early.append(event)
            elif isinstance(event, Close):
                self.situation = robot.assess()
            else:
                frames = respond(robot, event, self._report_error)
                if frames is not None:
                    self._bus.put(self._keys.radio_tx(self._name), pack(frames))
        self._work += time.perf_counter() - began
        if self.situation is not None and not self._held:
            self.decide()

    def decide(self) -> None:
        """End a step: move, and report errors and status.

        Raises RuntimeError unless the robot has a `situation`.
        """
        robot, situation = self.robot, self.situation
        if robot is None or situation is None:
            raise RuntimeError("the robot does not wait for a decision")
        began = time.perf_counter()
        self.situation = None
        move = robot.decide(situation)
        work = round(1e6 * (self._work + time.perf_counter() - began))
        self._bus.put(self._keys.body(names.WORLD, self._name), pack(move))
        for error in robot.peer_errors:
            self._report_error(f"{error.kind} from {names.robot(error.peer)}: {error.reason}")
        robot.peer_errors.clear()
        x, y = robot.target or (-1, -1)
        backlog = robot.replication.undelivered()
        exact = robot.exact_error()
        errors = robot.error(), -1 if exact is None else exact
        report = RobotStatus(self._step, x, y, robot.known_cells, *errors, backlog, robot.status, work)
        self._report(report)
        if self._step % SHOWN_EVERY == 0:
            self._show(self._step)

    def _send_maps(self, robot: Robot, request: RequestMaps) -> None:
        """Send a part of the maps at the end of the run; before the first part, their last changes."""
        if not request.part:
            self._show(request.step)
            self._final_maps = map_parts.join(
                FinalMaps(robot.own, robot.planning, robot.shared, robot.settled)
            )
        part = MapPart(request.part, map_parts.encode(self._final_maps, request.part))
        self._put(names.RECORDER, pack(part))

    def _report_error(self, reason: str) -> None:
        self._report(ErrorReport(self._name, clip(reason)))

    def _report(self, message: Record) -> None:
        """Send a message to the recorder, and to the viewer if there is one."""
        payload = pack(message)
        self._put(names.RECORDER, payload)
        if self._viewer_feed is not None:
            self._put(names.VIEW, payload)

    def _put(self, receiver: str, payload: bytes) -> None:
        self._bus.put(self._keys.control(receiver, self._name), payload)

    def _show(self, step: int) -> None:
        """Send changes of this robot's maps to the recorder, if it stores them, and to a viewer, if there is one."""
        if self.robot is None:
            return
        if self._recorder_feed is not None:
            for report in self._recorder_feed.changes(step, self.robot):
                self._put(names.RECORDER, pack(report))
        if self._viewer_feed is not None:
            for message in self._viewer_feed.news(step, self.robot):
                self._put(names.VIEW, pack(message))
