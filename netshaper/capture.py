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

import msgspec
import numpy as np

from netshaper import pcapng
from netshaper.frame_log import (
    BYTES,
    COMMENT,
    CONNECTION,
    FRAME,
    MAP,
    PACKETS,
    RECEIVER,
    RECEIVERS,
    ROUND,
    SENDER,
    VERDICT,
    Columns,
)
from netshaper.ledger import CAUSES, FIRST_ON_AIR, FRAMES
from netshaper.pcapng import CaptureError
from protocol.arrays import Int64Rows, Int64s, ReadOnlyInt32s, ReadOnlyUint8s, Uint8s
from protocol.kernels import kernel

LINK_TYPE = 147
"""LINKTYPE_USER0, which the dissector reads."""

VERSION, WIDE = 1, 2
"""Versions of the header: the short one, and the one for large teams."""
HEAD = struct.Struct(">BBBBbbbBIiQ")
WIDE_HEAD = struct.Struct(">BBBBhhhHIi32s")
NARROW = 64
"""Number of robots that the short header supports."""

KEPT = 64
"""Bytes stored of a frame that was not carried."""

MAX_PACKET = 262_144
"""Bytes of the longest packet that Wireshark reads."""

PART = 200_000
"""Maximum bytes of a frame in one packet."""

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


def encode(step: int, frames: Columns) -> bytes:
    """Write the frames of a step, in the order of the log, as blocks of the file."""
    rows, receivers, payload, _, sizes, texts, text_at = frames
    return _encode(step, rows, receivers, payload, sizes, texts, text_at, FIRST_ON_AIR).tobytes()


def read(reader: pcapng.Reader) -> Iterator[Captured]:
    """Read the packets of a capture.

    Raises
    ------
    CaptureError
        The file or one of its packets has another format.
    """
    for packet in reader:
        if reader.link_type != LINK_TYPE:
            raise CaptureError(
                f"link type {reader.link_type} instead of {LINK_TYPE}: another program's capture"
            )
        head = _HEADS.get(packet.data[0]) if packet.data else None
        if head is None or len(packet.data) < head.size:
            found = packet.data[: HEAD.size].hex()
            raise CaptureError(f"a packet without a header of version {VERSION} or {WIDE}: {found}")
        _, frame, cause, round_number, sender, receiver, map_id, part, step, connection, received = (
            head.unpack_from(packet.data)
        )
        if frame >= len(FRAMES) or cause >= len(VERDICTS):
            raise CaptureError(f"a packet with frame {frame} and verdict {cause}, which are unknown")
        mask = received if isinstance(received, int) else int.from_bytes(received, "big")
        receivers = [robot for robot in range(mask.bit_length()) if mask >> robot & 1]
        yield Captured(
            step, round_number, connection, frame, sender, receiver, map_id, cause, receivers, part,
            packet.size - head.size, packet.data[head.size :], packet.comment,
        )  # fmt: skip


_HEADS = {VERSION: HEAD, WIDE: WIDE_HEAD}

_PACKET_HEAD = 28
"""Bytes before the data in an enhanced packet block."""
_BLOCK = _PACKET_HEAD + WIDE_HEAD.size + 24
"""Maximum bytes of a block without the frame and the comment."""
_COMMENT = pcapng.COMMENT
_PACKET = pcapng.PACKET


@kernel
def _little(out: Uint8s, at: int, value: int, size: int) -> None:
    for byte in range(size):
        out[at + byte] = np.uint8(value >> 8 * byte & 0xFF)


@kernel
def _big(out: Uint8s, at: int, value: int, size: int) -> None:
    for byte in range(size):
        out[at + byte] = np.uint8(value >> 8 * (size - 1 - byte) & 0xFF)


@kernel
def _write_head(out: Uint8s, at: int, step: int, row: Int64s, part: int, wide: bool) -> int:
    """Write the header of a frame, without receivers; return its end."""
    out[at] = WIDE if wide else VERSION
    out[at + 1] = row[FRAME]
    out[at + 2] = row[VERDICT]
    out[at + 3] = row[ROUND]
    size = 2 if wide else 1
    at += 4
    for value in (row[SENDER], row[RECEIVER], row[MAP], part):
        _big(out, at, value, size)
        at += size
    _big(out, at, step, 4)
    _big(out, at + 4, row[CONNECTION], 4)
    at += 8
    behind = at + (32 if wide else 8)
    out[at:behind] = 0
    return behind


@kernel
def _write_comment(out: Uint8s, at: int, text: ReadOnlyUint8s, block: int) -> int:
    """Write a comment and the end-of-options mark; return their end."""
    _little(out, at, _COMMENT, 2)
    _little(out, at + 2, len(text), 2)
    at += 4
    out[at : at + len(text)] = text
    at += len(text)
    while (at - block) % 4:
        out[at] = 0
        at += 1
    out[at : at + 4] = 0
    return at + 4


@kernel
def _encode(
    step: int,
    rows: Int64Rows,
    receivers: Int64s,
    payload: ReadOnlyUint8s,
    sizes: ReadOnlyInt32s,
    texts: ReadOnlyUint8s,
    text_at: Int64s,
    on_air: int,
) -> Uint8s:
    """Write enhanced packet blocks (`netshaper.pcapng.packet`), each with a header, frame part and comment."""
    room = 0
    for each in range(len(rows)):
        size = rows[each, BYTES]
        text = text_at[rows[each, COMMENT] + 1] - text_at[rows[each, COMMENT]]
        parts = 1 + size // (PART // 2)
        cut = 0 < rows[each, VERDICT] < on_air
        room += (min(size, KEPT) if cut else size) + parts * (_BLOCK + text)
    out = np.empty(room, np.uint8)
    at = 0
    blocks = 0
    end = behind = next_packet = 0
    for each in range(len(rows)):
        begin, first, packet = end, behind, next_packet
        end += rows[each, BYTES]
        behind += rows[each, RECEIVERS]
        next_packet += max(0, rows[each, PACKETS])
        wide = max(rows[each, SENDER], rows[each, RECEIVER], rows[each, MAP]) >= NARROW
        for receiver in receivers[first:behind]:
            wide = wide or receiver >= NARROW
        part = 0
        cut = 0 < rows[each, VERDICT] < on_air
        while True:
            size = kept = end - begin
            if cut:
                kept = min(kept, KEPT)
            elif size > PART:
                if rows[each, PACKETS] > 0:
                    size = sizes[packet]
                    packet += 1
                    while size + sizes[packet] <= PART:
                        size += sizes[packet]
                        packet += 1
                else:
                    size = PART
                kept = size
            block = at
            at += _PACKET_HEAD
            at = _write_head(out, at, step, rows[each], part, wide)
            for receiver in receivers[first:behind]:
                out[at - 1 - receiver // 8] |= np.uint8(1 << receiver % 8)
            data = at - block - _PACKET_HEAD
            out[at : at + kept] = payload[begin : begin + kept]
            at += kept
            while (at - block) % 4:
                out[at] = 0
                at += 1
            at = _write_comment(
                out, at, texts[text_at[rows[each, COMMENT]] : text_at[rows[each, COMMENT] + 1]], block
            )
            time = step * _SECOND + min(blocks, _SECOND - 1)
            length = at + 4 - block
            _little(out, block, _PACKET, 4)
            _little(out, block + 4, length, 4)
            _little(out, block + 8, 0, 4)
            _little(out, block + 12, time >> 32, 4)
            _little(out, block + 16, time & 0xFFFFFFFF, 4)
            _little(out, block + 20, data + kept, 4)
            _little(out, block + 24, data + size, 4)
            _little(out, at, length, 4)
            at += 4
            blocks += 1
            part += 1
            begin += size
            if cut or begin >= end:
                break
    return out[:at]
