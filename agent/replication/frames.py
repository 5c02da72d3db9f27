"""Frames as they pass between the replication engine and the relay."""

from __future__ import annotations

from typing import NamedTuple

EVERYONE = -1
"""Receiver of a broadcast."""

NO_CONNECTION = -1
"""Connection of frames outside a handshake."""


class OutgoingFrame(NamedTuple):
    """A frame to send: to one robot or to `EVERYONE`, on a connection that the relay numbered."""

    receiver: int
    connection: int
    payload: bytes


class Delivery(NamedTuple):
    """A received frame; `map` is the map number that its connection is about."""

    sender: int
    connection: int
    map: int
    payload: bytes


class SendReport(NamedTuple):
    """Bytes on the air of each frame of a connection."""

    connection: int
    offer: int
    answer: int
    data: int
