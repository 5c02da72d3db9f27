"""Neighbors: the teammates of which this robot has received a frame recently."""

from __future__ import annotations


class Neighbors:
    """Teammates that this robot received within the last `timeout` nanoseconds."""

    def __init__(self, timeout: int) -> None:
        self._timeout = timeout
        self._received: dict[int, int] = {}
        """When a frame of each teammate arrived last."""

    def received(self, robot: int, now: int) -> None:
        """Note that a frame of a teammate arrived."""
        self._received[robot] = now

    def last(self, robot: int) -> int | None:
        """Return when a frame of a teammate arrived last; None if none did."""
        return self._received.get(robot)

    def current(self, now: int) -> list[int]:
        """Return the neighbors in ascending order."""
        return sorted(robot for robot, then in self._received.items() if now - then < self._timeout)
