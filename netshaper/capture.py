"""The capture: every frame that was said, carried or not, as a packet for Wireshark (docs/capture.md).

A packet is a head of 24 bytes, big-endian, and behind it the frame's bytes as they were said, nothing else:

    version   u8   1
    frame     u8   offer, answer, data, target (`FRAMES`)
    verdict   u8   carried, budget, range, protocol, lost (`netshaper.ledger.CAUSES`, 0 stands for carried)
    exchange  u8
    sender    i8
    receiver  i8   -1 for all; another negative number is a name that no robot has
    map       i8   -1 for none
    zero      u8
    step      u32
    connection i32 -1 for none
    hearers   u64  bit r is set where robot r heard it

A data frame that was cut is two packets: what was carried, and the rest. Its time is its step in seconds, and
its place within the step in microseconds, so that two equal runs leave equal files.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass

from netshaper import pcapng
from netshaper.ledger import BROADCAST, CAUSES
from netshaper.pcapng import CaptureError
from protocol.grid import MAX_ROBOTS

LINK_TYPE = 147
"""LINKTYPE_USER0, which the dissector takes."""

VERSION = 1
HEAD = struct.Struct(">BBBBbbbxIiQ")

FRAMES = ("offer", "answer", "data", "target")

VERDICTS = ("carried", *CAUSES[1:])

_WORDS = {
    "budget": "cut by budget",
    "range": "out of range",
    "protocol": "refused",
    "lost": "a partner died",
}
_SECOND = 1_000_000


@dataclass(frozen=True, slots=True)
class Sighting:
    """One frame, or the part of it that was carried or not.

    `frame` counts in `FRAMES`, `verdict` in `VERDICTS`; `hearers` is a mask; `reason`: why it was refused.
    """

    exchange: int
    connection: int
    frame: int
    sender: int
    receiver: int
    map: int
    verdict: int
    hearers: int
    payload: bytes
    reason: str = ""


def head(description: str) -> bytes:
    """Begin the file of a run; `description` is shown as that of its interface."""
    return pcapng.head(LINK_TYPE, "Murmur", "radio", description)


def encode(step: int, sightings: Iterable[Sighting]) -> bytes:
    """Write the frames of a step, in the order in which they were booked, as blocks of the file."""
    blocks = []
    for place, seen in enumerate(sightings):
        prefix = HEAD.pack(
            VERSION, seen.frame, seen.verdict, seen.exchange, seen.sender, seen.receiver, seen.map,
            step, seen.connection, seen.hearers,
        )  # fmt: skip
        flags = pcapng.BROADCAST if seen.receiver == BROADCAST else pcapng.UNICAST
        time = step * _SECOND + min(place, _SECOND - 1)
        blocks.append(pcapng.packet(time, prefix + seen.payload, in_words(seen), flags))
    return b"".join(blocks)


def decode(packet: pcapng.Packet) -> tuple[int, Sighting]:
    """Read a packet of the file: its step and the frame (why it was refused is in the packet's comment).

    Raises
    ------
    CaptureError
        It has no head of ours.
    """
    if len(packet.data) < HEAD.size or packet.data[0] != VERSION:
        raise CaptureError(f"a packet without a head of version {VERSION}: {packet.data[: HEAD.size].hex()}")
    _, frame, verdict, exchange, sender, receiver, about, step, connection, heard = HEAD.unpack_from(
        packet.data
    )
    if frame >= len(FRAMES) or verdict >= len(VERDICTS):
        raise CaptureError(f"a packet with frame {frame} and verdict {verdict}, which mean nothing")
    payload = packet.data[HEAD.size :]
    return step, Sighting(exchange, connection, frame, sender, receiver, about, verdict, heard, payload)


def in_words(seen: Sighting) -> str:
    """Say what became of a frame: a packet's comment."""
    if seen.verdict:
        words = _WORDS[VERDICTS[seen.verdict]]
        return f"{words}: {seen.reason}" if seen.reason else words
    if seen.receiver != BROADCAST:
        return "delivered"
    names = [f"r{robot}" for robot in hearers(seen)]
    return f"delivered to {', '.join(names)}" if names else "on the air, but nobody was in range"


def hearers(seen: Sighting) -> list[int]:
    """The robots that heard a frame."""
    return [robot for robot in range(MAX_ROBOTS) if seen.hearers >> robot & 1]
