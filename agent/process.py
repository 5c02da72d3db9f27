"""A robot's shell: it turns bus messages into calls of `Robot`, and its answers into messages."""

from __future__ import annotations

import time

from agent.exchange.gossip import EVERYONE
from agent.identity import Identity
from agent.journal import Journal
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
    Bye,
    Close,
    Configure,
    End,
    Fault,
    Maps,
    MindReport,
    Open,
    Outcome,
    Record,
    Said,
    Sense,
    Strike,
    Turn,
    Watched,
    pack,
)

UNLIMITED = -1


class AgentNode:
    """One robot's process; `done` once it has been told to shut down, or has been `killed`.

    A robot that may begin more than once needs a journal (`agent.identity`).
    """

    def __init__(self, bus: Bus, keys: Keys, number: int, journal: Journal | None = None) -> None:
        self.done = False
        self.killed = False
        """Whether it is to end at once, without another word."""
        self._identity = Identity(journal) if journal is not None else None
        self._bus = bus
        self._keys = keys
        self._number = number
        self._name = names.robot(number)
        self.robot: Robot | None = None
        self._speaks_at: dict[str, int] = {}
        """Who speaks under each key of the radio that has been heard."""
        self._frames: list[tuple[int, bytes]] = []
        self._early: Message | None = None
        self._viewer_feed: ViewerFeed | None = None
        self._step = 0
        self._work = 0.0

    def handle(self, message: Message) -> None:
        """Take one message from the bus."""
        if self.killed:
            return
        key, payload = message
        sender = self._speaks_at.get(key)
        if sender is None and names.parts(key)[0] == "radio":
            sender = self._speaks_at[key] = names.number(names.parts(key)[3])
        if sender is not None:
            self._frames.append((sender, payload))
            return
        try:
            self._take(rights.read(key, payload), message)
        except ProtocolError as error:
            self._fault(str(error))

    def _take(self, said: object, message: Message) -> None:
        """Take what relay or world says."""
        if isinstance(said, Configure):
            self._begin(Settings.from_message(said.settings))
        elif isinstance(said, Strike):
            self.killed = self.done = True
        elif isinstance(said, Watched):
            self._viewer_feed = ViewerFeed() if said.here else None
        elif isinstance(said, End):
            self._show(said.step)
            self._hand_in_maps()
        elif isinstance(said, Bye):
            self.done = True
        elif self.robot is not None:
            self._act(self.robot, said, message)

    def _begin(self, settings: Settings) -> None:
        """Begin a life; if there was one before, all of it but the journal is gone."""
        if self._identity is not None:
            settings = self._identity.begin(settings)
        self.robot = Robot(settings)
        self._frames.clear()
        self._early = None
        self._step = 0

    def _act(self, robot: Robot, said: object, message: Message) -> None:
        began = time.perf_counter()
        if isinstance(said, Sense):
            self._step = said.step
            self._work = 0.0
            if self._identity is not None:
                self._identity.settle(said.x, said.y)
            robot.perceive(said)
        elif isinstance(said, Open) and said.step > self._step:
            self._early = message  # the world's message has not arrived yet
            return
        elif isinstance(said, Open):
            self._offer(robot, said)
        elif isinstance(said, Turn):
            self._take_turn(robot, said)
        elif isinstance(said, Outcome):
            robot.settle(said, self._take_frames(robot, len(said.heard)))
        elif isinstance(said, Close):
            self._decide(robot, began)
        self._work += time.perf_counter() - began
        if isinstance(said, Sense) and self._early is not None:
            early, self._early = self._early, None
            self.handle(early)

    def _offer(self, robot: Robot, medium: Open) -> None:
        said = robot.announce(medium.peers) if medium.exchange == 0 else None
        room = None if medium.budget == UNLIMITED else medium.budget
        offers = robot.session.offers(medium.exchange, medium.peers, room)
        frames = [(names.ALL if peer == EVERYONE else names.robot(peer), frame) for peer, _, frame in offers]
        if said is not None and medium.peers:
            frames.insert(0, (names.ALL, said))
        self._say(frames, Said(medium.step, medium.exchange, "offers", [], robot.session.urgency))

    def _take_turn(self, robot: Robot, turn: Turn) -> None:
        """Answer the offers, or send data for the answers, that were delivered in this phase."""
        frames = self._take_frames(robot, len(turn.connections))
        phase = "answers" if turn.phase == "offers" else "data"
        said: list[tuple[int, int, bytes]] = []
        try:
            if turn.phase == "offers":
                offers = [(n, *frame) for n, frame in zip(turn.connections, frames, strict=True)]
                said = robot.session.answers(offers)
            else:
                named = zip(turn.connections, frames, turn.maps, strict=True)
                said = robot.session.data([(n, peer, about, load) for n, (peer, load), about in named])
        except ProtocolError as error:
            self._fault(str(error))
        puts = [(names.robot(peer), frame) for _, peer, frame in said]
        self._say(puts, Said(turn.step, turn.exchange, phase, [number for number, _, _ in said]))

    def _decide(self, robot: Robot, began: float) -> None:
        self._take_frames(robot, 0)
        move = robot.decide()
        for fault in robot.faults:
            self._fault(f"heard nonsense from {names.robot(fault.peer)}: {fault.reason}")
        robot.faults.clear()
        work = round(1e6 * (self._work + time.perf_counter() - began))
        x, y = robot.target or (-1, -1)
        backlog = robot.session.undelivered()
        exact = robot.exact_error()
        errors = robot.error(), -1 if exact is None else exact
        report = MindReport(self._step, x, y, robot.known_cells, *errors, backlog, robot.status, work)
        self._report(report)
        self._bus.put(self._keys.body(names.WORLD, self._name), pack(move))
        if self._step % SHOWN_EVERY == 0:
            self._show(self._step)

    def _take_frames(self, robot: Robot, count: int) -> list[tuple[int, bytes]]:
        """The last `count` frames received; those before them are the broadcasts of the beginning of a step."""
        split = len(self._frames) - count
        broadcasts, frames = self._frames[:split], self._frames[split:]
        self._frames = []
        for peer, payload in broadcasts:
            robot.hear_broadcast(peer, payload)
        return frames

    def _hand_in_maps(self) -> None:
        if self.robot is not None:
            height, width = self.robot.own.shape
            own, planning = self.robot.own.tobytes(), self.robot.planning.tobytes()
            maps = Maps(self._number, width, height, own, planning)
            self._bus.put(self._keys.control(names.LAB, self._name), pack(maps))

    def _say(self, frames: list[tuple[str, bytes]], said: Said) -> None:
        """Send all messages of a phase in one batch, so that the relay is woken rarely."""
        puts = [(self._keys.radio_tx(self._name, receiver), frame) for receiver, frame in frames]
        puts.append((self._keys.control_tx(self._name), pack(said)))
        for key, payload in puts:
            self._bus.put(key, payload)

    def _fault(self, what: str) -> None:
        self._report(Fault(self._name, clip(what)))

    def _report(self, message: Record) -> None:
        """Tell the laboratory, and the viewer if there is one."""
        payload = pack(message)
        self._bus.put(self._keys.control(names.LAB, self._name), payload)
        if self._viewer_feed is not None:
            self._bus.put(self._keys.control(names.VIEW, self._name), payload)

    def _show(self, step: int) -> None:
        """Send the viewer, if there is one, the changes of the robot's maps."""
        if self._viewer_feed is not None and self.robot is not None:
            for news in self._viewer_feed.news(step, self.robot):
                self._bus.put(self._keys.control(names.VIEW, self._name), pack(news))
