"""Parts of a robot's maps: the recorder requests them one after the other, so that no message is large.

A part is a run of cells, row after row, with one byte per cell. Bits 0-1 are the value on the robot's own map, bits 2-3
the value on its planning map (as `protocol.messages.MapChanges`). Bit 4 is set if the robot is certain of the own
value: the cell is settled. Bits 5-6 are the value on the shared map as the robot holds it
(`agent.encodings.base.MapEncoding.shared_map`). Parts travel compressed with zlib.
"""

from __future__ import annotations

import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.errors import ProtocolError
from protocol.grid import OCCUPIED, UNKNOWN, Grid, Mask
from protocol.message_fields import PART_CELLS

LEVEL = 1
"""Compression level of zlib: maps consist of long runs, which the fastest level compresses well."""


def count(cells: int) -> int:
    """Return the number of parts of a map with this number of cells."""
    return -(-cells // PART_CELLS)


class FinalMaps(NamedTuple):
    """A robot's maps at the end of a run, arrays of shape (h, w)."""

    own: Grid
    """The self-explored grid."""
    planning: Grid
    """The planning grid."""
    shared: Grid
    """The shared map as the robot holds it."""
    settled: Mask
    """The cells of the self-explored grid of which the robot is certain."""


def join(maps: FinalMaps) -> NDArray[np.uint8]:
    """Return a robot's maps as one array with a byte per cell, shape (h * w)."""
    settled = maps.settled.astype(np.uint8) << np.uint8(4)
    values: Grid = maps.own | maps.planning << np.uint8(2) | settled | maps.shared << np.uint8(5)
    return values.ravel()


def split(cells: NDArray[np.uint8], shape: tuple[int, int]) -> FinalMaps:
    """Return the maps that `join` has put into one array."""
    values = cells.reshape(shape)
    own, planning, shared = (values >> np.uint8(bits) & np.uint8(3) for bits in (0, 2, 5))
    return FinalMaps(own, planning, shared, values >> np.uint8(4) & np.uint8(1) == 1)


def encode(cells: NDArray[np.uint8], part: int) -> bytes:
    """Compress a part of an array that `join` returned."""
    return zlib.compress(cells[part * PART_CELLS : (part + 1) * PART_CELLS].tobytes(), LEVEL)


def decode(data: bytes, part: int, cells: int) -> NDArray[np.uint8]:
    """Read a part of a map with this number of cells; ProtocolError if it is malformed or has another size."""
    expected = min(PART_CELLS, cells - part * PART_CELLS)
    reader = zlib.decompressobj()
    try:
        values = np.frombuffer(reader.decompress(data, expected + 1), np.uint8)
    except zlib.error as error:
        raise ProtocolError("MapPart", 0, f"not compressed with zlib ({error})") from None
    if len(values) != expected or not reader.eof or reader.unused_data:
        raise ProtocolError("MapPart", 0, f"part {part} does not have {expected} cells")
    if max(int((values >> bits & 3).max()) for bits in (0, 2, 5)) > OCCUPIED or values.max() >> 7:
        raise ProtocolError("MapPart", 0, "a cell that is not free, occupied or unknown")
    if ((values >> 4 & 1 == 1) & (values & 3 == UNKNOWN)).any():
        raise ProtocolError("MapPart", 0, "an unknown cell that is settled")
    return values
