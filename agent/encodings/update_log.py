"""Updates of the predictive encoding, reassembled from the packets of one log.

An update consists of one or more packets. The last of them holds the number of the update. An update without content
withdraws the one before it; further ones withdraw earlier updates, one each.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from protocol.errors import ProtocolError
from protocol.packet_codec import decode_kind
from protocol.packet_index import cache_short
from protocol.packets import UPDATE_NUMBERS, Update


class Reading(NamedTuple):
    """What the next packets of a log change in it (`UpdateLog.read`)."""

    kept: int
    """How many of the complete updates remain; the last ones are withdrawn."""
    new: list[tuple[bytes, int]]
    """Updates that are complete now, each with the number of packets up to its end."""
    fragments: bytes
    packets: int
    updates: int


class UpdateLog:
    """The updates of one log: the content of the next one so far, and complete ones that have not been withdrawn."""

    def __init__(self) -> None:
        self.messages: list[bytes] = []
        """The complete updates; the last ones may await decoding. Not used for this robot's own log."""
        self.ends: list[int] = []
        """Packets up to the end of each complete update, from the beginning of the log."""
        self.packets = 0
        self.updates = 0
        """Number of complete updates, with those withdrawn and those that withdraw them."""
        self.error = ""
        """Why an update could not be decoded; none behind it can be decoded then."""
        self.refused = b""
        """The last update that was refused because it could not be decoded."""
        self._fragments = b""
        """The content of the next update so far."""

    def read(self, frame: bytes) -> Reading:
        """Read the next packets without a change of this log; ProtocolError if they do not continue it."""
        fragments, packets, updates = self._fragments, self.packets, self.updates
        kept = len(self.messages)
        new: list[tuple[bytes, int]] = []
        for packet in _packets(frame):
            packets += 1
            fragments += packet.data
            if packet.number is None:
                continue
            if packet.number != updates % UPDATE_NUMBERS:
                reason = f"update {packet.number}, expected {updates % UPDATE_NUMBERS}"
                raise ProtocolError(Update.name, 0, reason)
            updates += 1
            if fragments:
                new.append((fragments, packets))
            elif new:
                new.pop()
            elif kept:
                kept -= 1
            else:
                raise ProtocolError(Update.name, 0, "withdraws an update of an empty log")
            fragments = b""
        return Reading(kept, new, fragments, packets, updates)

    def take(self, reading: Reading) -> Reading:
        """Change this log by packets that were read; return the reading that undoes this if nothing was withdrawn."""
        before = Reading(len(self.messages), [], self._fragments, self.packets, self.updates)
        if reading.kept < before.kept:
            del self.messages[reading.kept :], self.ends[reading.kept :]
        for message, end in reading.new:
            self.messages.append(message)
            self.ends.append(end)
        _, _, self._fragments, self.packets, self.updates = reading
        return before


@cache_short(512)
def _packets(frame: bytes) -> Sequence[Update]:
    """Read a frame of a log, which several robots of a process may receive."""
    return tuple(decode_kind(frame, Update))
