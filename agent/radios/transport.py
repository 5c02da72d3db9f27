"""The interface of all transports: frames out, frames in, no waiting.

A transport may lose, repeat, reorder, and damage frames. It holds what arrives until `receive` is called.
"""

from __future__ import annotations

import select
import time
from typing import Protocol


class TransportError(ValueError):
    """A transport cannot be opened; the message says what to do."""


class Transport(Protocol):
    """Where sealed frames go."""

    def send(self, frame: bytes) -> bool:
        """Send a frame to all in range; return False if it could not be sent, which counts as a loss."""

    def receive(self) -> list[bytes]:
        """Return the frames that have arrived since the last call, `MAX_PER_CALL` at most."""

    def fileno(self) -> int:
        """Return a file descriptor that is readable when frames have arrived, for `select`; -1 if there is none."""

    def close(self) -> None:
        """Release what the transport holds; later calls do nothing."""


MAX_PER_CALL = 256
"""Frames that one call of `Transport.receive` returns at most, so that a flood does not hold up the robot."""


def wait(transport: Transport, duration: int) -> None:
    """Wait for so many nanoseconds, or until frames have arrived."""
    seconds = max(0, duration) / 1e9
    if transport.fileno() < 0:
        time.sleep(seconds)
    else:
        select.select([transport], [], [], seconds)
