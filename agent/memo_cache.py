"""Memoization of results that the robots of one process would all compute alike.

Robots that decode the same entries get the same map, and robots with the same planning grid find the same ways. If each
robot has its own process, each computes these results. In a common process the first robot computes them for all. The
results do not change.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

Result = TypeVar("Result")

CAPACITY = 4096
"""Default capacity; a full cache drops all results."""


class MemoCache:
    """Memo table of so many results, shared by the robots of a process; 0 disables it, for single-robot processes."""

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._capacity = capacity
        self._known: dict[Hashable, Any] = {}

    def get(self, key: Hashable, work: Callable[[], Result]) -> Result:
        """Return `work()`, which depends on `key` alone; callers must not modify the result."""
        if not self._capacity:
            return work()
        if key not in self._known:
            if len(self._known) >= self._capacity:
                self._known.clear()
            self._known[key] = work()
        result: Result = self._known[key]
        return result


NO_CACHE = MemoCache(0)
"""The disabled cache of a robot with its own process."""
