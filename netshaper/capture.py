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

from collections.abc import Iterator, Sequence

import msgspec
import numpy as np

from netshaper import pcapng
from netshaper.frame_log import (
    COMMENT,
    CONNECTION,
    FRAME,
    MAP,
    RECEIVER,
    RECEIVERS,
    ROUND,
    SENDER,
    VERDICT,
    Content,
    FrameLog,
)
from netshaper.ledger import CAUSES, FRAMES, on_air
from netshaper.pcapng import CaptureError
from protocol.arrays import Int64Rows, Uint8s
from protocol.grid import MAX_ROBOTS

LINK_TYPE = 147
"""LINKTYPE_USER0, which the dissector reads."""

VERSION, WIDE = 1, 2
"""Versions of the header: the short one, and the one for large teams."""
_FIELDS = (
    "version", "frame", "verdict", "round", "sender", "receiver", "map", "part", "step", "connection", "receivers",
)  # fmt: skip
HEAD = np.dtype(
    list(zip(_FIELDS, ["u1", "u1", "u1", "u1", "i1", "i1", "i1", "u1", ">u4", ">i4", "V8"], strict=True))
)
WIDE_HEAD = np.dtype(
    list(zip(_FIELDS, ["u1", "u1", "u1", "u1", ">i2", ">i2", ">i2", ">u2", ">u4", ">i4", "V32"], strict=True))
)
_LAYOUTS = {VERSION: HEAD, WIDE: WIDE_HEAD}
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


def encode(step: int, log: FrameLog) -> bytes:
    """Write the frames of a step, in the order of the log, as blocks of the file."""
    if not len(log):
        return b""
    rows, payloads = log.rows(), [content.payload for content in log.contents]
    received = np.zeros((len(rows), MAX_ROBOTS), np.bool_)
    received[np.repeat(np.arange(len(rows)), rows[:, RECEIVERS]), log.receivers] = True
    masks = np.packbits(received, axis=1, bitorder="little")[:, ::-1]
    parts: Sequence[int] = [0] * len(rows)
    if max(map(len, payloads)) > PART:
        frames, parts, payloads = _cut(rows, log.contents)
        rows, masks = rows[frames], masks[frames]
    stored = [
        payload if on_air(verdict) else payload[:KEPT]
        for payload, verdict in zip(payloads, rows[:, VERDICT].tolist(), strict=True)
    ]
    heads = _heads(step, rows, parts, masks)
    times_us = step * _SECOND + np.minimum(np.arange(len(rows)), _SECOND - 1)
    data = [head + payload for head, payload in zip(heads, stored, strict=True)]
    missing = [len(payload) - len(kept) for payload, kept in zip(payloads, stored, strict=True)]
    texts = [pcapng.comment(text) for text in log.texts]
    return pcapng.packets(times_us, data, missing, [texts[text] for text in rows[:, COMMENT].tolist()])


def _cut(rows: Int64Rows, contents: Sequence[Content]) -> tuple[list[int], list[int], list[bytes]]:
    """Cut long frames on the air into packets: of each packet its frame, its number in the frame, and its bytes."""
    pieces = [
        (number, part, payload)
        for number, (content, verdict) in enumerate(zip(contents, rows[:, VERDICT].tolist(), strict=True))
        for part, payload in enumerate(_parts(content) if on_air(verdict) else [content.payload])
    ]
    frames, parts, payloads = zip(*pieces, strict=True)
    return list(frames), list(parts), list(payloads)


def _parts(content: Content) -> list[bytes]:
    """Cut a frame into parts of at most `PART` bytes, between packets where that is possible."""
    payload, begin, parts = content.payload, 0, []
    while len(payload) - begin > PART:
        end = max((end for end in content.packets.ends if end <= begin + PART), default=begin + PART)
        parts.append(payload[begin:end])
        begin = end
    return [*parts, payload[begin:]]


def _heads(step: int, rows: Int64Rows, parts: Sequence[int], masks: Uint8s) -> list[bytes]:
    """Write the headers of packets; `masks`: the receivers of each as a number of 256 bits, shape (packets, 32)."""
    columns = [rows[:, column] for column in (FRAME, VERDICT, ROUND, SENDER, RECEIVER, MAP)]
    wide = (rows[:, (SENDER, RECEIVER, MAP)].max(axis=1) >= NARROW) | masks[:, : -NARROW // 8].any(axis=1)
    versions = []
    for version, layout in _LAYOUTS.items():
        heads = np.empty(len(rows), layout)
        for name, values in zip(_FIELDS, [version, *columns, parts, step, rows[:, CONNECTION]], strict=False):
            heads[name] = values
        size = layout["receivers"].itemsize
        heads["receivers"] = np.ascontiguousarray(masks[:, -size:]).view(f"V{size}").ravel()
        versions.append(heads.view(f"V{layout.itemsize}").tolist())
        if not wide.any():
            return versions[0]
    return [long if is_wide else short for short, long, is_wide in zip(*versions, wide.tolist(), strict=True)]


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
        head = _LAYOUTS.get(packet.data[0]) if packet.data else None
        if head is None or len(packet.data) < head.itemsize:
            found = packet.data[: HEAD.itemsize].hex()
            raise CaptureError(f"a packet without a header of version {VERSION} or {WIDE}: {found}")
        (fields,) = np.frombuffer(packet.data, head, 1).tolist()
        _, frame, cause, round_number, sender, receiver, map_id, part, step, connection, received = fields
        if frame >= len(FRAMES) or cause >= len(VERDICTS):
            raise CaptureError(f"a packet with frame {frame} and verdict {cause}, which are unknown")
        mask = int.from_bytes(received, "big")
        receivers = [robot for robot in range(mask.bit_length()) if mask >> robot & 1]
        yield Captured(
            step, round_number, connection, frame, sender, receiver, map_id, cause, receivers, part,
            packet.size - head.itemsize, packet.data[head.itemsize :], packet.comment,
        )  # fmt: skip
