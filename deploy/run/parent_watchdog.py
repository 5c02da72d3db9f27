"""What a launcher leaves that is killed: nothing. Its children end a little later, and the last folder goes with them.

The fork server ends once launcher and children are gone; it listens in a folder of its own, which the launcher removes
or else, having imported this module, the fork server itself.
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
"""Characters of a folder in which sockets can be: a socket's path may have 107."""
FOLDER = "MURMUR_FORK_SERVER"
"""The variable that says to the fork server, and to it alone, which folder is its own."""
GRACE_S = 5.0
"""How long a child goes on without its launcher: it may be told to go home, and a viewer writes what it has."""


def open_folder() -> str:
    """Where the fork server of this process listens; a short name even if that of the temporary directory is long."""
    usual = tempfile.tempdir
    if len(tempfile.gettempdir()) > LONGEST:
        tempfile.tempdir = "/tmp"
    try:
        folder: str = util.get_temp_dir()
    finally:
        tempfile.tempdir = usual
    return folder


def end_with_launcher() -> None:
    """Have this child killed soon after its launcher has ended, however that ends."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            time.sleep(GRACE_S)
            os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=watch, name="launcher", daemon=True).start()


if FOLDER in os.environ:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it would itself, but only when it has imported everything
    atexit.register(shutil.rmtree, os.environ.pop(FOLDER), ignore_errors=True)
