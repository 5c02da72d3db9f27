"""Parts of a robot's maps: the recorder requests them one after the other, so that no message is large.

A part is a run of cells, row after row, with one byte per cell: bits 0-1 are the value on the robot's own map, bits 2-3
the value on its planning map (as `protocol.messages.MapChanges`), and bit 4 is set if the robot is certain of the own
value: the cell is settled. Parts travel compressed with zlib.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from protocol.errors import ProtocolError
from protocol.grid import OCCUPIED, UNKNOWN, Grid
from protocol.messages import PART_CELLS

Mask = NDArray[np.bool_]

LEVEL = 1
"""Compression level of zlib: maps consist of long runs, which the fastest level compresses well."""


def count(cells: int) -> int:
    """Return the number of parts of a map with this number of cells."""
    return -(-cells // PART_CELLS)


def join(own: Grid, planning: Grid, settled: Mask) -> NDArray[np.uint8]:
    """Return both maps, and the settled cells of the own map, as one array with a byte per cell, shape (h * w)."""
    values: Grid = own | planning << np.uint8(2) | settled.astype(np.uint8) << np.uint8(4)
    return values.ravel()


def split(cells: NDArray[np.uint8], shape: tuple[int, int]) -> tuple[Grid, Grid, Mask]:
    """Return the own map, the planning map and the settled cells that `join` has put into one array."""
    values = cells.reshape(shape)
    return values & np.uint8(3), values >> np.uint8(2) & np.uint8(3), values >> np.uint8(4) == 1


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
    if max(int((values & 3).max()), int((values >> 2 & 3).max())) > OCCUPIED or values.max() >> 5:
        raise ProtocolError("MapPart", 0, "a cell that is not free, occupied or unknown")
    if ((values >> 4 == 1) & (values & 3 == UNKNOWN)).any():
        raise ProtocolError("MapPart", 0, "an unknown cell that is settled")
    return values
