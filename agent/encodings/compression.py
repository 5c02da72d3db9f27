"""Compression with zstd (RFC 8878), and decompression of data that may be malformed, within bounds."""

from __future__ import annotations

import sys

import numpy as np

from protocol.arrays import ReadOnlyUint8s
from protocol.errors import ProtocolError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

WINDOW = 22
"""Largest window that a received frame may request, as a power of two in bytes."""


def compress(data: bytes, level: int) -> bytes:
    """Return a zstd frame."""
    return zstd.compress(data, level)


def decompress(frame: bytes, size: int, name: str) -> ReadOnlyUint8s:
    """Return the `size` bytes in a zstd frame, one per cell.

    ProtocolError, which begins with `name`, if it is malformed, or holds more or less; no more is decompressed then.
    """
    reader = zstd.ZstdDecompressor(options={zstd.DecompressionParameter.window_log_max: WINDOW})
    try:
        data = reader.decompress(frame, size + 1)
    except zstd.ZstdError as error:
        raise ProtocolError(name, 0, str(error)) from None
    if len(data) != size or not reader.eof or reader.unused_data:
        raise ProtocolError(name, 0, f"the zstd frame does not hold {size} cells")
    return np.frombuffer(data, np.uint8)
