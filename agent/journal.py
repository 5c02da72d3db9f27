"""An append-only file of records that survives crashes (a write-ahead log).

The journal of a killed robot is the input of its next incarnation (`agent.identity`). A record consists of its length
and its CRC-32, four bytes each, and its content; one write call writes it. When a journal is opened, the file is
truncated at the first incomplete or damaged record.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import BinaryIO

_HEAD = struct.Struct("<II")

MAX_RECORD = 1 << 16
"""Largest size of a record's content in bytes; a larger length field means a damaged record."""


def journal_name(robot: int) -> str:
    """Return the name of a robot's journal file."""
    return f"r{robot}.journal"


class JournalError(ValueError):
    """A journal is malformed or belongs to another robot; the message has the reason."""


class Journal:
    """An append-only list of records in a file that is open for reading and writing."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.records: list[bytes] = []
        """The contents of all complete records."""
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
        """Open the journal at `path`; create an empty one if the file is missing. May raise OSError."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        return cls(path.open("r+b", buffering=0))

    def append(self, record: bytes) -> None:
        """Write a record; the operating system has it when this returns."""
        if len(record) > MAX_RECORD:
            raise ValueError(f"a record of {len(record)} bytes is longer than {MAX_RECORD}")
        self._file.write(_HEAD.pack(len(record), zlib.crc32(record)) + record)
        self._file.flush()
        self.records.append(record)


def _record_at(data: bytes, offset: int) -> bytes | None:
    """Return the record at an offset; None if it is missing, incomplete or damaged."""
    if len(data) < offset + _HEAD.size:
        return None
    length, checksum = _HEAD.unpack_from(data, offset)
    record = data[offset + _HEAD.size : offset + _HEAD.size + length]
    return record if len(record) == length <= MAX_RECORD and zlib.crc32(record) == checksum else None
