"""Sessions of robots without the robots, to measure the cost of the session itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

from agent.exchange.outcome import Outcome
from agent.exchange.session import Session
from deploy.scenario.plan import Plan
from netshaper.radio import Outgoing, Radio, ToRobot
from protocol import packet_index
from protocol.messages import (
    MediumEvent,
    Open,
    OutgoingFrame,
    PhaseDelivery,
    RobotFrames,
    RoundReport,
)

Result = TypeVar("Result")


def timed(work: Callable[[], Result]) -> tuple[Result, float]:
    """Call a function; return its result, and the processor time in milliseconds."""
    began = time.thread_time_ns()
    result = work()
    return result, (time.thread_time_ns() - began) / 1e6


class Handshakes:
    """Sessions of robots within range of each other, and the relay between them.

    Attributes
    ----------
    sessions : list of Session
        One per robot.
    in_sessions, in_relay : list of float
        Milliseconds of each step's work.
    """

    def __init__(self, plan: Plan) -> None:
        robots = plan.scenario.robots
        self.sessions = [Session(robot, robots, plan.scenario.dissemination) for robot in range(robots)]
        self.in_sessions: list[float] = []
        self.in_relay: list[float] = []
        self._radio = Radio(plan.radio)
        self._cells = dict(enumerate(plan.world.starts))

    def play(self, step: int) -> None:
        """Play one step of the radio."""
        out, in_relay = timed(lambda: self._radio.begin(step, self._cells))
        in_sessions = 0.0
        while out:
            sent: list[tuple[int, RobotFrames]] = []
            for item in out:
                if isinstance(item, ToRobot):
                    frames, spent = timed(partial(_respond, self.sessions[item.robot], item.event))
                    in_sessions += spent
                    if frames is not None:
                        sent.append((item.robot, frames))
            out, spent = timed(partial(self._submit, sent))
            in_relay += spent
        self.in_sessions.append(in_sessions)
        self.in_relay.append(in_relay)

    def _submit(self, sent: Sequence[tuple[int, RobotFrames]]) -> list[Outgoing]:
        return [item for sender, frames in sent for item in self._radio.submit(sender, frames)]


def _respond(session: Session, event: MediumEvent) -> RobotFrames | None:
    """Return the frames that a session sends after an event of the relay."""
    match event:
        case Open():
            offers = session.offers(event.round, event.peers, event.budget.limit)
            frames = [OutgoingFrame(peer, frame) for peer, _, frame in offers]
            return RobotFrames(event.step, event.round, "offers", b"", frames, 0, session.replies())
        case PhaseDelivery(phase="offers"):
            arrived = [(each.connection, each.sender, each.payload) for each in event.deliveries]
            sent, phase = session.answers(arrived), "answers"
        case PhaseDelivery():
            answers = [(each.connection, each.sender, each.map_id, each.payload) for each in event.deliveries]
            sent, phase = session.data(answers), "data"
        case RoundReport():
            data = [(each.sender, each.payload) for each in event.deliveries]
            for peer, map_id, frame in session.outcome(Outcome.of(event), data):
                session.accept(peer, map_id, frame, packet_index.ends(frame))
            return None
        case _:
            session.forget()
            return None
    if event.answered_by_relay:
        return None
    frames = [OutgoingFrame(peer, frame, number) for number, peer, frame in sent]
    return RobotFrames(event.step, event.round, phase, frames=frames)
