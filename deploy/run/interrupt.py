"""Ctrl-C and SIGTERM: they end a run early without losing data."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator

from deploy.record.records import RecorderNode

REASON = "interrupted"


@contextlib.contextmanager
def sigterm_as_ctrl_c() -> Iterator[None]:
    """Have SIGTERM raise what Ctrl-C does, so that what was opened is closed (in the main thread)."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class Interrupt:
    """A request to end a run early.

    Parameters
    ----------
    tell : callable, optional
        Called once when the request takes effect, since the end takes a while.
    then : callable, optional
        Called whenever it comes: a run that is paused has to go on to its end.
    """

    def __init__(
        self, tell: Callable[[str], object] = lambda _: None, then: Callable[[], object] = lambda: None
    ) -> None:
        self._then = then
        self._came = False
        self._heeded = False
        self._tell = tell

    @property
    def came(self) -> bool:
        """Whether it was requested."""
        return self._came

    @contextlib.contextmanager
    def caught(self) -> Iterator[None]:
        """Treat Ctrl-C and SIGTERM as that request instead of being killed by them (in the main thread)."""
        before = {}
        try:
            for number in (signal.SIGINT, signal.SIGTERM):
                before[number] = signal.signal(number, self._come)
        except ValueError:
            before = {}  # not the main thread, which handles signals
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def heed(self, recorder: RecorderNode) -> bool:
        """Have the run ended after this step if that was requested; return whether it was."""
        if self._came and not self._heeded and not recorder.done:
            self._heeded = True
            self._tell("ending after this step; writing the run directory")
            recorder.stop(REASON)
        return self._came

    def _come(self, *_: object) -> None:
        self._came = True
        self._then()
