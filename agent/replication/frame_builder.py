"""A frame under construction, which respects the byte budget.

The medium carries whole packets of it from the beginning. A sender parses the part that was on the air as receivers do
(`control_packets.parse`).
"""

from __future__ import annotations

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

    def add(self, packet: bytes) -> None:
        """Add a packet if it fits."""
        if len(self.payload) + len(packet) <= self.budget:
            self.payload += packet

    def add_entries(self, log: Log, first: int, header: bytes, end: int | None = None) -> int:
        """Add entries from `first` on, before `end`, behind a header, as many as fit; return the offset after the last.

        A header that no entry fits behind is left out.
        """
        entries = log.read(first, self.budget - len(self.payload) - len(header), end)
        if not entries:
            return first
        self.payload += header + entries
        self.has_entries = True
        return log.offset_after(first, len(entries))
