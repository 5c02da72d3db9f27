"""Watchdog for a killed launcher: its children end shortly after it, and the fork server removes its directory.

The fork server ends once the launcher and all children have ended. It listens in a directory of its own, which the
launcher removes, or the fork server itself, which imports this module.
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
from multiprocessing import util

LONGEST = 60
"""Maximum characters of the directory of a socket, whose path may have 107."""
FOLDER = "MURMUR_FORK_SERVER"
"""Environment variable with the fork server's directory, set for the fork server only."""
GRACE_S = 5.0
"""Time for a child to shut down after the end of its launcher."""


def open_folder() -> str:
    """Return the directory in which the fork server listens; its path is at most `LONGEST` characters long."""
    usual = tempfile.tempdir
    if len(tempfile.gettempdir()) > LONGEST:
        tempfile.tempdir = "/tmp"
    try:
        folder: str = util.get_temp_dir()
    finally:
        tempfile.tempdir = usual
    return folder


def end_with_launcher() -> None:
    """Kill this child shortly after its launcher has ended for any reason."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            time.sleep(GRACE_S)
            os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=watch, name="launcher", daemon=True).start()


if FOLDER in os.environ:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the fork server does so itself, but only after all imports
    atexit.register(shutil.rmtree, os.environ.pop(FOLDER), ignore_errors=True)
