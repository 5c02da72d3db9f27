"""A frame under construction: it respects the byte budget and keeps a handler for each part.

The relay carries a prefix of whole packets and reports its length. `FrameBuilder.sent` then runs the handlers of all
parts that were on the air, so each part updates the tables that it concerns.
"""

from __future__ import annotations

from collections.abc import Callable

from agent.replication.log import Log
from protocol.message_fields import MAX_LOAD


def limited(budget: int | None) -> int:
    """Return how many bytes of entries a robot sends in a phase with this budget (None: unlimited)."""
    return MAX_LOAD if budget is None else min(budget, MAX_LOAD)


class FrameBuilder:
    """One frame to one receiver, or to all robots in range, of `budget` bytes at most (`limited`)."""

    def __init__(self, budget: int | None = None) -> None:
        self.budget = limited(budget)
        self.payload = b""
        self.has_entries = False
        """Whether the frame holds log entries."""
        self._handlers: list[Callable[[int], object]] = []
        """Called with the number of bytes that were on the air."""

    def fits(self, packet: bytes) -> bool:
        """Return whether the budget has room for a packet."""
        return len(self.payload) + len(packet) <= self.budget

    def add(self, packet: bytes, on_sent: Callable[[], None]) -> int:
        """Add a packet; return where it ends."""
        self.payload += packet
        self.add_marker(len(self.payload), on_sent)
        return len(self.payload)

    def add_marker(self, end: int, on_sent: Callable[[], None]) -> None:
        """Call a handler if the first `end` bytes of the frame were sent."""
        self._handlers.append(lambda size: on_sent() if end <= size else None)

    def add_entries(
        self, log: Log, first: int, header: bytes, on_sent: Callable[[int, int], None], end: int | None = None
    ) -> int:
        """Add entries from `first` on, before `end`, behind a header, as many as fit; return the offset after the last.

        A header that no entry fits behind is left out. The handler receives the first offset, and the offset after the
        last entry that was on the air.
        """
        begin = len(self.payload) + len(header)
        entries = log.read(first, self.budget - begin, end)
        if not entries:
            return first

        def note(size: int) -> None:
            reached = log.offset_after(first, min(size - begin, len(entries)))
            if reached > first:
                on_sent(first, reached)

        self.payload += header + entries
        self.has_entries = True
        self._handlers.append(note)
        return log.offset_after(first, len(entries))

    def sent(self, size: int) -> None:
        """Run the handlers of all parts within the first `size` bytes, which were on the air."""
        for handler in self._handlers:
            handler(size)
