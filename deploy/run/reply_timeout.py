"""A time limit in wall clock for each robot and phase; a robot that exceeds it is removed from the run.

Only progress of the phase resets the limit, not other messages. The limit counts the time during which the waiting
process runs: a relay that was stopped and continued does not hold that time against the robots.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from netshaper.process import RelayNode
    from worldsim.process import WorldNode

REPLY_TIMEOUT_S = 60.0
"""Default time limit for a robot's reply in a phase of the medium, or for its move."""
TIMED_OUT = "timed out"
"""Beginning of the cause of a robot's loss."""
CHECK_S = 0.25
GAP_S = 0.5
"""Longest time between two readings of a `RunningClock` that counts."""


class RunningClock:
    """A clock that does not advance while this process is stopped; it must be read several times per second."""

    def __init__(self) -> None:
        self._read = time.monotonic()
        self._stopped_s = 0.0

    def __call__(self) -> float:
        """Return the time in seconds."""
        now = time.monotonic()
        if now - self._read > GAP_S:
            self._stopped_s += now - self._read
        self._read = now
        return now - self._stopped_s


class ReplyTimeout:
    """The time limit of a relay's or world's phases; its owner calls `check` repeatedly."""

    def __init__(self, node: RelayNode | WorldNode, reply_timeout_s: float) -> None:
        self._node = node
        self._limit_s = reply_timeout_s
        self._phase = node.phase
        self._clock = RunningClock()
        self._since = self._checked = self._clock()

    def check(self) -> float:
        """Give up on robots that exceed the limit; return the seconds since the last progress."""
        now = self._clock()
        if now - self._checked < CHECK_S:
            return 0.0
        self._checked = now
        if self._node.phase != self._phase:
            self._phase, self._since = self._node.phase, now
        idle = now - self._since
        for robot in self._node.waiting_for() if idle > self._limit_s else []:
            self._node.give_up_on(robot, f"{TIMED_OUT} after {self._limit_s:g} s")
        return idle
