"""Robots that run on this host: a lock in the record directory of each, and the request to stop.

    robot.lock   locked while a robot records there
    stop         the request; the robot looks for it several times per second, and removes it

A further directory, of this user only, names the record directories of all robots, for `murmur stop --all`.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import shlex
import time
from collections.abc import Iterator
from pathlib import Path

from deploy.scenario.errors import ScenarioError
from protocol.temporary import system_folder

LOCK, STOP = "robot.lock", "stop"
POLL_S = 0.1


def registry() -> Path:
    """Return the directory that names the robots of this user; ScenarioError if it is not one of this user."""
    folder = Path(system_folder()) / f"murmur-robots-{os.getuid()}"
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    status = folder.lstat()
    if status.st_uid != os.getuid() or not folder.is_dir() or folder.is_symlink():
        raise ScenarioError(f"{folder} is not a directory of this user: remove it")
    return folder


@contextlib.contextmanager
def running(folder: Path) -> Iterator[Path]:
    """Lock a record directory for a robot; return the file whose existence asks the robot to stop.

    ScenarioError if another robot runs there, or the directory cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise ScenarioError(f"record.folder = {str(folder)!r}: {reason}; name a directory") from None
    with _locked(folder, tries=5) as is_free:  # `is_running` of another process holds the lock for a moment
        if not is_free:
            stop_it = f"murmur stop {shlex.quote(str(folder))}"
            raise ScenarioError(f"record.folder = {folder}: a robot runs there already; {stop_it}")
        entry = registry() / hashlib.sha256(os.fsencode(folder.resolve())).hexdigest()[:16]
        entry.write_text(f"{folder.resolve()}\n", encoding="utf-8")
        stop = folder / STOP
        stop.unlink(missing_ok=True)
        try:
            yield stop
        finally:
            stop.unlink(missing_ok=True)
            entry.unlink(missing_ok=True)


def robots() -> list[Path]:
    """Return the record directories of this user's robots that run on this host; those of killed ones are forgotten."""
    found = []
    for entry in sorted(registry().iterdir()):
        try:
            name = entry.read_text(encoding="utf-8").rstrip("\n")
        except FileNotFoundError:  # its robot has ended since
            continue
        if is_running(Path(name)):
            found.append(Path(name))
        elif name:  # else its robot is about to write it
            entry.unlink(missing_ok=True)
    return found


def is_running(folder: Path) -> bool:
    """Return whether a robot runs in a record directory."""
    if not (folder / LOCK).exists():
        return False
    with _locked(folder) as is_free:
        return not is_free


def ask_to_stop(folder: Path) -> None:
    """Ask the robot in a record directory to stop; ScenarioError if no robot runs there."""
    if not is_running(folder):
        raise ScenarioError(f"{folder}: no robot runs there; murmur stop --all stops all robots on this host")
    (folder / STOP).touch()


def has_ended(folder: Path, timeout_s: float) -> bool:
    """Wait until no robot runs in a record directory; return False if one still does after `timeout_s`."""
    end = time.monotonic() + timeout_s
    while is_running(folder):
        if time.monotonic() >= end:
            return False
        time.sleep(POLL_S)
    return True


@contextlib.contextmanager
def _locked(folder: Path, tries: int = 1) -> Iterator[bool]:
    """Try to lock a record directory in this context; return whether that was possible."""
    lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
    try:
        yield _lock(lock, tries)
    finally:
        os.close(lock)


def _lock(file: int, tries: int) -> bool:
    for _ in range(tries):
        with contextlib.suppress(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        time.sleep(POLL_S / 2)
    return False
