"""Which robots have ended, are being restarted, or have rejoined: the bookkeeping of the world's step barrier."""

from __future__ import annotations

from collections.abc import Iterable


class Restarts:
    """Restarts of one run's robots, each at most `allowed` times.

    A restart that a fault requests holds the next step until the robot has rejoined. If `automatic`, robots are also
    restarted after an unexpected end, which does not hold the step: they take part again once they have rejoined.
    """

    def __init__(self, robots: Iterable[int], allowed: int, *, automatic: bool) -> None:
        self.awaited: set[int] = set()
        """Robots that a fault restarts; the next step does not begin without them."""
        self.rejoined: set[int] = set()
        """Robots that are back on the bus and enter the world with the next step."""
        self.recovering: set[int] = set()
        """Robots that ended unexpectedly and are being restarted."""
        self._ended: set[int] = set()
        self._automatic = automatic
        self._left = dict.fromkeys(robots, allowed)

    def may_restart(self, robot: int) -> bool:
        """Return whether `robot` may be restarted once more."""
        return self._left[robot] > 0

    def request(self, robot: int) -> None:
        """Restart `robot` before the next step begins."""
        self.awaited.add(robot)
        self._left[robot] -= 1

    def note_end(self, robot: int, *, unexpected: bool) -> bool:
        """Note that the process of `robot` has ended; return whether it is to be restarted without a fault."""
        self._ended.add(robot)
        self.rejoined.discard(robot)
        recovers = unexpected and self._automatic and robot not in self.awaited and self.may_restart(robot)
        if recovers:
            self._left[robot] -= 1
            self._ended.discard(robot)
            self.recovering.add(robot)
        return recovers

    def note_return(self, robot: int) -> None:
        """Note that `robot` has rejoined."""
        self.rejoined.add(robot)
        self._ended.discard(robot)
        self.recovering.discard(robot)

    def give_up_on(self, robot: int) -> bool:
        """Stop waiting for `robot`; return whether the step was waiting for it."""
        if robot not in self.awaited:
            return False
        self.awaited.discard(robot)
        self.rejoined.discard(robot)
        return True

    def take_startable(self) -> list[int]:
        """Return the awaited robots whose processes have ended since the last call, in ascending order."""
        startable = self.awaited & self._ended
        self._ended -= startable
        return sorted(startable)

    def complete(self) -> bool:
        """Return whether robots were awaited and all of them have rejoined; then none is awaited any more."""
        if not self.awaited or not self.awaited <= self.rejoined:
            return False
        self.awaited.clear()
        return True

    def take_rejoined(self) -> list[int]:
        """Return the robots that have rejoined since the last call, in ascending order."""
        rejoined = sorted(self.rejoined)
        self.rejoined.clear()
        return rejoined
