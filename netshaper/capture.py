"""Capture: every frame that robots sent, carried or not, as a packet for Wireshark (docs/capture.md).

A packet is a header of 24 bytes, big-endian, and then the frame's bytes. If a robot's number is 64 or more, the header
has version 2 and 52 bytes:

    version   u8   1           2
    frame     u8   offer, answer, data, broadcast, news (`FRAMES`)
    verdict   u8   carried, budget, range, protocol, lost, mute, limit, loss, damaged, full (`VERDICTS`)
    round     u8
    sender    i8          i16
    receiver  i8          i16  -1 for all; no other negative numbers
    map       i8          i16  -1 for none
    part      u8          u16  number of this packet, from 0, if a frame needs several
    step      u32
    connection i32 -1 for none
    receivers u64         u256 bit r is set if robot r received it

A data frame that was cut is two packets: the carried part and the rest. Of bytes that were not on the air, the file
keeps the first 64 and the size. The time is the step in seconds plus the packet's position within the step in
microseconds, so that equal runs write equal files.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import lru_cache

import msgspec

from netshaper import pcapng
from netshaper.frame_log import Content, FrameLog
from netshaper.ledger import CAUSES, FRAMES, on_air
from netshaper.pcapng import CaptureError

LINK_TYPE = 147
"""LINKTYPE_USER0, which the dissector reads."""

VERSION, WIDE = 1, 2
"""Versions of the header: the short one, and the one for large teams."""
_HEADS = {VERSION: struct.Struct(">4B3bBIi8s"), WIDE: struct.Struct(">4B3hHIi32s")}
NARROW = 64
"""Number of robots that the short header supports."""

KEPT = 64
"""Bytes stored of a frame that was not carried."""

PART = 200_000
"""Maximum bytes of a frame in one packet; Wireshark reads packets of at most 262,144 bytes."""

VERDICTS = ("carried", *CAUSES[1:])

_SECOND = 1_000_000


class Captured(msgspec.Struct, frozen=True):
    """One packet of a capture, read back: a frame, or a part of it.

    `comment`: the fate of the frame. `size`: bytes of this part, of which the file has `payload`. `frame`: its kind, as
    in `netshaper.ledger.FRAMES`; `cause`: why it was not carried, as in `CAUSES`; `receivers`: robots that received it.
    """

    step: int
    round: int
    connection: int
    frame: int
    sender: int
    receiver: int
    map: int
    cause: int
    receivers: list[int]
    part: int
    size: int
    payload: bytes
    comment: str

    @property
    def verdict(self) -> str:
        """One of `VERDICTS`."""
        return VERDICTS[self.cause]


def head(description: str) -> bytes:
    """Return the beginning of a run's file; `description` is that of its interface."""
    return pcapng.head(LINK_TYPE, "Murmur", "radio", description)


def encode(step: int, log: FrameLog) -> bytes:
    """Write the frames of a step, in the order of the log, as blocks of the file."""
    comments = [pcapng.comment(text) for text in log.texts]
    blocks: list[bytes] = []
    number = first = 0
    for row, content in zip(log.rows_as_lists(), log.contents, strict=True):
        round_number, connection, kind, sender, receiver, map_id, verdict, text, count, _, _ = row
        numbers, receivers = (sender, receiver, map_id), _mask(tuple(log.receivers[first : first + count]))
        first += count
        is_wide = max(numbers) >= NARROW or receivers >> NARROW
        version, receiver_bytes = (WIDE, 32) if is_wide else (VERSION, 8)
        mask = receivers.to_bytes(receiver_bytes, "big")
        is_cut = len(content.payload) > PART and on_air(verdict)
        for part, payload in enumerate(_parts(content) if is_cut else [content.payload]):
            head = _HEADS[version].pack(
                version, kind, verdict, round_number, *numbers, part, step, connection, mask
            )
            kept = payload if on_air(verdict) else payload[:KEPT]
            time_us = step * _SECOND + min(number, _SECOND - 1)
            blocks += pcapng.packet(time_us, head + kept, len(payload) - len(kept), comments[text])
            number += 1
    return b"".join(blocks)


@lru_cache(maxsize=1 << 12)
def _mask(robots: tuple[int, ...]) -> int:
    """Return the robots as bits of a number."""
    return sum(1 << robot for robot in robots)


def _parts(content: Content) -> list[bytes]:
    """Cut a frame into parts of at most `PART` bytes, between packets where that is possible."""
    payload, begin, parts = content.payload, 0, []
    while len(payload) - begin > PART:
        end = max((end for end in content.packets.ends if end <= begin + PART), default=begin + PART)
        parts.append(payload[begin:end])
        begin = end
    return [*parts, payload[begin:]]


def read(reader: pcapng.Reader) -> Iterator[Captured]:
    """Read the packets of a capture; CaptureError if the file or one of its packets has another format."""
    for packet in reader:
        if reader.link_type != LINK_TYPE:
            raise CaptureError(
                f"link type {reader.link_type} instead of {LINK_TYPE}: another program's capture"
            )
        head = _HEADS.get(packet.data[0]) if packet.data else None
        if head is None or len(packet.data) < head.size:
            found = packet.data[: _HEADS[VERSION].size].hex()
            raise CaptureError(f"a packet without a header of version {VERSION} or {WIDE}: {found}")
        values = head.unpack_from(packet.data)
        _, frame, cause, round_number, sender, receiver, map_id, part, step, connection, received = values
        if frame >= len(FRAMES) or cause >= len(VERDICTS):
            raise CaptureError(f"a packet with frame {frame} and verdict {cause}, which are unknown")
        mask = int.from_bytes(received, "big")
        receivers = [robot for robot in range(mask.bit_length()) if mask >> robot & 1]
        yield Captured(
            step, round_number, connection, frame, sender, receiver, map_id, cause, receivers, part,
            packet.size - head.size, packet.data[head.size :], packet.comment,
        )  # fmt: skip
