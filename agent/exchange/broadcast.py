"""A broadcast of gossip as it is put together: reports first, then stretches of logs, as far as there is room.

What is carried of it is a run of whole packets from its beginning; so each part knows where it ends.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from agent.exchange.log import Log
from protocol import packets


@dataclass
class Stretch:
    """Units of a map's log in a broadcast, from number `first` on, and where they begin and end, in bytes."""

    map: int
    first: int
    begin: int
    end: int


@dataclass
class Broadcast:
    """What one says in an exchange."""

    room: int | None = None
    """Bytes that it may have, None for no limit."""
    payload: bytes = b""
    near: list[tuple[int, int, bool]] = field(default_factory=list)
    """Each report of who has come, or left: where it ends, in bytes, who, and whether it is here."""
    held: list[tuple[int, int]] = field(default_factory=list)
    """Each report of what one holds: where it ends, and of which map."""
    met: set[int] = field(default_factory=set)
    """Whom they are for that have come into range."""
    stretches: list[Stretch] = field(default_factory=list)
    spoken: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Of each map from which unit on, and up to which."""

    def report(self, packet: packets.Packet) -> int | None:
        """Add a report, if there is room; return where it ends."""
        report = packets.encode([packet])
        if self.room is not None and len(self.payload) + len(report) > self.room:
            return None
        self.payload += report
        return len(self.payload)

    def stretch(self, map_id: int, log: Log, first: int, end: int, head: bytes) -> int:
        """Add units `first` to `end` - 1 of a map's log behind `head`, as far as there is room; return up to which."""
        left = None if self.room is None else self.room - len(self.payload) - len(head)
        units = log.since(first, left, end) if first < end else b""
        if not units:
            return first
        self.payload += head
        begin = len(self.payload)
        self.payload += units
        self.stretches.append(Stretch(map_id, first, begin, len(self.payload)))
        end = log.reached(first, len(units))
        low, high = self.spoken.get(map_id, (first, end))
        self.spoken[map_id] = min(low, first), max(high, end)
        return end
