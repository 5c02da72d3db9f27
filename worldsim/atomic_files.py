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

    If `path` is a symbolic link, the file that it leads to is written, and the link remains.

    Raises OSError if the file cannot be written; the error names `path`, which stays unchanged.
    """
    file_path = link_target(path)
    beside = file_path.with_name(f".{file_path.name}.{os.getpid()}")
    try:
        with naming(path):
            with beside.open("wb") as file:
                write(file)
            beside.replace(file_path)
    finally:
        with contextlib.suppress(OSError):  # where nothing can be written, nothing can be removed
            beside.unlink(missing_ok=True)


def link_target(path: Path) -> Path:
    """Return the file that a symbolic link leads to, which need not exist, or `path` itself if it is no link.

    Raises OSError if the links form a loop.
    """
    if not path.is_symlink():
        return path
    target = Path(os.path.realpath(path))
    if target.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    return target


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Make an OSError in this context name `path`: a failed write does not name its file."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
