"""Compilation of hot loops.

A kernel has an explicit signature: it is compiled when its module is first imported, and from then on read
from numba's cache. `make setup` and the fork server import all of them in one process, so that robots never
compile. No fastmath: a kernel gives the same bits wherever the same versions run.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

_kernels: list[Any] = []


def kernel(signature: str) -> Callable[[Function], Function]:
    """Compile the decorated function for `signature` (numba's notation), or load it from the cache."""

    def compile_it(function: Function) -> Function:
        result: Function = numba.njit(signature, cache=True, error_model="numpy")(function)
        _kernels.append(result)
        return result

    return compile_it


def loaded() -> int:
    """How many kernels this process has read from the cache."""
    return sum(1 for each in _kernels if sum(each.stats.cache_hits.values()))


def compiled() -> int:
    """How many kernels this process had to compile."""
    return len(_kernels) - loaded()
