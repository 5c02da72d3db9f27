"""The gate that a controlled run's world passes before it opens a step (`deploy.run.control`)."""

from __future__ import annotations

import time
from typing import Any

LONGEST_PAUSE_S = 3600.0
"""After so long a run goes on by itself."""
POLL_S = 0.02


class Gate:
    """Lets the world open its steps, in its own process."""

    def __init__(self, credit: Any, period: Any, free: int = 0) -> None:
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
