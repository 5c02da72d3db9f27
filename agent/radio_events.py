"""Radio events: a robot's response to each event that the relay reports (docs/architecture.md, A step)."""

from __future__ import annotations

from collections.abc import Callable

from agent.replication.base import Replication
from agent.robot import Robot
from protocol.errors import ProtocolError
from protocol.messages import (
    Broadcasts,
    MediumEvent,
    Open,
    OutgoingFrame,
    PhaseDelivery,
    RobotFrames,
    RoundReport,
)

ReportError = Callable[[str], None]
"""Callback for protocol errors of teammates that belong to no map."""


def respond(robot: Robot, event: MediumEvent, report_error: ReportError) -> RobotFrames | None:
    """Pass an event to a robot; return the frames that it sends in response, None if the relay expects none."""
    if isinstance(event, Open):
        # Without teammates in range, too: the robot notes whom it has lost.
        broadcast = (event.round == 0 and robot.announce(event.peers)) or b""
        return open_round(robot.replication, event, broadcast if event.peers else b"")
    if isinstance(event, PhaseDelivery):
        return continue_round(robot.replication, event, report_error)
    if isinstance(event, Broadcasts):
        for delivery in event.deliveries:
            robot.receive_broadcast(delivery.sender, delivery.payload)
    elif isinstance(event, RoundReport):
        robot.close_round(event)
    return None


def open_round(replication: Replication, event: Open, broadcast: bytes = b"") -> RobotFrames:
    """Return the frames of a robot at the beginning of a round; `broadcast` is its pose and target."""
    frames = replication.open_round(event.round, event.peers, event.budget.limit)
    return RobotFrames(event.step, event.round, "offers", broadcast, frames, replication.priority)


def continue_round(replication: Replication, event: PhaseDelivery, report_error: ReportError) -> RobotFrames:
    """Return the answers to offers, or the data after answers."""
    answers = event.phase == "offers"
    frames: list[OutgoingFrame] = []
    try:
        frames = (replication.answer if answers else replication.send_data)(event.deliveries)
    except ProtocolError as error:
        report_error(str(error))
    return RobotFrames(event.step, event.round, "answers" if answers else "data", frames=frames)
