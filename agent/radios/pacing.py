"""Pacing: when this robot may send its next frame, in integer nanoseconds.

Four rules hold at the same time, each a small class or function of its own:

    bytes per second   a token bucket that holds at least one frame (`protocol.token_bucket`)
    duty cycle         a token bucket of airtime, with at most a share of any hour (ETSI EN 300 220)
    one at a time      a frame begins after the airtime of the last one
    random back-off    a frame waits a random time first, so that robots with equal steps rarely collide
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable

from protocol.keyed_random import keyed_random
from protocol.nanoseconds import SECOND
from protocol.token_bucket import TokenBucket

HOUR = 3600 * SECOND

ALWAYS = 1_000_000
"""The share of time of a duty cycle without a limit, in parts per million."""

AT_ONCE = 10
"""The part of an hour's airtime that can be used at once, as a divisor."""


class DutyCycle:
    """A token bucket of airtime, empty at first, with which no hour has more than its share of airtime.

    What the bucket holds and what flows in within an hour are together that share. So airtime is spread over the hour:
    a tenth of it, or the airtime of the longest frame if that is more, can be used at once. A robot that starts again
    may have used its share before: an empty bucket keeps the limit in every hour.

    `share` is that of each hour, in parts per million, or `ALWAYS` for no limit. `longest` is the airtime of the
    longest frame, and `delay` the longest time between the call of `take` and the end of the frame, both in
    nanoseconds. ValueError: the share is outside 1 to `ALWAYS`, or an hour has no room for more than the longest frame.
    """

    def __init__(self, share: int, longest: int, delay: int, now: int) -> None:
        if not 0 < share <= ALWAYS:
            raise ValueError(f"duty cycle of {share} parts per million: must be 1 to {ALWAYS}")
        most = HOUR * share // ALWAYS
        capacity = max(most // AT_ONCE, longest)
        if capacity >= most:  # the bucket, empty at first, would never fill
            allowed = f"{most / SECOND:.3g} s of airtime per hour"
            raise ValueError(f"a duty cycle of {allowed} has no room for a frame of {longest / SECOND:.3g} s")
        self._unlimited = share == ALWAYS
        self._bucket = TokenBucket(most - capacity, capacity, now, HOUR + delay, starts_empty=True)

    def room(self, now: int) -> int:
        """Return the airtime, in nanoseconds, that is left now."""
        return HOUR if self._unlimited else self._bucket.room(now)

    def take(self, airtime: int) -> None:
        """Take airtime out of the bucket, as it was at the last call of `room`."""
        self._bucket.take(airtime)


class Pacer:
    """Decides when the next frame may be sent, and how long it may be: at most `frame_bytes` bytes.

    `airtime` returns the airtime in nanoseconds of a frame of so many bytes. Frames wait less than `backoff`
    nanoseconds; `seed` and `robot` are the key of the random waiting times.
    """

    def __init__(
        self,
        bucket: TokenBucket,
        duty_cycle: DutyCycle,
        airtime: Callable[[int], int],
        frame_bytes: int,
        backoff: int,
        seed: int,
        robot: int,
    ) -> None:
        self._bucket = bucket
        self._duty_cycle = duty_cycle
        self._airtime = airtime
        self._frame_bytes = frame_bytes
        self._backoff = backoff
        self._key = seed, robot
        self._frames = 0
        self._free = 0
        """When the airtime of the last frame ends."""

    def room(self, now: int) -> int:
        """Return the bytes of the longest frame that may be sent now; 0 while another frame is on the air."""
        if now < self._free:
            return 0
        room = min(self._bucket.room(now), self._frame_bytes)
        left = self._duty_cycle.room(now)
        fitting = bisect_right(range(room + 1), left, key=self._airtime)  # the airtime grows with the size
        return max(0, fitting - 1)

    def schedule(self, size: int, now: int) -> int:
        """Note a frame of `size` bytes, for which there is room now; return when to send it."""
        seed, robot = self._key
        wait = 0
        if self._backoff:
            wait = int(keyed_random(seed, "radio back-off", robot, self._frames).integers(self._backoff))
        self._frames += 1
        start = max(now, self._free) + wait
        airtime = self._airtime(size)
        self._free = start + airtime
        self._bucket.take(size)
        self._duty_cycle.take(airtime)
        return start
