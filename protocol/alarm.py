"""Wake-up times of a thread: it sleeps until a time, or until an earlier one that another thread has set."""

from __future__ import annotations

import math
import threading
import time


class Alarm:
    """Lets one thread sleep; all times are those of `time.monotonic`, in seconds."""

    def __init__(self) -> None:
        self._is_closed = False
        self._changed = threading.Condition()
        self._wakes = math.inf
        """The earliest time that is set; a time that is set while the thread is awake applies to its next sleep."""

    def set(self, at: float) -> None:
        """Wake the thread at `at`, unless it wakes up before."""
        if at < self._wakes:
            with self._changed:
                self._wakes = min(self._wakes, at)
                self._changed.notify()

    def close(self) -> None:
        """Wake the thread now, and let it sleep no more."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()

    def sleep(self, until: float) -> None:
        """Sleep until `until` or the earliest time that is set; at most until this alarm is closed."""
        with self._changed:
            self._wakes = min(self._wakes, until)
            while not self._is_closed and (left := self._wakes - time.monotonic()) > 0:
                self._changed.wait(min(left, threading.TIMEOUT_MAX))
            self._wakes = math.inf
