"""The duty cycle of a robot: its airtime in any hour is at most a share of the hour (ETSI EN 300 220)."""

from __future__ import annotations

from collections import deque

STEP = 1_000_000_000
"""Airtime of a whole step, in its units."""


class DutyCycle:
    """The airtime of a robot within the last hour.

    A robot may use its whole `share` of an hour at once; each transmission then counts for an hour, of `hour` steps.
    """

    def __init__(self, share: float, hour: int) -> None:
        self._hour = hour
        self._step = 0
        self._left = round(share * hour * STEP)
        """Airtime that the robot may still use."""
        self._used: deque[tuple[int, int]] = deque()
        """The step and the airtime of each transmission of the last hour."""

    def next_step(self) -> None:
        """Begin a step, and forget transmissions that are an hour old."""
        self._step += 1
        while self._used and self._used[0][0] <= self._step - self._hour:
            self._left += self._used.popleft()[1]

    def room(self, bandwidth: int) -> int:
        """Return how many bytes the robot may send, at a rate of so many bytes per step."""
        return max(0, self._left * bandwidth // STEP)

    def take(self, size: int, bandwidth: int) -> None:
        """Count the airtime of `size` bytes, at a rate of so many bytes per step."""
        airtime = -(-size * STEP // bandwidth)
        self._left -= airtime
        self._used.append((self._step, airtime))
