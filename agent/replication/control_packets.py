"""Control packets that name log offsets, and the split of a frame into control packets and log ranges.

An offset travels whole while it is small (`EARLY`), later modulo `GOSSIP_WINDOW`; the receiver takes the value nearest
to its own log length, as TCP does with truncated sequence numbers.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

from protocol import packet_index, packets
from protocol.packets import EARLY, GOSSIP_WINDOW, From, FromEarly, Held, HeldEarly

CONTROL = From.name
"""Packet type of everything that is not a log entry."""


class Entries(NamedTuple):
    """Consecutive entries of a log in a frame."""

    frame: bytes
    begin: int
    ends: list[int]
    """Where the first entry begins, and where each one ends, in bytes of the frame."""

    def split(self) -> list[bytes]:
        """Return each entry."""
        return [
            self.frame[begin:end] for begin, end in zip([self.begin, *self.ends], self.ends, strict=False)
        ]

    def first(self, count: int) -> Entries:
        """Return the first `count` entries."""
        return self._replace(ends=self.ends[:count])

    def after(self, count: int) -> bytes:
        """Return all but the first `count` entries, one after the other."""
        return self.frame[self.ends[count - 1] if count else self.begin : self.ends[-1]]


class ParsedFrame(NamedTuple):
    """A frame's control packets, and its entries behind the header that names their log and first offset.

    Entries without a header continue the sender's own log where its last frame ended.
    """

    controls: list[packets.AnyPacket]
    sections: list[tuple[From | FromEarly | None, Entries]]


@lru_cache(maxsize=64)
def parse(frame: bytes) -> ParsedFrame:
    """Split a frame; several robots of a process may receive the same one, so callers must not change the result.

    Raises
    ------
    ProtocolError
        The frame does not consist of whole packets.
    """
    begin = 0
    controls: list[packets.AnyPacket] = []
    header: From | FromEarly | None = None
    sections: list[tuple[From | FromEarly | None, Entries]] = []
    entries = Entries(frame, 0, [])
    for end in packet_index.ends(frame):
        if packets.name(frame, begin) != CONTROL:
            entries.ends.append(end)
        else:
            if entries.ends:
                sections.append((header, entries))
            (control,) = packets.decode(frame[begin:end])
            controls.append(control)
            header = control if isinstance(control, From | FromEarly) else header
            entries = Entries(frame, end, [])
        begin = end
    return ParsedFrame(controls, [*sections, (header, entries)] if entries.ends else sections)


def offset(packet: From | FromEarly | Held | HeldEarly, length: int) -> int:
    """Return the offset that a packet means, for a robot whose log has `length` entries."""
    if isinstance(packet, FromEarly | HeldEarly):
        return packet.index
    return max(0, length + (packet.index - length + GOSSIP_WINDOW // 2) % GOSSIP_WINDOW - GOSSIP_WINDOW // 2)


def from_packet(number: int, first: int) -> bytes:
    """Encode the shortest packet that says: entries of map `number` follow, from offset `first` on."""
    packet = FromEarly(number, first) if first < EARLY else From(number, first % GOSSIP_WINDOW)
    return packets.encode([packet])


def held_packet(number: int, length: int) -> bytes:
    """Encode the shortest packet that says: this robot holds `length` entries of map `number`."""
    packet = HeldEarly(number, length) if length < EARLY else Held(number, length % GOSSIP_WINDOW)
    return packets.encode([packet])
