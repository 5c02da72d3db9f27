"""Who may say what to whom: one table for relay, world, laboratory, viewer and robots, and for access control.

Nothing that is said is believed without it: each participant reads its messages with `read`, which refuses what is not
its sender's to say, before anything of it is unpacked that would be longer than what it may say.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from protocol import keys as names
from protocol.keys import RECORDER, RELAY, VIEW, WORLD, Keys
from protocol.messages import (
    Back,
    Begin,
    Change,
    Close,
    Configure,
    End,
    Fault,
    FaultEvent,
    Lost,
    MapChanges,
    Maps,
    Move,
    Outlines,
    Positions,
    RadioReport,
    Record,
    RelayUpdate,
    RobotFrames,
    RobotStatus,
    Sense,
    Shutdown,
    Snapshot,
    Stop,
    Watched,
    WorldReport,
    unpacker,
)

ROBOT = "robot"
"""Stands in the table for each robot."""

RIGHTS: dict[tuple[str, str], tuple[type[Record], ...]] = {
    (RELAY, WORLD): (Begin, Close, Lost, Back, Stop, FaultEvent, Shutdown, Watched),
    (RELAY, ROBOT): (Configure, RelayUpdate, End, Shutdown, Watched),
    (RELAY, RECORDER): (Lost, Back, End, Shutdown, RadioReport, Fault, Change),
    (RELAY, VIEW): (Lost, Back, End, Shutdown, RadioReport, Fault, Change),
    (WORLD, RELAY): (Positions, Lost, End),
    (WORLD, ROBOT): (Sense, End, FaultEvent),
    (WORLD, RECORDER): (WorldReport, FaultEvent, Fault),
    (WORLD, VIEW): (WorldReport, FaultEvent, Fault),
    (RECORDER, RELAY): (Configure, Lost, Stop, FaultEvent, Change, Shutdown),
    (ROBOT, RELAY): (RobotFrames,),
    (ROBOT, WORLD): (Move,),
    (ROBOT, RECORDER): (RobotStatus, MapChanges, Outlines, Maps, Fault),
    (ROBOT, VIEW): (RobotStatus, Fault, Snapshot, Outlines),
}
"""What who says (first) may say to whom (second); a viewer says nothing."""

RADIO = (RobotFrames, RelayUpdate)
"""What goes on the radio plane: the packets of robots, and what the relay makes of them."""

BODY = {(WORLD, ROBOT), (ROBOT, WORLD)}
"""Who speaks to whom on the body plane; all others do on the control plane."""


MAX_PROTOCOL_ERRORS = 1000
"""Who says more in a step that makes no sense is given up."""
TOO_MANY_ERRORS = f"said more than {MAX_PROTOCOL_ERRORS} things in a step that make no sense"


def read(key: str, payload: bytes) -> Any:
    """Read a message that came under a key.

    Raises
    ------
    ProtocolError
        It is no message, too long for one, a field is wrong, or it is not for its sender to say to its receiver.
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
    return unpacker(kinds, sender or "nobody")


def plane_of(kind: type[Record], ends: tuple[str, str]) -> str:
    """The plane on which a message goes from the first to the second of two roles."""
    if kind in RADIO:
        return "radio"
    return "body" if ends in BODY else "control"


def _role(name: str) -> str:
    return ROBOT if names.is_robot(name) else name


def may_put(keys: Keys, name: str) -> list[str]:
    """The keys that a participant may put messages and frames under; `*` stands for any name."""
    role = _role(name)
    radio = [keys.radio_tx(name)] if role == ROBOT else []
    return radio + [_key(keys, name, role, receiver) for sender, receiver in RIGHTS if sender == role]


def hearers(name: str, everyone: list[str]) -> list[str]:
    """Of all participants, those to whom one may say anything."""
    role = _role(name)
    return [other for other in [RELAY, *everyone] if other != name and (role, _role(other)) in RIGHTS]


def _key(keys: Keys, name: str, role: str, receiver: str) -> str:
    if receiver == RELAY:
        return keys.control_tx(name)
    place = "*" if receiver == ROBOT else receiver
    return keys.body(place, name) if (role, receiver) in BODY else keys.control(place, name)
