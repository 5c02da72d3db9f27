"""Sessions of robots without the robots, to measure the cost of the session itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

from agent.exchange.session import Session
from deploy.scenario.plan import Plan
from netshaper.medium import UNLIMITED
from netshaper.radio import Frame, Note, Outgoing, Radio
from protocol import packet_index
from protocol.messages import Open, Outcome, PhaseDelivery, Said

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
        frames: list[list[tuple[int, bytes]]] = [[] for _ in self.sessions]
        out, in_relay = timed(lambda: self._radio.begin(step, self._cells))
        in_sessions = 0.0
        while out:
            said: list[tuple[int, Said]] = []
            for item in out:
                if isinstance(item, Frame):
                    for receiver in item.receivers:
                        frames[receiver].append((item.sender, item.payload))
                elif isinstance(item, Note):
                    frames[item.receiver] += zip(item.senders, item.frames, strict=True)
                    heard, frames[item.receiver] = frames[item.receiver], []
                    session = self.sessions[item.receiver]
                    answer, spent = timed(partial(_speak, session, item.message, heard))
                    in_sessions += spent
                    if answer is not None:
                        said.append((item.receiver, answer))
            out, spent = timed(partial(self._hear, said))
            in_relay += spent
        self.in_sessions.append(in_sessions)
        self.in_relay.append(in_relay)

    def _hear(self, said: Sequence[tuple[int, Said]]) -> list[Outgoing]:
        return [item for sender, words in said for item in self._radio.said(sender, words)]


def _speak(session: Session, note: object, heard: list[tuple[int, bytes]]) -> Said | None:
    """What a session sends in response to a notification of the relay and the frames before it."""
    match note:
        case Open():
            room = None if note.budget == UNLIMITED else note.budget
            offers = session.offers(note.round, note.peers, room)
            receivers, said = [peer for peer, _, _ in offers], [frame for _, _, frame in offers]
            return Said(note.step, note.round, "offers", [], 0, receivers, said, session.replies())
        case PhaseDelivery(phase="offers"):
            offered = [(n, *frame) for n, frame in zip(note.connections, heard, strict=True)]
            frames, phase = session.answers(offered), "answers"
        case PhaseDelivery():
            named = zip(note.connections, heard, note.maps, strict=True)
            answers = [(n, peer, map_id, load) for n, (peer, load), map_id in named]
            frames, phase = session.data(answers), "data"
        case Outcome():
            for peer, map_id, frame in session.outcome(note, heard):
                session.accept(peer, map_id, frame, packet_index.ends(frame))
            return None
        case _:
            session.forget()
            return None
    if note.spoken:
        return None
    numbers, receivers = [number for number, _, _ in frames], [peer for _, peer, _ in frames]
    return Said(note.step, note.round, phase, numbers, 0, receivers, [frame for _, _, frame in frames])
