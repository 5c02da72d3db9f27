"""Parquet files that contain the SHA-256 of their own bytes, so that a flipped bit is an error.

Parquet itself detects only some damage: polars writes no checksums of pages, reads other values from most damaged
files, and ends the process at some of them. The digest is checked before the file is parsed. It is the value of a key
of the file's metadata, so other programs read the file as any other; it is computed with zeros in its place.
"""

from __future__ import annotations

import hashlib
import io
import re

import polars as pl

KEY = "murmur_sha256"
"""Key of the digest in the metadata of the file."""

_ZEROS = b"0" * 64

_DIGEST = re.compile(re.escape(KEY.encode()) + rb"\x18\x40(.{64})", re.DOTALL)
"""The key, then the value as Thrift's compact protocol writes it: type of the field, length, hexadecimal digits."""


class DamagedError(ValueError):
    """The file is damaged, or not a Parquet file."""


def serialize(frame: pl.DataFrame) -> bytes:
    """Return a Parquet file with its digest."""
    buffer = io.BytesIO()
    frame.write_parquet(buffer, metadata={KEY: _ZEROS.decode()})
    data = buffer.getvalue()
    begin, end = _last_digest(data)
    if data[begin:end] != _ZEROS:
        raise RuntimeError("this version of polars writes the metadata of a Parquet file in another form")
    return data[:begin] + _digest(data, begin, end) + data[end:]


def parse(data: bytes) -> pl.DataFrame:
    """Read a Parquet file, and check the digest if it has one; DamagedError if it differs, or for other content."""
    begin, end = _last_digest(data)
    if begin and data[begin:end] != _digest(data, begin, end):
        raise DamagedError
    try:
        return pl.read_parquet(io.BytesIO(data))
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException):
        raise DamagedError from None


def _last_digest(data: bytes) -> tuple[int, int]:
    """Return where the digest begins and ends; (0, 0) if there is none, as in tables of earlier versions."""
    spans = [match.span(1) for match in _DIGEST.finditer(data)]
    return spans[-1] if spans else (0, 0)


def _digest(data: bytes, begin: int, end: int) -> bytes:
    """Return the SHA-256 of a file with zeros in place of its digest, in hexadecimal."""
    total = hashlib.sha256(data[:begin])
    total.update(_ZEROS)
    total.update(data[end:])
    return total.hexdigest().encode()
