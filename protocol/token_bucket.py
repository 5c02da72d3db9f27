"""A token bucket (as in RFC 2697), which limits the mean rate of sending, and the size of bursts.

Radios in the field refill it by a clock (`agent.radios.pacing`), the simulated radio by the steps of the run
(`netshaper.airtime`).
"""

from __future__ import annotations

from protocol.nanoseconds import SECOND


class TokenBucket:
    """Tokens, as bytes that may be sent: `rate` more in each `period` of nanoseconds, and `capacity` at most.

    The bucket is full at the time `now`, or with `starts_empty` empty.
    """

    def __init__(
        self, rate: int, capacity: int, now: int, period: int = SECOND, *, starts_empty: bool = False
    ) -> None:
        self._rate = rate
        self._period = period
        self._capacity = capacity * period
        self._credit = 0 if starts_empty else self._capacity
        """Tokens times `_period`: an integer at every nanosecond."""
        self._now = now

    def room(self, now: int) -> int:
        """Return how many tokens there are now."""
        self._credit = min(self._credit + self._rate * max(0, now - self._now), self._capacity)
        self._now = max(now, self._now)
        return self.left

    @property
    def left(self) -> int:
        """How many tokens there were at the last call of `room`, without those taken since."""
        return max(0, self._credit // self._period)

    def take(self, size: int) -> None:
        """Take tokens out of the bucket, as it was at the last call of `room`."""
        self._credit -= size * self._period
