"""Input files: regular files of a bounded size. Pipes and devices may be endless, or never answer."""

from __future__ import annotations

import errno
import os
import shlex
import stat
from io import BufferedReader
from pathlib import Path

MAX_BYTES = 2**26
"""Maximum size of a file that is read whole."""

_KINDS = (
    (stat.S_ISFIFO, "pipe"),
    (stat.S_ISSOCK, "socket"),
    (stat.S_ISCHR, "device"),
    (stat.S_ISBLK, "device"),
)


def check_regular(path: Path) -> None:
    """Raise OSError if `path` does not exist, or is a directory, pipe, socket or device."""
    try:
        mode = path.stat().st_mode
    except ValueError as error:  # a null character
        raise OSError(errno.EINVAL, str(error), str(path)) from None
    if stat.S_ISDIR(mode):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    for is_kind, kind in _KINDS:
        if is_kind(mode):
            raise OSError(errno.EINVAL, f"is a {kind}, not a file", str(path))


def exposure(path: Path, mode: int | None = None, what: str = "it") -> str:
    """Return a warning that other users may use a secret file, with the command that changes this.

    Empty if only the owner may, or if there is no such file. `mode`: the file's mode, if the caller has opened the file
    already. `what`: the name of the secret in the warning.
    """
    if mode is None:
        try:
            mode = path.stat().st_mode
        except (OSError, ValueError):
            return ""
    if not mode & 0o077:
        return ""
    change = f"chmod 600 {shlex.quote(str(path))}"
    return f"{path} has mode {mode & 0o777:03o}, so other users may use {what}: {change}"


def open_file(path: Path) -> BufferedReader:
    """Open a regular file for reading; OSError for anything else."""
    check_regular(path)
    return path.open("rb")


def read_file(path: Path) -> bytes:
    """Read a regular file of at most `MAX_BYTES`; OSError for anything else."""
    with open_file(path) as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise OSError(errno.EINVAL, f"is larger than {MAX_BYTES >> 20} MiB", str(path))
    return data
