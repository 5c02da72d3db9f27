"""The gate of a controlled run: it delays the world before each step (`deploy.run.control`)."""

from __future__ import annotations

import time
from typing import Any

LONGEST_PAUSE_S = 3600.0
"""A paused run continues by itself after this time."""
POLL_S = 0.02


class Gate:
    """Delays the world's steps, in the world's process; state shared with `Control`."""

    def __init__(self, credit: Any, period: Any, free: int) -> None:
        self._credit, self._period, self._free = credit, period, free
        self._due = 0.0

    def wait(self) -> None:
        """Wait until the next step may be opened."""
        if self._free:
            self._free -= 1
            return
        until = time.monotonic() + LONGEST_PAUSE_S
        while self._credit.value == 0 and time.monotonic() < until:
            time.sleep(POLL_S)
        with self._credit.get_lock():
            if self._credit.value > 0:
                self._credit.value -= 1
        now = time.monotonic()
        if now < self._due:
            time.sleep(self._due - now)
        self._due = max(min(self._due, now + self._period.value), now) + self._period.value
