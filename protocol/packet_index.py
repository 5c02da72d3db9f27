"""A frame's packets surveyed in one pass over its bytes: where each ends and of which kind it is, no object a packet.

What a survey accepts is what `protocol.packets.decode` reads. Where it stumbles, the decoder is asked for the reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from protocol.errors import ProtocolError
from protocol.kernels import kernel
from protocol.packets import (
    ALL_KINDS,
    FRAGMENT_DATA,
    LAYOUT_BY_BYTE,
    SHORT_HEAD,
    Fragment,
    Update,
    content,
    decode,
)

Bytes = NDArray[np.uint8]
Table = NDArray[np.int64]

TABLE: Table = np.array(LAYOUT_BY_BYTE, np.int64)
"""Of each possible first byte: its kind in `ALL_KINDS` (-1: no packet), the packet's bytes (0: the next byte tells),
which of its bits are the same in all packets, and what they are."""

KINDS = len(ALL_KINDS)

_UPDATE, _FRAGMENT = ALL_KINDS.index(Update.name), ALL_KINDS.index(Fragment.name)

FRAME = "Array(uint8, 1, 'C', readonly=True)"
"""Bytes as kernels take them: what is read from `bytes` cannot be written to."""


def kinds(frame: bytes) -> int:
    """Return which kinds of packets a frame holds: bit k is set for kind k of `ALL_KINDS`.

    Raises
    ------
    ProtocolError
        As `protocol.packets.decode`.
    """
    found = int(_kinds(np.frombuffer(frame, np.uint8), TABLE))
    if found < 0:
        decode(frame)
    return found


def fitting(frame: bytes, room: int) -> int:
    """Return how many bytes of a frame of whole packets fit into `room` bytes without cutting a packet."""
    return int(fitting_part(np.frombuffer(frame, np.uint8), 0, len(frame), room, TABLE))


def longest(frame: bytes) -> int:
    """Return the bytes of the longest of a frame's whole packets."""
    return max(map(len, split(frame)), default=0)


@lru_cache(maxsize=64)
def ends(frame: bytes) -> Sequence[int]:
    """Return where each packet of a frame ends; several may hear the same frame, and get the same answer.

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
    """Cut a frame into one piece a packet; ProtocolError as `ends`."""
    begin = 0
    pieces = []
    for end in ends(frame):
        pieces.append(frame[begin:end])
        begin = end
    return pieces


def contents(frame: bytes, size: int = 0, held: int = 0) -> bytes:
    """Return what the fragments of a frame carry, one behind the other.

    Parameters
    ----------
    frame : bytes
        Whole packets.
    size : int
        Bytes of what is sent in fragments, each time; 0: any number.
    held : int
        Bytes of it that have come before.

    Raises
    ------
    ProtocolError
        There is another packet, or a fragment runs beyond the end of what it is a part of.
    """
    carried = np.empty(len(frame), np.uint8)
    count = int(_contents(np.frombuffer(frame, np.uint8), TABLE, size, held, carried))
    if count == _NO_FRAGMENT:
        for piece in split(frame):
            content(piece)
    if count == _TOO_LONG:
        raise ProtocolError(Fragment.name, 0, f"a fragment runs beyond the {size} bytes that it is a part of")
    return carried[:count].tobytes()


@kernel(f"int64({FRAME}, int64, int64, int64[:,::1])")
def packet_end(data: Bytes, at: int, end: int, table: Table) -> int:
    """Return where the packet that begins at `at` ends; -1 if it does not end by `end`, or is none."""
    first = data[at]
    size = table[first, 1]
    if table[first, 0] < 0:
        return -1
    if size == 0:
        if at + 1 >= end:
            return -1
        size = np.int64(data[at + 1])
        if table[first, 0] == _UPDATE:
            size >>= 2
        elif size < 1 or size >= FRAGMENT_DATA:
            return -1
        size += 2
    if at + size > end:
        return -1
    mask = table[first, 2]
    if mask:
        word = np.int64(0)
        for byte in range(at, at + size):
            word = word << 8 | np.int64(data[byte])
        if word & mask != table[first, 3]:
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
def _contents(data: Bytes, table: Table, size: int, held: int, carried: Bytes) -> int:
    """Write what fragments carry, and return how much that is; or what is wrong."""
    at = count = 0
    while at < len(data):
        if table[data[at], 0] != _FRAGMENT:
            return _NO_FRAGMENT
        head = 1 if table[data[at], 1] else SHORT_HEAD
        end = packet_end(data, at, len(data), table)
        if end < 0:
            return _NO_FRAGMENT
        for byte in range(at + head, end):
            carried[count] = data[byte]
            count += 1
        held += end - at - head
        if 0 < size < held:
            return _TOO_LONG
        if held == size:
            held = 0
        at = end
    return count


@kernel(f"int64({FRAME}, int64, int64, int64, int64[:,::1])")
def fitting_part(data: Bytes, begin: int, end: int, room: int, table: Table) -> int:
    """Return how many of the bytes `begin` to `end`, which are whole packets, fit into `room` bytes."""
    at = begin
    while at < end:
        behind = packet_end(data, at, end, table)
        if behind < 0 or behind - begin > room:
            break
        at = behind
    return at - begin


@kernel(f"int64({FRAME}, int64, int64, int64[:,::1], int64[:,::1])")
def count_part(data: Bytes, begin: int, end: int, table: Table, counts: Table) -> int:
    """Count packets and bytes of each kind in the bytes `begin` to `end`; -1 if they are not whole packets.

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
