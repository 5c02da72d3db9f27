"""Ctrl-C and SIGTERM end a run early without losing data."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator

from deploy.record.records import RecorderNode

REASON = "interrupted"


@contextlib.contextmanager
def sigterm_as_ctrl_c() -> Iterator[None]:
    """Make SIGTERM raise KeyboardInterrupt, so that resources are released (main thread only)."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


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
        """Treat Ctrl-C and SIGTERM as requests to end the run (main thread only)."""
        before = {}
        try:
            for number in (signal.SIGINT, signal.SIGTERM):
                before[number] = signal.signal(number, self._come)
        except ValueError:
            before = {}  # only the main thread handles signals
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def heed(self, recorder: RecorderNode) -> bool:
        """Ask the world to end after this step if that was requested; return whether it was."""
        if self.came and not self._heeded and not recorder.done:
            self._heeded = True
            self._notify("ending after this step; writing the run directory")
            recorder.stop(REASON)
        return self.came

    def _come(self, *_: object) -> None:
        self.came = True
        self._then()
