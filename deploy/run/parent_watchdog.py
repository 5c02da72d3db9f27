"""Watchdog for a killed parent: its children end shortly after it, and the fork server removes its directory.

The fork server ends once the launcher and all children have ended. It listens in a temporary directory, which the
launcher removes, or, if the launcher was killed, the fork server, which imports this module.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import shutil
import signal
import tempfile
import threading
import time
from functools import cache
from multiprocessing import util

from protocol.temporary import make_folder, system_folder

LONGEST = 45
"""Maximum characters of the system's temporary directory: the path of a socket in it may have 107."""
USUAL = "/tmp"
"""Used instead of a longer one."""
FOLDER = "MURMUR_FORK_SERVER"
"""Environment variable with the launcher's process number and directory, set for the fork server only."""
GRACE_S = 5.0
"""Time for a child of a run to shut down after the end of its launcher."""


@cache
def open_folder() -> str:
    """Return the directory in whose subdirectory the fork server listens; this process holds it until it ends.

    ValueError if there is no such directory.
    """
    parent = system_folder()
    try:
        folder, _ = make_folder(parent if len(parent) <= LONGEST else USUAL)
    except OSError as error:
        if len(parent) <= LONGEST:
            raise
        raise ValueError(
            f"TMPDIR = {parent}: has more than {LONGEST} characters, too many for sockets in it, and {USUAL} cannot be "
            f"written ({error.strerror}): name a shorter directory"
        ) from None
    # After multiprocessing has removed its subdirectory, with priority -100.
    util.Finalize(None, shutil.rmtree, args=(folder,), kwargs={"ignore_errors": True}, exitpriority=-200)
    usual, tempfile.tempdir = tempfile.tempdir, str(folder)
    try:
        util.get_temp_dir()
    finally:
        tempfile.tempdir = usual
    return str(folder)


def _remove_folder(launcher: str, folder: str) -> None:
    """Remove the directory of a launcher that has ended (in the fork server)."""
    if os.getppid() != int(launcher):
        shutil.rmtree(folder, ignore_errors=True)


def end_with_parent(grace_s: float) -> None:
    """Kill this child `grace_s` seconds after its parent has ended for any reason."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        time.sleep(grace_s)
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=watch, name="parent", daemon=True).start()


if FOLDER in os.environ:
    for number in (signal.SIGINT, signal.SIGHUP):  # before all other imports, which take a while
        signal.signal(number, signal.SIG_IGN)
    atexit.register(_remove_folder, *os.environ.pop(FOLDER).split(":", 1))
