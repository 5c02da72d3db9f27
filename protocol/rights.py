"""Rights table: the messages that each participant may send to each other participant.

Every receiver decodes its messages with `read`. It rejects messages that the sender may not send, and payloads longer
than any message that the sender may send. The hub's access control (`netshaper.access`) uses the same table.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from protocol import keys as names
from protocol import messages as m
from protocol.keys import RECORDER, RELAY, VIEW, WORLD, Keys
from protocol.message_codec import unpacker
from protocol.message_fields import MAX_PAYLOAD, MAX_ROBOT_PAYLOAD

ROBOT = "robot"
"""Role of every robot in the table."""

_RELAY_REPORTS = (
    m.Lost, m.Back, m.Reconnected, m.End, m.Shutdown, m.RadioReport, m.ErrorReport, m.FaultEvent, m.Change, m.Missed,
)  # fmt: skip
_WORLD_REPORTS = m.WorldReport, m.FaultEvent, m.ErrorReport, m.Missed

RIGHTS: dict[tuple[str, str], tuple[type[m.Record], ...]] = {
    (RELAY, WORLD): (
        m.Begin, m.Close, m.Lost, m.Back, m.Reconnected, m.Stop, m.FaultEvent, m.Shutdown, m.Watched,
    ),
    (RELAY, ROBOT): (m.Configure, m.RelayUpdate, m.RequestMaps, m.Reconnected, m.Shutdown, m.Watched),
    (RELAY, RECORDER): _RELAY_REPORTS,
    (RELAY, VIEW): _RELAY_REPORTS,
    (WORLD, RELAY): (m.Positions, m.Lost, m.FaultEvent, m.End),
    (WORLD, ROBOT): (m.Sense, m.FaultEvent),
    (WORLD, RECORDER): _WORLD_REPORTS,
    (WORLD, VIEW): _WORLD_REPORTS,
    (RECORDER, RELAY): (m.Configure, m.Lost, m.Stop, m.FaultEvent, m.Change, m.RequestMaps, m.Shutdown),
    (ROBOT, RELAY): (m.RobotFrames,),
    (ROBOT, WORLD): (m.Move,),
    (ROBOT, RECORDER): (m.RobotStatus, m.MapChanges, m.Outlines, m.MapPart, m.ErrorReport),
    (ROBOT, VIEW): (m.RobotStatus, m.ErrorReport, m.Snapshot, m.Outlines),
}  # fmt: skip
"""Messages allowed from a sender (first key) to a receiver (second key); a viewer sends none."""

RADIO = (m.RobotFrames, m.RelayUpdate)
"""Messages of the radio plane: the frames of robots, and the relay's events."""

BODY = {(WORLD, ROBOT), (ROBOT, WORLD)}
"""Sender and receiver of messages on the body plane; other pairs use the control plane."""


MAX_STEP_BYTES = 1 << 26
"""Maximum bytes of frames that a robot may submit to the relay in a step."""
TOO_MANY_BYTES = "sent more than {} bytes in a step"
"""Cause of the loss of a robot that exceeds a limit of bytes."""
MAX_PROTOCOL_ERRORS = 1000
"""A robot that causes more protocol errors in a step counts as lost."""
TOO_MANY_ERRORS = f"sent more than {MAX_PROTOCOL_ERRORS} malformed messages in a step"


def read(key: str, payload: bytes) -> Any:
    """Decode a message that was received under a key.

    ProtocolError: it is malformed or too long, or its sender may not send it to its receiver.
    """
    return _reader(key)(payload)


@lru_cache(maxsize=1 << 12)
def _reader(key: str) -> Callable[[bytes], Any]:
    plane, direction, first, second = names.parts(key)
    sender, receiver = (first, RELAY) if direction == "tx" else (second, first)
    return _reader_of(plane, (_role(sender), _role(receiver)), sender)


@lru_cache(maxsize=1 << 10)
def _reader_of(plane: str, ends: tuple[str, str], sender: str) -> Callable[[bytes], Any]:
    kinds = tuple(kind for kind in RIGHTS.get(ends, ()) if plane == plane_of(kind, ends))
    limit = MAX_ROBOT_PAYLOAD if ends[0] == ROBOT else MAX_PAYLOAD
    return unpacker(kinds, sender or "an unnamed sender", limit)


def plane_of(kind: type[m.Record], ends: tuple[str, str]) -> str:
    """Return the plane of a message between `ends`: the roles of its sender and receiver."""
    if kind in RADIO:
        return "radio"
    return "body" if ends in BODY else "control"


def _role(name: str) -> str:
    return ROBOT if names.is_robot(name) else name


def may_put(keys: Keys, name: str) -> list[str]:
    """Return the keys under which a participant may put messages and frames; `*` stands for any name."""
    role = _role(name)
    radio = [keys.radio_tx(name)] if role == ROBOT else []
    return radio + [_key(keys, name, role, receiver) for sender, receiver in RIGHTS if sender == role]


def receivers(name: str, everyone: list[str]) -> list[str]:
    """Return the participants to which participant `name` may send any message."""
    role = _role(name)
    return [other for other in [RELAY, *everyone] if other != name and (role, _role(other)) in RIGHTS]


def _key(keys: Keys, name: str, role: str, receiver: str) -> str:
    if receiver == RELAY:
        return keys.control_tx(name)
    place = "*" if receiver == ROBOT else receiver
    return keys.body(place, name) if (role, receiver) in BODY else keys.control(place, name)
