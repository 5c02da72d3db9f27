"""Neighbors: the teammates of which this robot has received a frame recently, and those that have said farewell."""

from __future__ import annotations


class Neighbors:
    """Teammates that this robot received within the last `timeout` nanoseconds, and that have not ended since."""

    def __init__(self, timeout: int) -> None:
        self._timeout = timeout
        self._received: dict[int, int] = {}
        """When a frame of each teammate arrived last."""
        self._farewells: dict[int, int] = {}
        """The session that each teammate has ended by a farewell."""

    def received(self, robot: int, session: int, now: int) -> None:
        """Note that a frame of a teammate's session arrived; one of another session shows that it has started again."""
        if self._farewells.get(robot) != session:
            self._farewells.pop(robot, None)
            self._received[robot] = now

    def farewell(self, robot: int, session: int) -> None:
        """Note that a teammate has ended; frames of this session that arrive late do not change that."""
        self._farewells[robot] = session
        self._received.pop(robot, None)

    def ended(self) -> frozenset[int]:
        """Return the teammates that have ended, and have not started again."""
        return frozenset(self._farewells)

    def last(self, robot: int) -> int | None:
        """Return when a frame of a teammate arrived last; None if none did."""
        return self._received.get(robot)

    def current(self, now: int) -> list[int]:
        """Return the neighbors in ascending order."""
        return sorted(robot for robot, then in self._received.items() if now - then < self._timeout)
