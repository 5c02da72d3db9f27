"""Writing of files: atomically, and with errors that name the file."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.ENOMEM)
"""Numbers of errors that another file name would not avoid."""


def write_whole(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file under a temporary name in the same directory, then rename it atomically.

    Raises OSError if the file cannot be written; the error names `path`, which stays unchanged.
    """
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with naming(path):
            with beside.open("wb") as file:
                write(file)
            beside.replace(path)
    finally:
        with contextlib.suppress(OSError):  # where nothing can be written, nothing can be removed
            beside.unlink(missing_ok=True)


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Make an OSError in this context name `path`: a failed write does not name its file."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
