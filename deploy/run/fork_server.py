"""The fork server of this process, which starts the processes of runs and of studies.

A process that starts threads, as polars does, must not fork: a lock that another thread holds stays locked in the
child. The fork server has no threads. It loads the code and the kernels once, and its children share that memory.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import types
from collections.abc import Iterator
from multiprocessing import forkserver, resource_tracker
from multiprocessing.context import ForkServerContext
from pathlib import Path

from deploy.run import parent_watchdog

PRELOADED = ["deploy.run.parent_watchdog", "deploy.run.preload"]
_IGNORED = (signal.SIGINT, signal.SIGHUP)
_LOCK = threading.Lock()
"""Held while children start: threads may have studies of their own."""
_IMPORTED_BY = os.getpid()


def context() -> ForkServerContext:
    """Return the context that makes children of the fork server; they start within `starting`."""
    made = multiprocessing.get_context("forkserver")
    made.set_forkserver_preload(PRELOADED)
    return made


def check_process() -> None:
    """Raise ValueError if this process may not have children.

    In a process that was forked from one with threads of Zenoh or polars, these libraries would wait forever.
    """
    if multiprocessing.current_process().daemon:
        reason = "a worker of multiprocessing.Pool may not start processes"
    elif pid() is not None and os.getpid() != _IMPORTED_BY:
        reason = "this process was forked from one in which runs had processes, so it may not start any"
    else:
        return
    raise ValueError(
        f"{reason}: use concurrent.futures.ProcessPoolExecutor with mp_context=multiprocessing.get_context('spawn'), "
        "or, for a single run, bus = 'memory'"
    )


@contextlib.contextmanager
def starting() -> Iterator[None]:
    """Start the fork server if it is not running. Within, children can be started; they do not import the main module.

    Raises FileNotFoundError if the current directory, which children share, has been deleted.
    """
    with _LOCK:
        try:
            Path.cwd()
        except FileNotFoundError as error:
            raise FileNotFoundError(
                error.errno, "the current directory has been deleted; change to another one"
            ) from None
        main = sys.modules["__main__"]
        sys.modules["__main__"] = types.ModuleType("__main__")
        try:
            _ensure_running()
            yield
        finally:
            sys.modules["__main__"] = main


def _ensure_running() -> None:
    """Start the fork server and Python's resource tracker, if they are not running.

    Ctrl-C and SIGHUP are blocked in both from the start. If one of these signals ended the tracker, a new one would not
    know the semaphores of the pools.
    """
    os.environ[parent_watchdog.FOLDER] = f"{os.getpid()}:{parent_watchdog.open_folder()}"
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, _IGNORED)
    try:
        resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, _IGNORED)  # starting the tracker unblocks Ctrl-C
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        del os.environ[parent_watchdog.FOLDER]


def pid() -> int | None:
    """Return the number of the fork server's process; None before it has started."""
    number: int | None = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
    return number
