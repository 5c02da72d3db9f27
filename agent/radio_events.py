"""Radio events: a robot's response to each event that the relay reports (docs/architecture.md, A step)."""

from __future__ import annotations

from collections.abc import Callable

from agent.exchange.outcome import Outcome
from agent.robot import Robot
from protocol.errors import ProtocolError
from protocol.messages import (
    Broadcasts,
    Close,
    MediumEvent,
    Open,
    OutgoingFrame,
    PhaseDelivery,
    RobotFrames,
    RoundReport,
)


def respond(robot: Robot, event: MediumEvent, report_error: Callable[[str], None]) -> RobotFrames | None:
    """Let a robot take an event; return the frames that it sends then, None if it is not its turn.

    Errors of teammates that belong to no map are passed to `report_error`.
    """
    match event:
        case Open():
            return _open(robot, event)
        case Broadcasts():
            for delivery in event.deliveries:
                robot.hear_broadcast(delivery.sender, delivery.payload)
        case PhaseDelivery():
            frames = _reply(robot, event, report_error)
            if not event.answered_by_relay:
                phase = "answers" if event.phase == "offers" else "data"
                return RobotFrames(event.step, event.round, phase, frames=frames)
        case RoundReport():
            received = [(delivery.sender, delivery.payload) for delivery in event.deliveries]
            robot.settle(Outcome.of(event), received)
        case Close():
            pass
    return None


def _open(robot: Robot, event: Open) -> RobotFrames:
    """Send pose, target and offers at the beginning of a round."""
    broadcast = robot.announce(event.peers) if event.round == 0 else None
    offers = robot.session.offers(event.round, event.peers, event.budget.limit)
    return RobotFrames(
        event.step,
        event.round,
        "offers",
        broadcast if broadcast is not None and event.peers else b"",
        [OutgoingFrame(peer, frame) for peer, _, frame in offers],
        robot.session.priority,
        robot.session.replies(),
    )


def _reply(robot: Robot, event: PhaseDelivery, report_error: Callable[[str], None]) -> list[OutgoingFrame]:
    """Answer the offers, or send data after the answers, that arrived in a phase."""
    arrived = event.deliveries
    try:
        if event.phase == "offers":
            replies = robot.session.answers([(d.connection, d.sender, d.payload) for d in arrived])
        else:
            replies = robot.session.data([(d.connection, d.sender, d.map_id, d.payload) for d in arrived])
    except ProtocolError as error:
        report_error(str(error))
        return []
    return [OutgoingFrame(peer, frame, number) for number, peer, frame in replies]
