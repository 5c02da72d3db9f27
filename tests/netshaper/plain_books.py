"""Ledger and capture of a step, packet by packet and block by block: what the kernels that write them must equal."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterable, Iterator

from netshaper import pcapng
from netshaper.capture import HEAD, KEPT, PART, VERSION, WIDE, WIDE_HEAD
from netshaper.frame_log import LoggedFrame, comment, receivers_of
from netshaper.ledger import KIND_NUMBER, MALFORMED, on_air
from protocol import packets
from protocol.errors import ProtocolError

Row = tuple[int, ...]


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
        said = packets.decode(payload)
    except ProtocolError:
        return [(MALFORMED, 1, len(payload))]
    number = Counter(KIND_NUMBER[packet.name] for packet in said)
    size = Counter[int]()
    for packet in said:
        size[KIND_NUMBER[packet.name]] += len(packets.encode([packet]))
    return [(kind, number[kind], size[kind]) for kind in sorted(number)]


def blocks(step: int, seen: Iterable[LoggedFrame]) -> bytes:
    """The capture."""
    written: list[bytes] = []
    for each in seen:
        words = comment(each.verdict, each.receiver, tuple(receivers_of(each.receivers)), each.reason)
        for part, (kept, size) in enumerate(parts(each)):
            head = head_of(step, each, part)
            time = step * 1_000_000 + min(len(written), 999_999)
            written.append(packet(time, head + kept, len(head) + size, words))
    return b"".join(written)


def head_of(step: int, seen: LoggedFrame, part: int) -> bytes:
    """The narrow head, where all robots' numbers fit into it."""
    wide = max(seen.sender, seen.receiver, seen.map, seen.receivers.bit_length() - 1) >= 64
    heard = seen.receivers.to_bytes(32, "big") if wide else seen.receivers
    return (WIDE_HEAD if wide else HEAD).pack(
        WIDE if wide else VERSION, seen.frame, seen.verdict, seen.round, seen.sender, seen.receiver, seen.map,
        part, step, seen.connection, heard,
    )  # fmt: skip


def parts(seen: LoggedFrame) -> Iterator[tuple[bytes, int]]:
    """What is kept of a frame, packet by packet of the capture, and the size of each."""
    rest = seen.payload
    if not on_air(seen.verdict):
        yield rest[:KEPT], len(rest)
        return
    while len(rest) > PART:
        end = 0
        while (behind := end + packets.length(rest, end)) <= PART:
            end = behind
        yield rest[:end], end
        rest = rest[end:]
    yield rest, len(rest)


def packet(time_us: int, data: bytes, size: int, comment: str) -> bytes:
    """One enhanced packet block with a comment."""
    said = comment.encode()
    tail = (
        bytes(-len(data) % 4) + struct.pack("<HH", pcapng.COMMENT, len(said)) + said + bytes(-len(said) % 4)
    )
    tail += bytes(4)
    length = 28 + len(data) + len(tail) + 4
    times = time_us >> 32, time_us & 0xFFFFFFFF
    opening = struct.pack("<IIIIIII", pcapng.PACKET, length, 0, *times, len(data), size)
    return opening + data + tail + length.to_bytes(4, "little")
