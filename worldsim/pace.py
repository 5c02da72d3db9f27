"""Pacing of the world's steps for viewers; it does not affect results."""

from __future__ import annotations

import time

SLOWEST = 0.5
"""Minimum of steps per second; a world that sleeps longer does not receive the request to stop in time."""


class Pace:
    """A maximum of steps per second; steps do not catch up after a slow one. The first `free` steps are not limited.

    Raises ValueError if fewer steps per second than `SLOWEST`.
    """

    def __init__(self, steps_per_s: float, free: int = 0) -> None:
        if not steps_per_s >= SLOWEST:
            raise ValueError(f"pace = {steps_per_s:g}: must be {SLOWEST:g} steps per second or more")
        self._period = 1.0 / steps_per_s
        self._due = 0.0
        self._free = free

    def wait(self) -> None:
        """Wait until the next step may be opened."""
        if self._free:
            self._free -= 1
            return
        now = time.monotonic()
        if now < self._due:
            time.sleep(self._due - now)
        self._due = max(self._due, now) + self._period
