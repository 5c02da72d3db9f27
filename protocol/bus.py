"""The bus interface of all participants: put, receive, close. It has two implementations: Zenoh and memory."""

from __future__ import annotations

from typing import NamedTuple, Protocol


class Message(NamedTuple):
    """A received message: the key under which it was put, and its bytes."""

    key: str
    payload: bytes


class BusClosed(ConnectionError):  # noqa: N818 - it is also the normal end of a run
    """The hub is not available any more, or this end is closed."""


class Bus(Protocol):
    """One participant's end of the bus.

    Each end listens to its own inbox (`Keys.inbox`) and no other. Nothing is dropped; messages from one sender
    to one receiver arrive whole, exactly once, and in order. The relay's end also receives `Keys.presence`
    messages when other participants join and leave, the latter behind all messages of the leaving participant.
    """

    def put(self, key: str, payload: bytes) -> None:
        """Send `payload` to the participant whose inbox contains `key`; BusClosed if this end was closed."""

    def receive(self, timeout_s: float | None = None) -> Message | None:
        """Wait for the next message, at most `timeout_s` seconds; return None after the timeout.

        Raises BusClosed if no further message can arrive: this end was closed, or the hub is gone and its last messages
        are read.
        """

    def close(self) -> None:
        """Leave the bus; messages that were put before are delivered. Closing an end again has no effect."""
