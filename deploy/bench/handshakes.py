"""Replication engines without robots, to measure the cost of replication itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

from agent.radio_events import continue_round, open_round
from agent.replication.engine import Replication
from agent.replication.map_ids import MapId
from deploy.scenario.plan import Plan
from netshaper.radio import Outgoing, Radio, ToRobot
from protocol import packet_index
from protocol.errors import ProtocolError
from protocol.messages import (
    MediumEvent,
    Open,
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
    """Replication engines of robots within range of each other, and the relay between them.

    Attributes
    ----------
    engines : list of Replication
        One per robot.
    in_engines, in_relay : list of float
        Milliseconds of each step's work.
    """

    def __init__(self, plan: Plan) -> None:
        robots = plan.scenario.robots
        policy = plan.scenario.dissemination
        self.engines = [Replication(robot, robots, _ends, policy) for robot in range(robots)]
        self.in_engines: list[float] = []
        self.in_relay: list[float] = []
        self._radio = Radio(plan.radio)
        self._cells = dict(enumerate(plan.world.starts))

    def play(self, step: int) -> None:
        """Play one step of the radio."""
        out, in_relay = timed(lambda: self._radio.begin(step, self._cells))
        in_engines = 0.0
        while out:
            sent: list[tuple[int, RobotFrames]] = []
            for item in out:
                if isinstance(item, ToRobot):
                    frames, spent = timed(partial(_respond, self.engines[item.robot], item.event))
                    in_engines += spent
                    if frames is not None:
                        sent.append((item.robot, frames))
            out, spent = timed(partial(self._submit, sent))
            in_relay += spent
        self.in_engines.append(in_engines)
        self.in_relay.append(in_relay)

    def _submit(self, sent: Sequence[tuple[int, RobotFrames]]) -> list[Outgoing]:
        return [item for sender, frames in sent for item in self._radio.submit(sender, frames)]


def _respond(replication: Replication, event: MediumEvent) -> RobotFrames | None:
    """Return the frames that an engine sends after an event of the relay."""
    match event:
        case Open():
            return open_round(replication, event)
        case PhaseDelivery():
            return continue_round(replication, event, _fail)
        case RoundReport():
            replication.close_round(event)
        case _:
            replication.truncate()
    return None


def _fail(reason: str) -> None:
    raise ProtocolError("conn", 0, reason)


def _ends(_peer: int, _map: MapId, frame: bytes) -> Sequence[int]:
    """Return where each entry of a frame ends, without decoding any."""
    return packet_index.ends(frame)
