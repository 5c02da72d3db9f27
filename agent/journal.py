"""A journal: records at the end of a file, of which the last may be torn; what was read once is never lost.

A robot that is killed leaves its journal behind, and begins its next life with it (`agent.identity`). A record is its
length and its checksum, four bytes each, and its bytes; it is written at one go. Where a crash has cut it off, or has
left something else, all from there on is cut away as the journal is opened.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import BinaryIO

_HEAD = struct.Struct("<II")

MOST = 1 << 16
"""Bytes of a record at most: what says that it is longer is no record."""


def journal_name(robot: int) -> str:
    """What the file of a robot's journal is called."""
    return f"r{robot}.journal"


class JournalError(ValueError):
    """A journal that does not belong here: the message says what is wrong."""


class Journal:
    """An append-only list of records.

    Parameters
    ----------
    file : binary file
        Open for reading and writing; read from its beginning.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.records: list[bytes] = []
        """All whole records."""
        file.seek(0)
        data = file.read()
        end = 0
        while (record := _record_at(data, end)) is not None:
            self.records.append(record)
            end += _HEAD.size + len(record)
        file.truncate(end)
        file.seek(end)

    @classmethod
    def open(cls, path: Path) -> Journal:
        """Open the journal at `path`; make it if there is none. OSError if that cannot be."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        return cls(path.open("r+b", buffering=0))

    def append(self, record: bytes) -> None:
        """Write a record; it is in the system's hands when this returns."""
        if len(record) > MOST:
            raise ValueError(f"a record of {len(record)} bytes: at most {MOST}")
        self._file.write(_HEAD.pack(len(record), zlib.crc32(record)) + record)
        self._file.flush()
        self.records.append(record)


def _record_at(data: bytes, offset: int) -> bytes | None:
    """The record at an offset; None if there is none, or it is not whole."""
    if len(data) < offset + _HEAD.size:
        return None
    length, checksum = _HEAD.unpack_from(data, offset)
    record = data[offset + _HEAD.size : offset + _HEAD.size + length]
    return record if len(record) == length <= MOST and zlib.crc32(record) == checksum else None
