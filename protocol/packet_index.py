"""Packet boundaries and kinds of a frame, found in one pass over its bytes without an object per packet.

These kernels accept exactly what `protocol.packets.decode` reads. Where they fail, `decode` gives the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from protocol.errors import ProtocolError
from protocol.kernels import kernel
from protocol.packets import ALL_KINDS, LAYOUT_BY_BYTE, SHORT_HEAD, Fragment, content, decode

Bytes = NDArray[np.uint8]
Table = NDArray[np.int64]

TABLE: Table = np.array(LAYOUT_BY_BYTE, np.int64)
"""Layout of the packets that start with each byte, shape (256, 7); columns as in `LAYOUT_BY_BYTE`."""

KINDS = len(ALL_KINDS)

_FRAGMENT = ALL_KINDS.index(Fragment.name)

FRAME = "Array(uint8, 1, 'C', readonly=True)"
"""Type of a frame in the signature of a kernel; arrays over `bytes` are read-only."""


def kinds(frame: bytes) -> int:
    """Return the kinds of packets in a frame: bit k is set for kind k of `ALL_KINDS`.

    Raises
    ------
    ProtocolError
        As `protocol.packets.decode`.
    """
    found = int(_kinds(np.frombuffer(frame, np.uint8), TABLE))
    if found < 0:
        decode(frame)
    return found


def fitting(frame: bytes, limit: int) -> int:
    """Return the size of the longest prefix of a frame that has whole packets and at most `limit` bytes."""
    return int(fitting_part(np.frombuffer(frame, np.uint8), 0, len(frame), limit, TABLE))


def longest(frame: bytes) -> int:
    """Return the bytes of the longest packet of a frame; ProtocolError as `ends`."""
    return max(map(len, split(frame)), default=0)


@lru_cache(maxsize=64)
def ends(frame: bytes) -> Sequence[int]:
    """Return the end of each packet of a frame, as offsets; cached, because a frame can have many receivers.

    Raises
    ------
    ProtocolError
        As `protocol.packets.decode`.
    """
    found = np.empty(len(frame), np.int64)
    count = int(_ends(np.frombuffer(frame, np.uint8), TABLE, found))
    if count < 0:
        decode(frame)
    these: list[int] = found[:count].tolist()
    return these


def split(frame: bytes) -> list[bytes]:
    """Split a frame into its packets; ProtocolError as `ends`."""
    begin = 0
    pieces = []
    for end in ends(frame):
        pieces.append(frame[begin:end])
        begin = end
    return pieces


def contents(frame: bytes, size: int = 0, held: int = 0) -> bytes:
    """Return the joined content of a frame of fragments.

    Parameters
    ----------
    frame : bytes
        Whole packets.
    size : int
        Bytes of each message that was split into fragments; 0: not known.
    held : int
        Bytes of the first message that have arrived before this frame.

    Raises
    ------
    ProtocolError
        The frame holds another packet, or a fragment extends beyond the end of its message.
    """
    joined = np.empty(len(frame), np.uint8)
    count = int(_contents(np.frombuffer(frame, np.uint8), TABLE, size, held, joined))
    if count == _NO_FRAGMENT:
        for piece in split(frame):
            content(piece)
    if count == _TOO_LONG:
        raise ProtocolError(Fragment.name, 0, f"a fragment extends beyond the {size} bytes of its message")
    return joined[:count].tobytes()


@kernel(f"int64({FRAME}, int64, int64, int64[:,::1])")
def packet_end(data: Bytes, at: int, end: int, table: Table) -> int:
    """Return the end of the packet that starts at `at`; -1 if it is malformed or does not end by `end`."""
    first = data[at]
    size = table[first, 1]
    if table[first, 0] < 0:
        return -1
    if size == 0:
        if at + 1 >= end:
            return -1
        size = np.int64(data[at + 1]) >> table[first, 4]
        if size < table[first, 5] or size > table[first, 6]:
            return -1
        size += SHORT_HEAD
    if at + size > end:
        return -1
    mask = table[first, 2]
    if mask:
        number = np.int64(0)
        for byte in range(at, at + size):
            number = number << 8 | np.int64(data[byte])
        if number & mask != table[first, 3]:
            return -1
    return int(at + size)


@kernel(f"int64({FRAME}, int64[:,::1])")
def _kinds(data: Bytes, table: Table) -> int:
    found = 0
    at = 0
    while at < len(data):
        found |= 1 << table[data[at], 0]
        at = packet_end(data, at, len(data), table)
        if at < 0:
            return -1
    return found


@kernel(f"int64({FRAME}, int64[:,::1], int64[::1])")
def _ends(data: Bytes, table: Table, ends: Table) -> int:
    count = 0
    at = 0
    while at < len(data):
        at = packet_end(data, at, len(data), table)
        if at < 0:
            return -1
        ends[count] = at
        count += 1
    return count


_NO_FRAGMENT, _TOO_LONG = -1, -2


@kernel(f"int64({FRAME}, int64[:,::1], int64, int64, uint8[::1])")
def _contents(data: Bytes, table: Table, size: int, held: int, joined: Bytes) -> int:
    """Write the content of all fragments to `joined`, and return its size; or `_NO_FRAGMENT` or `_TOO_LONG`."""
    at = count = 0
    while at < len(data):
        if table[data[at], 0] != _FRAGMENT:
            return _NO_FRAGMENT
        head = 1 if table[data[at], 1] else SHORT_HEAD
        end = packet_end(data, at, len(data), table)
        if end < 0:
            return _NO_FRAGMENT
        for byte in range(at + head, end):
            joined[count] = data[byte]
            count += 1
        held += end - at - head
        if 0 < size < held:
            return _TOO_LONG
        if held == size:
            held = 0
        at = end
    return count


@kernel(f"int64({FRAME}, int64, int64, int64, int64[:,::1])")
def fitting_part(data: Bytes, begin: int, end: int, limit: int, table: Table) -> int:
    """Return how many bytes of the whole packets in ``data[begin:end]`` fit into `limit` bytes."""
    at = begin
    while at < end:
        behind = packet_end(data, at, end, table)
        if behind < 0 or behind - begin > limit:
            break
        at = behind
    return at - begin


@kernel(f"int64({FRAME}, int64, int64, int64[:,::1], int64[:,::1])")
def count_part(data: Bytes, begin: int, end: int, table: Table, counts: Table) -> int:
    """Count the packets and bytes of each kind in ``data[begin:end]``; return -1 if these are not whole packets.

    `counts`, shape (kinds, 2), is overwritten.
    """
    counts[:] = 0
    at = begin
    while at < end:
        behind = packet_end(data, at, end, table)
        if behind < 0:
            return -1
        kind = table[data[at], 0]
        counts[kind, 0] += 1
        counts[kind, 1] += behind - at
        at = behind
    return 0
