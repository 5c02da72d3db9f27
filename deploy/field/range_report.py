"""Lines for the user of a robot: which teammates it receives, and whether its radio accepts its frames."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from protocol.nanoseconds import SECOND

UNSENT = 3
"""Frames that the radio has not accepted, before the user is warned: the buffer of a modem may sometimes be full."""


class RangeReport:
    """Lines about the radio of a robot; without them, a robot that receives nothing looks like any other.

    `teammates`: number of teammates. `timeout`: how long a teammate counts as in range. `began`: when the robot began.
    All times are in nanoseconds.
    """

    def __init__(self, teammates: int, timeout: int, began: int) -> None:
        self._teammates, self._timeout, self._began = teammates, timeout, began
        self._shown: tuple[list[int], list[int]] = [], []
        """The teammates in range, and those that have ended, in the last line."""
        self._says_alone = False
        self._has_received = False
        self._has_failed = False

    def new(self, in_range: Collection[int], ended: Collection[int], unsent: int, now: int) -> Iterator[str]:
        """Yield a line for each change; `unsent` counts the frames that the radio has not accepted since the start."""
        self._has_received |= bool(in_range or ended)
        state = sorted(in_range), sorted(ended)
        is_alone = not in_range and len(ended) < self._teammates and now - self._began >= self._timeout
        if state != self._shown or (is_alone and not self._says_alone):
            yield self._text(*state, is_alone=is_alone)
            self._shown = state
        self._says_alone = is_alone
        if unsent >= UNSENT and not self._has_failed:
            self._has_failed = True
            yield f"the radio has not accepted {unsent} frames: is the interface up, or the modem connected?"

    def _text(self, in_range: list[int], ended: list[int], *, is_alone: bool) -> str:
        text = f"teammates in range: {_robots(in_range) if in_range else 'none'}"
        if ended:
            text += f"; ended: {_robots(ended)}"
        if is_alone:
            seconds = f"{self._timeout / SECOND:.3g} s"
            text += f"; this robot has accepted no frame for {seconds}, and explores alone"
            text += "" if self._has_received else ": compare [radio] and the keys of all robots"
        return text


def _robots(numbers: list[int]) -> str:
    return f"robot{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"
