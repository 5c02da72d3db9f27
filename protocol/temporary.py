"""Temporary directories that do not accumulate: to create one also removes those of processes that were killed.

Each process holds a lock on its directories, which the system releases when the process ends for any reason.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

PREFIX = "murmur-tmp-"


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """Make a directory, and remove it at the end of this context."""
    folder, lock = make_folder()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def system_folder() -> str:
    """Return the system's directory for temporary files; ValueError if there is none that can be written."""
    try:
        return tempfile.gettempdir()
    except FileNotFoundError:
        raise ValueError(
            "no directory for temporary files can be written: set the environment variable TMPDIR to one that can"
        ) from None


def make_folder(parent: str | None = None) -> tuple[Path, int]:
    """Make a directory in `parent`, by default the system's; return it, and the file that locks it while it is open.

    ValueError if there is no directory for temporary files.
    """
    parent = parent or system_folder()
    _remove_abandoned(Path(parent))
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
        with contextlib.suppress(FileNotFoundError):
            lock = os.open(folder, os.O_RDONLY)
            fcntl.flock(lock, fcntl.LOCK_EX)
            if folder.exists():  # else another process has removed it before it was locked
                return folder, lock
            os.close(lock)


def _remove_abandoned(parent: Path) -> None:
    """Remove the directories in `parent` that no process holds."""
    for folder in parent.glob(f"{PREFIX}*"):
        if re.fullmatch(f"{PREFIX}[a-z0-9_]{{8}}", folder.name) is None:
            continue
        with contextlib.suppress(OSError):
            lock = os.open(folder, os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(lock)
