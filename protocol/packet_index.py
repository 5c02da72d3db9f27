"""Packet boundaries and kinds of a frame, found in one pass over its bytes without an object per packet.

These kernels accept exactly what `protocol.packet_codec.decode` reads. Where they fail, `decode` gives the error.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Callable, Sequence
from functools import lru_cache, wraps
from itertools import accumulate, pairwise
from typing import TypeVar

import msgspec
import numpy as np

from protocol.arrays import Int32Rows, Int64Rows, ReadOnlyUint8s, Uint8s
from protocol.kernels import kernel
from protocol.packet_codec import LAYOUT_BY_BYTE, decode
from protocol.packets import LENGTH_HEAD

TABLE: Int64Rows = np.array(LAYOUT_BY_BYTE, np.int64)
"""Layout of the packets that start with each byte, shape (256, 7); columns as in `LAYOUT_BY_BYTE`."""

MAX_CACHED_BYTES = 1 << 16
"""Maximum size of a frame in caches, so that the frames of a sender cannot fill the memory."""

Result = TypeVar("Result")


class PacketIndex(msgspec.Struct, frozen=True, gc=False):
    """The packets of a frame."""

    kinds: bytes
    """Number in `ALL_KINDS` of each packet."""
    sizes: array[int]
    """Bytes of each packet."""
    ends: array[int]
    """Offset in the frame behind each packet."""

    def count_fitting(self, room: int, first: int = 0) -> int:
        """Return how many packets fit into `room` bytes that begin with packet `first`, those before it included."""
        begin = self.ends[first - 1] if first else 0
        return bisect_right(self.ends, begin + room, first)

    def bytes_of(self, first: int, last: int) -> slice:
        """Return where in the frame packets `first` to `last` - 1 are."""
        return slice(self.ends[first - 1] if first else 0, self.ends[last - 1] if last else 0)

    def part(self, first: int, last: int) -> PacketIndex:
        """Return the index of a frame of packets `first` to `last` - 1."""
        if first == 0 and last == len(self.kinds):
            return self
        sizes = self.sizes[first:last]
        return PacketIndex(self.kinds[first:last], sizes, array("i", accumulate(sizes)))


NO_PACKETS = PacketIndex(b"", array("i"), array("i"))
"""The index of an empty frame, and of bytes that are no packets."""


def cache_short(
    frames: int, most: int = MAX_CACHED_BYTES
) -> Callable[[Callable[[bytes], Result]], Callable[[bytes], Result]]:
    """Cache the results of a function of a frame, for `frames` frames of at most `most` bytes."""

    def decorate(read: Callable[[bytes], Result]) -> Callable[[bytes], Result]:
        cached = lru_cache(frames)(read)

        @wraps(read)
        def read_frame(frame: bytes) -> Result:
            return cached(frame) if len(frame) <= most else read(frame)

        return read_frame

    return decorate


@cache_short(512)
def index_of(frame: bytes) -> PacketIndex:
    """Find the packets of a frame; several callers that hold the same frame get the same index.

    Raises ProtocolError as `protocol.packet_codec.decode`.
    """
    kinds = np.empty(len(frame), np.uint8)
    places = np.empty((2, len(frame)), np.int32)
    count = int(_packets(np.frombuffer(frame, np.uint8), TABLE, kinds, places))
    if count < 0:
        decode(frame, -1 - count)
    sizes, ends = places[:, :count]
    return PacketIndex(kinds[:count].tobytes(), array("i", sizes.tobytes()), array("i", ends.tobytes()))


def ends(frame: bytes) -> Sequence[int]:
    """Return where each packet of a frame ends; ProtocolError as `index_of`."""
    return index_of(frame).ends


def fitting(frame: bytes, room: int) -> bytes:
    """Return the packets at the beginning of a frame that fit into `room` bytes; ProtocolError as `index_of`."""
    if len(frame) <= room:
        return frame
    index = index_of(frame)
    return frame[index.bytes_of(0, index.count_fitting(room))]


def split(frame: bytes) -> list[bytes]:
    """Split a frame into its packets; ProtocolError as `ends`."""
    return [frame[begin:end] for begin, end in pairwise((0, *ends(frame)))]


@kernel
def packet_end(data: ReadOnlyUint8s, at: int, end: int, table: Int64Rows) -> int:
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
        size += LENGTH_HEAD
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


@kernel
def _packets(data: ReadOnlyUint8s, table: Int64Rows, kinds: Uint8s, places: Int32Rows) -> int:
    """Write the kind, size and end of each packet; return their number, or -1 - `at` if no packet begins at `at`."""
    count = 0
    at = 0
    while at < len(data):
        kinds[count] = table[data[at], 0]
        end = packet_end(data, at, len(data), table)
        if end < 0:
            return -1 - at
        places[0, count], places[1, count] = end - at, end
        at = end
        count += 1
    return count
