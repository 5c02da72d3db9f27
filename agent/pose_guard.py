"""Plausibility of a body's pose over time: a robot whose pose has jumped stays silent until its SLAM has settled.

A jump is a change of position that the robot cannot have driven in that time. SLAM jumps when it recognizes a place, or
loses its way. What a robot would send then might lie elsewhere in the building.
"""

from __future__ import annotations

import math

from protocol.nanoseconds import SECOND


class PoseGuard:
    """Accepts the poses of one body.

    Parameters
    ----------
    speed : float
        Cells per second that the body drives at most.
    slack : float
        Cells by which any two poses may differ in addition.
    settle : int
        Nanoseconds without a jump after which poses are accepted again.
    """

    def __init__(self, speed: float, slack: float, settle: int) -> None:
        self.jumps = 0
        """Jumps so far."""
        self._speed = speed
        self._slack = slack
        self._settle = settle
        self._last: tuple[float, float, int] | None = None
        """Position and time of the last pose."""
        self._accepts_at: int | None = None
        """When poses are accepted again; None: they are."""

    def accept(self, x: float, y: float, now: int) -> bool:
        """Take a position in cells at a time in nanoseconds; return whether it can be relied on."""
        if self._last is not None:
            before_x, before_y, then = self._last
            reach = self._speed * max(0, now - then) / SECOND + self._slack
            if math.hypot(x - before_x, y - before_y) > reach:
                self.jumps += 1
                self._accepts_at = now + self._settle
        self._last = x, y, now
        if self._accepts_at is not None and now >= self._accepts_at:
            self._accepts_at = None
        return self._accepts_at is None
