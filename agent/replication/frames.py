"""Frames as they pass between the replication engine and the relay."""

from __future__ import annotations

from typing import NamedTuple

EVERYONE = -1
"""Receiver of a broadcast."""


class OutgoingFrame(NamedTuple):
    receiver: int
    payload: bytes
    connection: int = -1


class Delivery(NamedTuple):
    sender: int
    payload: bytes
    connection: int = -1
    map_id: int = -1


class ConnectionReport(NamedTuple):
    connection: int
    offer: int
    answer: int
    data: int


class SendReport(NamedTuple):
    frame: int
    sent: int


class RoundReport(NamedTuple):
    step: int
    round: int
    connections: list[ConnectionReport]
    sent: list[SendReport]
    deliveries: list[Delivery]
    broadcast_sent: bool
