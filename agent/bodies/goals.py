"""The goal of a robot that finds its own way: when to send it, and when the robot makes no progress toward it.

The class has no socket and no clock: times are nanoseconds of a clock that never goes back.
"""

from __future__ import annotations

import math

from protocol.transforms import Pose

SAME_M = 0.05
"""Goals closer to each other are the same."""
PROGRESS_M = 0.3
"""A robot that stays within this distance of a point makes no progress."""


class GoalTracker:
    """The goal of one robot; it is stuck after `patience` nanoseconds without progress."""

    def __init__(self, patience: int) -> None:
        self.goal: Pose | None = None
        """The goal that was sent last; None: the robot stands still."""
        self._patience = patience
        self._anchor: Pose | None = None
        """Where the robot was when it last made progress."""
        self._since = 0
        self._failed = False

    def change(self, goal: Pose | None) -> bool:
        """Take the goal that the robot should have; return whether to send it, or to stop for None.

        The heading of a goal does not count: it follows from the way, and changes with it.
        """
        before, self.goal = self.goal, goal
        if before is None or goal is None:
            self._anchor, self._failed = None, False
            return before is not goal
        if math.dist(before[:2], goal[:2]) <= SAME_M:
            self.goal = before
            return False
        self._failed = False
        return True

    def fail(self) -> None:
        """Note that the robot has given the goal up."""
        self._failed = self.goal is not None

    def is_stuck(self, here: Pose, now: int) -> bool:
        """Take where the robot is; return whether it does not reach its goal. A true result begins a new period."""
        if self.goal is None:
            return False
        if self._anchor is None or math.dist(self._anchor[:2], here[:2]) > PROGRESS_M:
            self._anchor, self._since = here, now
        stuck = self._failed or now - self._since >= self._patience
        if stuck:
            self._anchor, self._failed = None, False
        return stuck
