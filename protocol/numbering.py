"""Numbered messages, so that a connection can be cut without losing, repeating or reordering messages.

On Zenoh, messages to and from robots begin with the session and number of the sender. It keeps its last messages and
sends them again after its own or the receiver's connection was cut. The receiver takes each number once and in order.
"""

from __future__ import annotations

import secrets
import struct
from collections import deque
from functools import lru_cache

from protocol import keys as names

HEAD = struct.Struct("<II")
"""Session and number of a message."""
KEPT_BY_ROBOT = 128
"""Messages that a robot keeps per receiver: more than its reports of two steps, before which all have arrived."""
KEPT_FOR_ROBOT = 16
"""Messages that relay and world keep per robot: they send a robot few messages before it replies."""


@lru_cache(maxsize=1 << 12)
def is_numbered(key: str) -> bool:
    """Return whether messages under a key are numbered: those of and to robots, except to a viewer."""
    plane, direction, first, second = names.parts(key)
    if plane == "presence" or (direction == "rx" and first == names.VIEW):
        return False
    return names.is_robot(first) or names.is_robot(second)


class Outgoing:
    """The numbered messages that one end sends under one key; `kept` holds the last ones."""

    def __init__(self, session: int, kept: int) -> None:
        self.kept: deque[bytes] = deque(maxlen=kept)
        self._session = session
        self._next = 0

    def number(self, payload: bytes) -> bytes:
        """Return a message with its number, and keep it."""
        numbered = HEAD.pack(self._session, self._next) + payload
        self._next += 1
        self.kept.append(numbered)
        return numbered


class Incoming:
    """The numbers of the messages that one end receives under one key."""

    def __init__(self) -> None:
        self.first = 0
        """Number of the first message that was received."""
        self._session: int | None = None
        self._next = 0

    def accept(self, payload: bytes) -> bytes | None:
        """Return a message without its number; None if it came before, or if it follows a gap.

        A sender that has started again has another session, which begins with number 0. A receiver that has started
        again continues with the first number that it receives.
        """
        if len(payload) < HEAD.size:
            return payload  # not numbered: the receiver of the message rejects it
        session, number = HEAD.unpack_from(payload)
        if session != self._session:
            if self._session is not None and number:
                return None
            if self._session is None:
                self.first = number
            self._session, self._next = session, number
        if number != self._next:
            return None
        self._next += 1
        return payload[HEAD.size :]


def new_session() -> int:
    """Return a number for the messages of one end that no earlier end has."""
    return secrets.randbits(32)
