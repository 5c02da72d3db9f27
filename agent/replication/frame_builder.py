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
        self._markers: list[tuple[int, Callable[[], None]]] = []
        self._ranges: list[tuple[int, int, Log, int, Callable[[int, int], None]]] = []

    @property
    def has_entries(self) -> bool:
        """Whether the frame holds log entries."""
        return bool(self._ranges)

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
        self._markers.append((end, on_sent))

    def add_entries(
        self, log: Log, first: int, end: int, header: bytes, on_sent: Callable[[int, int], None]
    ) -> int:
        """Add entries `first` to `end` - 1 behind a header, as many as fit; return the offset after the last.

        A header that no entry fits behind is left out. The handler receives the first offset, and the offset after the
        last entry that was on the air.
        """
        begin = len(self.payload) + len(header)
        entries = log.read(first, self.budget - begin, end) if first < end else b""
        if not entries:
            return first
        self.payload += header + entries
        self._ranges.append((begin, len(self.payload), log, first, on_sent))
        return log.offset_after(first, len(entries))

    def sent(self, size: int) -> None:
        """Run the handlers of all parts within the first `size` bytes, which were on the air."""
        for end, on_sent in self._markers:
            if end <= size:
                on_sent()
        for begin, end, log, first, on_entries_sent in self._ranges:
            if begin < size and (reached := log.offset_after(first, min(size, end) - begin)) > first:
                on_entries_sent(first, reached)
