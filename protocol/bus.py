"""The bus, as everyone in a run sees it: put, receive, close. Two stand behind it: Zenoh and memory."""

from __future__ import annotations

from typing import NamedTuple, Protocol


class Message(NamedTuple):
    """What arrives: the key under which it was put, and its bytes."""

    key: str
    payload: bytes


class BusClosed(ConnectionError):  # noqa: N818 - it is how a run ends, not only a fault
    """The hub is gone, or this end was closed."""


class Bus(Protocol):
    """One participant's end of the bus.

    Each end listens to its own inbox (`Keys.inbox`) and no other. Nothing is dropped; what one sender puts
    for one receiver arrives whole, once, and in the order in which it was put. The relay's end also receives
    `Keys.presence` messages when others come and go, after all that the leaver had said.
    """

    def put(self, key: str, payload: bytes) -> None:
        """Send `payload` to all who listen to `key`.

        Raises
        ------
        BusClosed
            This end was closed.
        """

    def receive(self, timeout_s: float | None = None) -> Message | None:
        """Wait for the next message, at most `timeout_s` seconds; None when nothing came.

        Raises
        ------
        BusClosed
            Nothing will ever come again: this end was closed, or the hub is gone and its last words are read.
        """

    def close(self) -> None:
        """Leave the bus; what was put before is delivered. An end that is closed already stays so."""
