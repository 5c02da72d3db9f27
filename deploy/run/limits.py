"""The system's limits on memory and open files, checked before a run starts.

This module imports nothing large, because importing Murmur's libraries fails with too little memory.
"""

from __future__ import annotations

import contextlib
import math
import resource
from collections.abc import Iterator

MEMORY_BYTES = 3 << 29
"""Address space that a process needs: a launcher with all libraries, and a margin for the run."""
DATA_BYTES = 1 << 29
"""Of these, data (without the code of libraries)."""
FILES, FILES_PER_ROBOT = 40, 2
"""Open files that the launcher needs, and more for each robot; all other processes need fewer."""

_MEMORY_LIMITS = {
    "address space (ulimit -v)": (resource.RLIMIT_AS, MEMORY_BYTES),
    "data of a process (ulimit -d)": (resource.RLIMIT_DATA, DATA_BYTES),
}


def check_memory() -> None:
    """Raise ValueError if a limit on memory is lower than what any command needs."""
    for name, (number, needed) in _MEMORY_LIMITS.items():
        if (limit := soft_limit(number)) < needed:
            raise ValueError(f"{name}: the limit is {_mb(limit)}; it must be {_mb(needed)} or more")


def soft_limit(number: int) -> float:
    """Return a limit of this process; infinite if there is none."""
    limit = resource.getrlimit(number)[0]
    return math.inf if limit == resource.RLIM_INFINITY else limit


def check_files(robots: int) -> None:
    """Raise the limit on open files to what a run with `robots` processes needs; ValueError if that is not allowed."""
    needed = FILES + FILES_PER_ROBOT * robots
    limit, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    if resource.RLIM_INFINITY in (limit, most) or limit >= needed:
        return
    if most < needed:
        of = f"a run of {robots} robots as processes" if robots else "a run"
        raise ValueError(f"open files (ulimit -n): the limit is {most}; {of} needs {needed} or more")
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, most))


@contextlib.contextmanager
def importing() -> Iterator[None]:
    """Raise ValueError for an import that fails in this context for want of memory."""
    try:
        yield
    except (ImportError, MemoryError):
        if not _low():
            raise
        raise ValueError(out_of_memory()) from None


def out_of_memory() -> str:
    """Return the error text for a process that has no memory left, with the limits that are set."""
    return "out of memory" + (
        f": {_low()}; raise or remove this limit, or use fewer robots" if _low() else ""
    )


def _low() -> str:
    limits = {name: soft_limit(number) for name, (number, _) in _MEMORY_LIMITS.items()}
    return ", ".join(
        f"the limit on {name} is {_mb(limit)}" for name, limit in limits.items() if limit < math.inf
    )


def _mb(size: float) -> str:
    return f"{size / 1e6:.0f} MB"
