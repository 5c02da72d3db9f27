"""What a process, or a robot in memory, said last before it died: the user's own traceback, where there is one."""

from __future__ import annotations

import sysconfig
import traceback
from pathlib import Path
from types import TracebackType

HEAD = "Traceback (most recent call last):"

_HERE = Path(__file__).parents[2]
_OURS = tuple(f"{_HERE / room}/" for room in ("agent", "deploy", "netshaper", "protocol", "worldsim"))
_PYTHON = f"{sysconfig.get_path('stdlib')}/"
_PACKAGES = ("/site-packages/", "/dist-packages/")


def traceback_of(error: BaseException) -> str:
    """The traceback of an exception, from the first frame that is neither ours nor Python's own.

    All of it, if there is no such frame.
    """
    frames: TracebackType | None = error.__traceback__
    while frames is not None and not _is_foreign(frames.tb_frame.f_code.co_filename):
        frames = frames.tb_next
    shown = frames or error.__traceback__
    return "".join(traceback.format_exception(type(error), error, shown)).rstrip()


def crash_report(log: str) -> str:
    """The traceback with which a process's output ends, else its last line; empty if it said nothing."""
    _, head, tail = log.rpartition(HEAD)
    if head:
        return (head + tail).rstrip()
    said = [line.strip() for line in log.splitlines() if line.strip()]
    return said[-1] if said else ""


def _is_foreign(file: str) -> bool:
    if file.startswith(_OURS) or file.startswith("<frozen"):
        return False
    return not file.startswith(_PYTHON) or any(packages in file for packages in _PACKAGES)
