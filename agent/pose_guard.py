"""Plausibility of a body's pose over time: a robot whose pose has jumped stays silent until its SLAM has settled.

A jump is a change of position that the robot cannot have driven in that time. SLAM jumps when it recognizes a place, or
loses its way. What a robot would send then might lie elsewhere in the building.
"""

from __future__ import annotations

import math

from protocol.nanoseconds import SECOND

JUMP_M = 0.5
"""Distance in meters by which a pose may jump: SLAM corrects it."""
SETTLE_NS = 2 * SECOND
"""Nanoseconds without a jump after which poses are accepted again."""


class PoseGuard:
    """Accepts the poses of one body.

    `speed` is its largest speed per second, in meters or cells, as all positions. Any two poses may differ by `slack`
    in addition. Poses are accepted again after `settle` nanoseconds without a jump.
    """

    def __init__(self, speed: float, slack: float, settle: int = SETTLE_NS) -> None:
        self.has_jumped = False
        """Whether a pose has jumped, and poses have not settled since."""
        self._speed = speed
        self._slack = slack
        self._settle = settle
        self._last: tuple[float, float, int] | None = None
        """Position and time of the last pose."""
        self._settled_at = 0
        """Time from which poses are accepted again after the last jump."""

    def accept(self, x: float, y: float, now: int) -> bool:
        """Take a position at a time in nanoseconds; return whether it can be relied on."""
        if self._last is not None:
            before_x, before_y, then = self._last
            reach = self._speed * max(0, now - then) / SECOND + self._slack
            if math.hypot(x - before_x, y - before_y) > reach:
                self._settled_at = now + self._settle
        self._settled_at = min(self._settled_at, now + self._settle)  # less only if the clock was set back
        self._last = x, y, now
        self.has_jumped = now < self._settled_at
        return not self.has_jumped
