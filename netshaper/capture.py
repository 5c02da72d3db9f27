"""The capture: every frame that was said, carried or not, as a packet for Wireshark (docs/capture.md).

A packet is a head of 24 bytes, big-endian, and behind it the frame's bytes as they were said, nothing else:

    version   u8   1
    frame     u8   offer, answer, data, broadcast, news (`FRAMES`)
    verdict   u8   carried, budget, range, protocol, lost (`VERDICTS`)
    exchange  u8
    sender    i8
    receiver  i8   -1 for all; another negative number is a name that no robot has
    map       i8   -1 for none
    part      u8   counts the packets of a frame that is too long for one, from 0
    step      u32
    connection i32 -1 for none
    hearers   u64  bit r is set where robot r heard it

A data frame that was cut is two packets, what was carried and the rest; of what was not carried the first
64 bytes are kept, and its size. The time is the step in seconds, and the place within the step in
microseconds, so that two equal runs leave equal files.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from netshaper import pcapng
from netshaper.ledger import CAUSES, EVERYONE, Sighting
from netshaper.pcapng import CaptureError
from protocol import packets
from protocol.grid import MAX_ROBOTS

LINK_TYPE = 147
"""LINKTYPE_USER0, which the dissector takes."""

VERSION = 1
HEAD = struct.Struct(">BBBBbbbBIiQ")

KEPT = 64
"""Bytes that are kept of what was not carried."""

CAPTURED_AT_MOST = 262_144
"""Bytes of a packet that Wireshark takes."""

PART = 200_000
"""Bytes of a frame in one packet at most."""

FRAMES = ("offer", "answer", "data", "broadcast", "news")

VERDICTS = ("carried", *CAUSES[1:])

_WORDS = {
    "budget": "cut by budget",
    "range": "out of range",
    "protocol": "refused",
    "lost": "a partner died",
}
_SECOND = 1_000_000


@dataclass(frozen=True, slots=True)
class Captured:
    """One packet of a capture, read back.

    `seen` has the bytes that were kept of a frame's `part`, `size` is how many there were; `words` says what
    became of it.
    """

    step: int
    part: int
    size: int
    words: str
    seen: Sighting

    @property
    def verdict(self) -> str:
        """One of `VERDICTS`."""
        return VERDICTS[self.seen.verdict]


def head(description: str) -> bytes:
    """Begin the file of a run; `description` is shown as that of its interface."""
    return pcapng.head(LINK_TYPE, "Murmur", "radio", description)


def encode(step: int, sightings: Iterable[Sighting]) -> bytes:
    """Write the frames of a step, in the order in which they were booked, as blocks of the file."""
    blocks: list[bytes] = []
    for seen in sightings:
        words = in_words(seen)
        exchange, connection, frame, sender, receiver, about, verdict, hearers, _, _ = seen
        for part, (kept, size) in enumerate(_parts(seen)):
            head = HEAD.pack(
                VERSION, frame, verdict, exchange, sender, receiver, about, part, step, connection, hearers
            )
            time = step * _SECOND + min(len(blocks), _SECOND - 1)
            blocks.append(pcapng.packet(time, head + kept, HEAD.size + size, words))
    return b"".join(blocks)


def read(reader: pcapng.Reader) -> Iterator[Captured]:
    """Read the packets of a capture.

    Raises
    ------
    CaptureError
        It is no capture of ours, or a packet has no head of ours.
    """
    for packet in reader:
        if reader.link_type != LINK_TYPE:
            raise CaptureError(
                f"link type {reader.link_type} instead of {LINK_TYPE}: another program's capture"
            )
        if len(packet.data) < HEAD.size or packet.data[0] != VERSION:
            found = packet.data[: HEAD.size].hex()
            raise CaptureError(f"a packet without a head of version {VERSION}: {found}")
        _, frame, verdict, exchange, sender, receiver, about, part, step, connection, heard = (
            HEAD.unpack_from(packet.data)
        )
        if frame >= len(FRAMES) or verdict >= len(VERDICTS):
            raise CaptureError(f"a packet with frame {frame} and verdict {verdict}, which mean nothing")
        kept = packet.data[HEAD.size :]
        seen = Sighting(exchange, connection, frame, sender, receiver, about, verdict, heard, kept)
        yield Captured(step, part, packet.size - HEAD.size, packet.comment, seen)


def in_words(seen: Sighting) -> str:
    """Say what became of a frame: a packet's comment."""
    if seen.verdict:
        words = _WORDS[VERDICTS[seen.verdict]]
        return f"{words}: {seen.reason}" if seen.reason else words
    if seen.receiver != EVERYONE:
        return "delivered"
    names = [f"r{robot}" for robot in hearers(seen)]
    return f"delivered to {', '.join(names)}" if names else "on the air, but nobody was in range"


def hearers(seen: Sighting) -> list[int]:
    """The robots that heard a frame."""
    return [robot for robot in range(MAX_ROBOTS) if seen.hearers >> robot & 1]


def _parts(seen: Sighting) -> list[tuple[bytes, int]]:
    """What is kept of a frame, packet by packet, and the size of each."""
    rest = seen.payload
    if seen.verdict:
        return [(rest[:KEPT], len(rest))]
    parts = []
    while len(rest) > PART:
        end = packets.fitting(rest, PART)
        parts.append((rest[:end], end))
        rest = rest[end:]
    return [*parts, (rest, len(rest))]
