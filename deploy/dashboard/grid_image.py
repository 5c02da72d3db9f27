"""Grids as small PNG pictures, without unpacking their cells."""

from __future__ import annotations

import struct
import zlib

from deploy.record.colors import ALARM, CELLS


def map_picture(width: int, height: int, cells: bytes) -> bytes:
    """Return a PNG picture of a grid as `protocol.messages.grid_to_bytes` writes it.

    The packed rows are valid rows of a PNG with four colors.
    """
    row = -(-width // 4)
    rows = b"".join(b"\0" + cells[row * y : row * (y + 1)] for y in range(height))
    palette = bytes(value for color in (*CELLS, ALARM) for value in color)
    return (
        b"\x89PNG\r\n\x1a\n"
        + _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 2, 3, 0, 0, 0))
        + _chunk(b"PLTE", palette)
        + _chunk(b"IDAT", zlib.compress(rows, 6))
        + _chunk(b"IEND", b"")
    )


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
