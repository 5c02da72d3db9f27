"""Ledger and capture of a step, packet by packet and block by block: a plain reference."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from hypothesis import strategies as st

from netshaper import pcapng
from netshaper.admission import content_of
from netshaper.capture import KEPT, PART, VERSION, WIDE
from netshaper.frame_log import Frame, FrameLog, comment
from netshaper.ledger import CAUSES, KIND_NUMBER, MALFORMED, on_air
from protocol import packet_codec
from protocol.errors import ProtocolError

Row = tuple[int, ...]

HEAD, WIDE_HEAD = struct.Struct(">BBBBbbbBIiQ"), struct.Struct(">BBBBhhhHIi32s")
"""Both headers of a packet, as docs/capture.md describes them."""


class LoggedFrame(NamedTuple):
    """One frame, or the part of it with one verdict; `receivers` is a mask, bit r for robot r."""

    round: int
    connection: int
    frame: int
    sender: int
    receiver: int
    map: int
    verdict: int
    receivers: int
    payload: bytes
    reason: str = ""


def received_by(seen: LoggedFrame) -> list[int]:
    """The robots that received a frame."""
    return [robot for robot in range(seen.receivers.bit_length()) if seen.receivers >> robot & 1]


def logged_frames(payloads: st.SearchStrategy[bytes]) -> st.SearchStrategy[LoggedFrame]:
    """Arbitrary frames of a team of up to 256 robots."""
    robot = st.integers(-1, 255)
    return st.builds(
        LoggedFrame,
        round=st.integers(0, 15),
        connection=st.integers(-1, 2**31 - 1),
        frame=st.integers(0, 3),
        sender=robot,
        receiver=robot | st.just(-99),
        map=robot,
        verdict=st.integers(0, len(CAUSES) - 1),
        receivers=st.integers(0, 2**256 - 1) | st.integers(0, 2**64),
        payload=payloads,
        reason=st.text(max_size=30),
    )


def log_of(seen: Iterable[LoggedFrame]) -> FrameLog:
    """A log of these frames."""
    log = FrameLog()
    for each in seen:
        content, receivers = content_of(each.frame, each.payload), received_by(each)
        frame = Frame(each.sender, each.receiver, content, each.map, each.connection)
        log.add(each.round, frame, content, each.verdict, receivers=receivers, reason=each.reason)
    return log


def rows(step: int, seen: Iterable[LoggedFrame]) -> list[Row]:
    """The ledger's rows."""
    return [
        (
            step, each.round, each.connection, each.frame, each.sender, each.receiver, each.map, kind, number,
            size, int(on_air(each.verdict)), each.verdict, each.receivers.bit_count(),
        )
        for each in seen
        for kind, number, size in counted(each.payload)
    ]  # fmt: skip


def counted(payload: bytes) -> list[tuple[int, int, int]]:
    """The number of each kind in a frame, how many there are, and their bytes."""
    try:
        content = packet_codec.decode(payload)
    except ProtocolError:
        return [(MALFORMED, 1, len(payload))]
    number = Counter(KIND_NUMBER[packet.name] for packet in content)
    size = Counter[int]()
    for packet in content:
        size[KIND_NUMBER[packet.name]] += len(packet_codec.encode([packet]))
    return [(kind, number[kind], size[kind]) for kind in sorted(number)]


def blocks(step: int, seen: Iterable[LoggedFrame]) -> bytes:
    """The capture."""
    written: list[bytes] = []
    for each in seen:
        text = comment(each.verdict, each.receiver, tuple(received_by(each)), each.reason)
        for part, (kept, size) in enumerate(parts(each)):
            head = head_of(step, each, part)
            time = step * 1_000_000 + min(len(written), 999_999)
            written.append(packet(time, head + kept, len(head) + size, text))
    return b"".join(written)


def head_of(step: int, seen: LoggedFrame, part: int) -> bytes:
    """The header of version 1 if all robot numbers fit into it, else of version 2."""
    wide = max(seen.sender, seen.receiver, seen.map, seen.receivers.bit_length() - 1) >= 64
    received = seen.receivers.to_bytes(32, "big") if wide else seen.receivers
    return (WIDE_HEAD if wide else HEAD).pack(
        WIDE if wide else VERSION, seen.frame, seen.verdict, seen.round, seen.sender, seen.receiver, seen.map,
        part, step, seen.connection, received,
    )  # fmt: skip


def parts(seen: LoggedFrame) -> Iterator[tuple[bytes, int]]:
    """The stored bytes of a frame, packet by packet of the capture, and the size of each."""
    rest = seen.payload
    if not on_air(seen.verdict):
        yield rest[:KEPT], len(rest)
        return
    while len(rest) > PART:
        end = 0
        while (behind := end + packet_codec.length(rest, end)) <= PART:
            end = behind
        yield rest[:end], end
        rest = rest[end:]
    yield rest, len(rest)


def packet(time_us: int, data: bytes, size: int, comment: str) -> bytes:
    """One enhanced packet block with a comment."""
    encoded = comment.encode()
    tail = (
        bytes(-len(data) % 4)
        + struct.pack("<HH", pcapng.COMMENT, len(encoded))
        + encoded
        + bytes(-len(encoded) % 4)
    )
    tail += bytes(4)
    length = 28 + len(data) + len(tail) + 4
    times = time_us >> 32, time_us & 0xFFFFFFFF
    opening = struct.pack("<IIIIIII", pcapng.PACKET, length, 0, *times, len(data), size)
    return opening + data + tail + length.to_bytes(4, "little")
