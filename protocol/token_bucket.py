"""A token bucket (as in RFC 2697), which limits the mean rate of sending, and the size of bursts.

Radios in the field refill it by a clock (`agent.radios.pacing`), the simulated radio by the steps of the run
(`netshaper.airtime`).
"""

from __future__ import annotations

from protocol.nanoseconds import SECOND


class TokenBucket:
    """Bytes that may be sent: `rate` more per second, and `capacity` at most; full at first.

    Raises
    ------
    ValueError
        The rate is not positive, or the bucket does not hold a frame of `frame_bytes`.
    """

    def __init__(self, rate: int, capacity: int, frame_bytes: int, now: int) -> None:
        if rate < 1:
            raise ValueError(f"{rate} bytes per second: must be 1 or more")
        if capacity < frame_bytes:
            raise ValueError(f"a bucket of {capacity} bytes never holds a frame of {frame_bytes} bytes")
        self._rate = rate
        self._capacity = capacity * SECOND
        self._credit = self._capacity
        """Bytes times `SECOND`: an integer at every nanosecond."""
        self._now = now

    def room(self, now: int) -> int:
        """Return how many bytes may be sent now."""
        self._credit = min(self._credit + self._rate * max(0, now - self._now), self._capacity)
        self._now = max(now, self._now)
        return self.left

    @property
    def left(self) -> int:
        """How many bytes could be sent at the last call of `room`, without those taken since."""
        return max(0, self._credit // SECOND)

    def take(self, size: int) -> None:
        """Take bytes out of the bucket, as it was at the last call of `room`."""
        self._credit -= size * SECOND
