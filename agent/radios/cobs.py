"""Lines of frames on a serial port: consistent overhead byte stuffing (Cheshire and Baker, 1999) and a CRC-16.

A line is the stuffed frame and its checksum, between two zero bytes. The stuffed bytes hold no zero, so a reader that
missed a part of the stream begins anew at the next zero.
"""

from __future__ import annotations

import binascii

_BLOCK = 254
"""Bytes without a zero that one code byte announces at most."""
_SUM = 2


def stuff(data: bytes) -> bytes:
    """Return data without zero bytes: at most one byte longer for each 254 bytes begun."""
    out = bytearray()
    pieces = data.split(b"\0")
    for number, piece in enumerate(pieces):
        begin = 0
        while len(piece) - begin >= _BLOCK:
            out += b"\xff" + piece[begin : begin + _BLOCK]
            begin += _BLOCK
        if begin == len(piece) and begin and number == len(pieces) - 1:
            break  # a full block at the very end needs no further code
        out.append(len(piece) - begin + 1)
        out += piece[begin:]
    return bytes(out)


def unstuff(stuffed: bytes) -> bytes | None:
    """Return the data of stuffed bytes; None if they are malformed."""
    out = bytearray()
    at = 0
    while at < len(stuffed):
        code = stuffed[at]
        block = stuffed[at + 1 : at + code]
        if code == 0 or len(block) != code - 1 or 0 in block:
            return None
        out += block
        at += code
        if code <= _BLOCK and at < len(stuffed):
            out.append(0)
    return bytes(out)


def line(frame: bytes) -> bytes:
    """Return a frame as a line: CRC-16 with x^16 + x^12 + x^5 + 1 from 0xffff (X.25's polynomial), stuffed."""
    checksum = binascii.crc_hqx(frame, 0xFFFF).to_bytes(_SUM, "big")
    return b"\0" + stuff(frame + checksum) + b"\0"


class LineReader:
    """Reads frames from a stream of bytes; it drops lines of frames above `longest` bytes."""

    def __init__(self, longest: int) -> None:
        self.damaged = 0
        """Lines that were dropped: malformed, too long, or with a wrong checksum."""
        self._most = len(line(bytes([1]) * longest))
        self._longest = longest
        self._begun = bytearray()
        self._overflowed = False

    def feed(self, data: bytes) -> list[bytes]:
        """Take the next bytes of the stream; return the frames that end in them."""
        frames = []
        *ends, rest = data.split(b"\0")
        for piece in ends:
            self._extend(piece)
            if self._begun:
                frame = None if self._overflowed else self._frame(bytes(self._begun))
                if frame is None:
                    self.damaged += 1
                else:
                    frames.append(frame)
            self._begun.clear()
            self._overflowed = False
        self._extend(rest)
        return frames

    def _extend(self, piece: bytes) -> None:
        room = self._most - len(self._begun)
        self._overflowed = self._overflowed or len(piece) > room
        self._begun += piece[:room]

    def _frame(self, stuffed: bytes) -> bytes | None:
        data = unstuff(stuffed)
        if data is None or not _SUM <= len(data) <= self._longest + _SUM:
            return None
        frame, checksum = data[:-_SUM], data[-_SUM:]
        return frame if binascii.crc_hqx(frame, 0xFFFF).to_bytes(_SUM, "big") == checksum else None
