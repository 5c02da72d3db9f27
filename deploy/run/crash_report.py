"""Crash reports of processes and robots: the traceback from the first frame of user code, else the last output."""

from __future__ import annotations

import sysconfig
import traceback
from pathlib import Path
from types import TracebackType

from deploy.run.limits import out_of_memory
from protocol.plugins import PACKAGES, PluginError

HEAD = "Traceback (most recent call last):"

_HERE = Path(__file__).parents[2]
_OURS = tuple(f"{_HERE / package}/" for package in PACKAGES)
_PYTHON = f"{sysconfig.get_path('stdlib')}/"
_PACKAGES = ("/site-packages/", "/dist-packages/")


def traceback_of(error: BaseException) -> str:
    """Return the traceback of an exception, from the first frame outside Murmur and the standard library.

    Without such a frame, the traceback is complete. Without memory, and if a plug-in returned a wrong value, there is
    only a line that says so.
    """
    if isinstance(error, PluginError):
        return " ".join(str(error).split())
    if isinstance(error, MemoryError):
        return out_of_memory()
    frames: TracebackType | None = error.__traceback__
    while frames is not None and not _is_foreign(frames.tb_frame.f_code.co_filename):
        frames = frames.tb_next
    shown = frames or error.__traceback__
    return "".join(traceback.format_exception(type(error), error, shown)).rstrip()


def crash_report(log: str) -> str:
    """Return the traceback at the end of a process's output, else its last line; empty without output."""
    _, head, tail = log.rpartition(HEAD)
    if head:
        return (head + tail).rstrip()
    lines = [line.strip() for line in log.splitlines() if line.strip()]
    return lines[-1] if lines else ""


def _is_foreign(file: str) -> bool:
    if file.startswith(_OURS) or file.startswith("<frozen"):
        return False
    return not file.startswith(_PYTHON) or any(folder in file for folder in _PACKAGES)
