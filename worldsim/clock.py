"""Clocks of a run: when a step ends, and which robots take part in it (docs/clocks.md).

No clock reads the time: the caller passes it in, in integer nanoseconds.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable

from protocol.messages import Missed

TOLERATED_LAG = 10
"""A step that begins late by more than one part in so many of its duration shifts the ends of all further steps."""

STEP, MOVE = "step", "move"
"""Phases of `Missed` messages of the world: robots took no part in the step; their moves were late."""


class StepClock:
    """The barrier: a step ends when all robots that take part in it have moved."""

    waits = True
    """Whether a step waits for robots."""

    def deadline(self, now_ns: int) -> int | None:
        """Return the time at which `tick` should be called, in nanoseconds; None: never."""
        return None

    def tick(self, now_ns: int) -> None:
        """Note the time."""

    def begin(self, step: int) -> Collection[int]:
        """Begin a step; return the robots that take no part in it, because they still work on an earlier one."""
        return ()

    def is_late(self, robot: int, step: int) -> bool:
        """Return whether the move of a robot for a step came too late; then it does not count."""
        return False

    def is_over(self, moved: int, active: int) -> bool:
        """Return whether the step ends now: the medium is closed, and `moved` of `active` robots have moved."""
        return moved >= active

    def end(self, step: int, moved: Iterable[int], late: Iterable[int]) -> None:
        """End a step; `moved`: robots that moved in it, `late`: robots that took part and did not move in time."""

    def forget(self, robot: int) -> None:
        """Note that the process of a robot has ended."""


class WallClock(StepClock):
    """A step ends after `step_ns` nanoseconds; robots that have not moved by then miss it.

    A robot that misses a step may take part in the next one. If it has not sent the move of the missed step by the end
    of that one, it takes no part in further steps until it has.
    """

    waits = False

    def __init__(self, step_ns: int) -> None:
        self._step_ns = step_ns
        self._deadline: int | None = None
        """The end of this step; None before the first one."""
        self._has_begun = False
        """Whether a step has begun and its end is not set yet."""
        self._is_over = False
        self._owed: defaultdict[int, list[int]] = defaultdict(list)
        """The steps that each robot has missed, and for which it has not sent a move since, in ascending order."""

    def deadline(self, now_ns: int) -> int | None:
        """Return the end of this step, in nanoseconds."""
        if self._has_begun:
            last = self._deadline
            is_on_time = last is not None and now_ns < last + self._step_ns // TOLERATED_LAG
            self._deadline = (last if last is not None and is_on_time else now_ns) + self._step_ns
            self._has_begun = False
        return self._deadline

    def tick(self, now_ns: int) -> None:
        """End the step if its time is over."""
        self._is_over = self._deadline is not None and not self._has_begun and now_ns >= self._deadline

    def begin(self, step: int) -> Collection[int]:
        """Begin a step; return the robots that still work on a step before the last one."""
        self._has_begun, self._is_over = True, False
        return [robot for robot, owed in self._owed.items() if owed[0] < step - 1]

    def is_late(self, robot: int, step: int) -> bool:
        """Return whether a robot has missed the step of this move; it has finished this step now."""
        owed = self._owed.pop(robot, [])
        later = [each for each in owed if each > step] if step in owed else owed
        if later:
            self._owed[robot] = later
        return step in owed

    def is_over(self, moved: int, active: int) -> bool:
        """Return whether the time of the step is over."""
        return self._is_over

    def end(self, step: int, moved: Iterable[int], late: Iterable[int]) -> None:
        """End a step: robots that moved have finished all earlier steps, and `late` ones have missed this one."""
        for robot in moved:
            self.forget(robot)
        for robot in late:
            self._owed[robot].append(step)

    def forget(self, robot: int) -> None:
        """Expect no late moves of a robot."""
        self._owed.pop(robot, None)


class RecordedClock(StepClock):
    """Repeats a run by the wall clock: a step ends when all robots have moved that did so in time in that run."""

    def __init__(self, record: Iterable[Missed]) -> None:
        self._robots: dict[tuple[int, str], Collection[int]] = {
            (missed.step, missed.phase): missed.robots for missed in record if missed.phase in (STEP, MOVE)
        }
        self._step = 0

    def begin(self, step: int) -> Collection[int]:
        """Begin a step; return the robots that took no part in it."""
        self._step = step
        return self._robots.get((step, STEP), ())

    def is_late(self, robot: int, step: int) -> bool:
        """Return whether a robot's move for a step was late."""
        return robot in self._robots.get((step, MOVE), ())

    def is_over(self, moved: int, active: int) -> bool:
        """Return whether all robots have moved that moved in time in the recorded run."""
        return moved >= active - len(self._robots.get((self._step, MOVE), ()))
