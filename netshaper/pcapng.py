"""pcapng, the file format of packet captures (draft-ietf-opsawg-pcapng): the subset that a radio capture needs.

One section, one interface, one enhanced packet block per frame; all little-endian. Blocks are self-contained,
so a file that a killed process left behind can be read up to its last complete block.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import BinaryIO

SECTION, INTERFACE, PACKET = 0x0A0D0D0A, 0x00000001, 0x00000006
COMMENT, NAME, DESCRIPTION, APPLICATION = 1, 2, 3, 4
"""Codes of options: the first of any block, two of an interface, one of a section."""

_MAGIC = 0x1A2B3C4D
_BLOCK = struct.Struct("<II")
_PACKET = struct.Struct("<5I")
_OPTION = struct.Struct("<HH")
_PACKET_HEAD = struct.Struct("<7I")
"""Kind and length of the block, interface, time (high and low), stored bytes, and original size."""
_PADDINGS = [bytes(-size % 4) for size in range(4)]
"""Zeros that align data to 4 bytes, by the data's size modulo 4."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet of a file: its time in microseconds, its stored bytes, its original size, its comment."""

    time_us: int
    data: bytes
    size: int
    comment: str


class CaptureError(ValueError):
    """A file is not a Murmur capture; the message has position and reason."""


def head(link_type: int, application: str, name: str, description: str) -> bytes:
    """Start a file: the section, and its interface, whose packets have `link_type`."""
    section = struct.pack("<IHHq", _MAGIC, 1, 0, -1) + _options((APPLICATION, application.encode()))
    options = _options((NAME, name.encode()), (DESCRIPTION, description.encode()))
    interface = struct.pack("<HHI", link_type, 0, 0) + options
    return _block(SECTION, section) + _block(INTERFACE, interface)


@lru_cache(maxsize=1 << 12)
def comment(text: str) -> bytes:
    """Write the options of a packet: its comment."""
    return _options((COMMENT, text.encode()))


def packet(time_us: int, data: bytes, missing: int, options: bytes) -> tuple[bytes, ...]:
    """Write an enhanced packet block, in pieces; `missing` is the number of bytes that are not stored."""
    kept = len(data)
    padding = _PADDINGS[kept & 3]
    length = _PACKET_HEAD.size + kept + len(padding) + len(options) + 4
    head = _PACKET_HEAD.pack(PACKET, length, 0, time_us >> 32, time_us & 0xFFFFFFFF, kept, kept + missing)
    return head, data, padding, options, length.to_bytes(4, "little")


class Reader:
    """Iterator over the packets of a file whose beginning `head` wrote.

    Iterating raises CaptureError if the file has another format, or a block is malformed.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.torn = 0
        """Bytes of an unfinished block at the end of the file, which the reader skips."""
        self.link_type = -1
        self._file = file
        self._offset = 0

    def __iter__(self) -> Iterator[Packet]:
        first = True
        while True:
            opening = self._file.read(_BLOCK.size)
            if first and (len(opening) < _BLOCK.size or _BLOCK.unpack(opening)[0] != SECTION):
                raise CaptureError("not a pcapng file")
            first = False
            if len(opening) < _BLOCK.size:
                self.torn = len(opening)
                return
            kind, size = _BLOCK.unpack(opening)
            if size % 4 or size < _BLOCK.size + 4:
                raise self._malformed(f"a block of {size} bytes")
            body = self._file.read(size - _BLOCK.size)
            if len(body) < size - _BLOCK.size:
                self.torn = len(opening) + len(body)
                return
            if int.from_bytes(body[-4:], "little") != size:
                raise self._malformed("a block whose two lengths differ")
            if kind == SECTION and int.from_bytes(body[:4], "little") != _MAGIC:
                raise self._malformed("a big-endian section")
            if kind == INTERFACE:
                self.link_type = int.from_bytes(body[:2], "little")
            if kind == PACKET:
                yield self._read_packet(body[:-4])
            self._offset += size

    def _read_packet(self, body: bytes) -> Packet:
        if len(body) < _PACKET.size:
            raise self._malformed("a packet without a head")
        _, high, low, kept, size = _PACKET.unpack_from(body)
        end = _PACKET.size + kept + -kept % 4
        if end > len(body):
            raise self._malformed("a packet longer than its block")
        comment = ""
        while end + _OPTION.size <= len(body):
            code, length = _OPTION.unpack_from(body, end)
            value = body[end + _OPTION.size : end + _OPTION.size + length]
            end += _OPTION.size + length + -length % 4
            if code == COMMENT:
                comment = value.decode(errors="replace")
            elif code == 0:
                break
        return Packet(high << 32 | low, body[_PACKET.size : _PACKET.size + kept], size, comment)

    def _malformed(self, reason: str) -> CaptureError:
        return CaptureError(f"malformed at byte {self._offset}: {reason}")


def _block(kind: int, body: bytes) -> bytes:
    size = _BLOCK.size + len(body) + 4
    return _BLOCK.pack(kind, size) + body + size.to_bytes(4, "little")


def _options(*options: tuple[int, bytes]) -> bytes:
    parts = [_OPTION.pack(code, len(value)) + value + bytes(-len(value) % 4) for code, value in options]
    return b"".join(parts) + _OPTION.pack(0, 0)
