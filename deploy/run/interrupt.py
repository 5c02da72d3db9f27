"""Ctrl-C, SIGTERM, and the loss of the terminal (SIGHUP) end a run early without losing data."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Callable, Iterator
from types import FrameType

from deploy.record.records import RecorderNode
from protocol.signals import ending_signals, handled, is_importing, send_again

REASON = "interrupted"


def _leave_lost_terminal() -> None:
    """Discard input and output of a terminal that is gone: writing to it would raise errors."""
    for file in range(3):
        with contextlib.suppress(OSError):
            if stat.S_ISCHR(os.fstat(file).st_mode) and not os.isatty(file):
                null = os.open(os.devnull, os.O_RDWR)
                os.dup2(null, file)
                os.close(null)


@contextlib.contextmanager
def signals_as_ctrl_c() -> Iterator[None]:
    """Make Ctrl-C, SIGTERM and SIGHUP raise KeyboardInterrupt, so that resources are released (main thread only).

    During an import, they take effect at its end.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        _leave_lost_terminal()
        if is_importing(frame):
            send_again(number)
        else:
            raise KeyboardInterrupt

    with handled(ending_signals(), interrupt):
        yield


class Interrupt:
    """A request to end a run early.

    `notify` is called once with a message when the request takes effect, since the end takes a while. `then` is called
    at each request; a paused run must continue to its end.
    """

    def __init__(
        self, notify: Callable[[str], object] = lambda _: None, then: Callable[[], object] = lambda: None
    ) -> None:
        self.came = False
        """Whether the end was requested."""
        self._then = then
        self._heeded = False
        self._notify = notify

    @contextlib.contextmanager
    def caught(self) -> Iterator[None]:
        """Treat Ctrl-C, SIGTERM and SIGHUP as requests to end the run (main thread only)."""
        with contextlib.ExitStack() as stack:
            with contextlib.suppress(ValueError):  # only the main thread handles signals
                stack.enter_context(handled(ending_signals(), self._come))
            yield

    def heed(self, recorder: RecorderNode) -> bool:
        """Ask the world to end after this step if that was requested; return whether it was."""
        if self.came and not self._heeded and not recorder.done:
            self._heeded = True
            self._notify("ending after this step; writing the run directory")
            recorder.stop(REASON)
        return self.came

    def _come(self, *_: object) -> None:
        self.came = True
        _leave_lost_terminal()
        self._then()
