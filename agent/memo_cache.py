"""Memoization of results that the robots of one process would all compute alike.

Robots that decode the same entries get the same map, and robots with the same planning grid find the same ways. If each
robot has its own process, each computes these results. In a common process the first robot computes them for all. The
results do not change.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

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


class Content:
    """The content of contiguous uint8 arrays, as a part of a key: equal for equal arrays.

    Its hash is a sum of 64-bit words, which takes a tenth of the time of Python's hash of all bytes.
    """

    def __init__(self, *arrays: NDArray[np.uint8]) -> None:
        self._arrays = tuple((array.shape, array.tobytes()) for array in arrays)
        flat = [array.reshape(-1) for array in arrays]
        sums = [each[: each.size & ~7].view(np.uint64).sum() for each in flat]
        self._hash = hash(tuple(map(int, sums)))

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Content) and self._arrays == other._arrays


NO_CACHE = MemoCache(0)
"""The disabled cache of a robot with its own process."""
