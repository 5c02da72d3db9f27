"""What robots of one process would all work out alike, worked out once.

Teammates that hear the same words of a map read the same, and the same cells of its drawing change; those that have
the same planning grid find the same ways on it. Where each robot has a process of its own, it works that out for
itself; where all run in one, the first that comes to it does so for all. Nobody can tell by the results.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

Result = TypeVar("Result")

MOST = 4096
"""Results that are kept; when there are so many all are dropped, and who needs one again works it out again."""


class MemoCache:
    """Results by what they follow from; kept by one who shares them with others, never by one who is alone."""

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        self._known: dict[Hashable, Any] = {}

    def get(self, key: Hashable, work: Callable[[], Result]) -> Result:
        """Return what `work` gives, which `key` says all about; it is not to be written on."""
        if not self._most:
            return work()
        if key not in self._known:
            if len(self._known) >= self._most:
                self._known.clear()
            self._known[key] = work()
        result: Result = self._known[key]
        return result


NO_CACHE = MemoCache(0)
"""For a robot that has a process of its own."""
