"""Signals that end a process, and their handlers within a context."""

from __future__ import annotations

import _thread
import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from types import FrameType

AGAIN_S = 0.02
"""Time after which a signal that came during an import is sent again."""


def ending_signals() -> list[signal.Signals]:
    """Return the signals that end a run: Ctrl-C, SIGTERM, and SIGHUP unless the user has it ignored (nohup)."""
    ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if ignored else [signal.SIGHUP])]


@contextlib.contextmanager
def handled(numbers: Iterable[int], handler: Callable[..., object]) -> Iterator[None]:
    """Let `handler` handle signals within the context; ValueError outside the main thread."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def is_importing(frame: FrameType | None) -> bool:
    """Return whether an import is going on at `frame`. It would print or replace an exception of a signal handler."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def send_again(number: int) -> None:
    """Send a signal to this process again after `AGAIN_S`; handlers may call this at any time."""

    def wait_and_send() -> None:
        time.sleep(AGAIN_S)
        os.kill(os.getpid(), number)

    _thread.start_new_thread(wait_and_send, ())  # it takes no lock, which the interrupted code may hold


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Hold back the signals that end a run: they take effect at the end of the context (main thread only).

    An error within the context replaces them.
    """
    came: list[int] = []
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ValueError):  # other threads handle no signals
            stack.enter_context(handled(ending_signals(), lambda number, _: came.append(number)))
        yield
    for number in dict.fromkeys(came):
        signal.raise_signal(number)
