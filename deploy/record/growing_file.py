"""A file that grows during a run. If it cannot be written, the run continues, and the file ends with its last part.

It may be a CSV table, whose whole lines are read again after the run, or after the end of a killed process.
"""

from __future__ import annotations

import contextlib
import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, get_type_hints

import msgspec

from protocol.errors import shown
from protocol.files import open_file

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


class GrowingFile(io.FileIO):
    """A file to which whole parts are appended, at once and unbuffered: blocks of a capture, lines, or messages."""

    failure: OSError | None = None
    """Why the file has ended early: the first error of a write. Further parts are discarded."""

    def write(self, part: ReadableBuffer) -> int:
        """Append a part; if that fails, cut the file back to the last whole one."""
        rest = memoryview(part).cast("B")
        length, end = len(rest), self.tell()
        try:
            while rest and self.failure is None:
                rest = rest[super().write(rest) or 0 :]
        except OSError as error:
            self.failure = OSError(error.errno, error.strerror, str(self.name))
            with contextlib.suppress(OSError):
                self.truncate(end)
        return length

    def write_rows(self, rows: Iterable[Iterable[object]]) -> None:
        """Append lines of a CSV table; None is an empty field."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        self.write(text.getvalue().encode())


Row = TypeVar("Row")


def read_rows(path: Path, kind: type[Row]) -> list[Row]:
    """Read a table that `GrowingFile.write_rows` wrote, up to its last whole line, as rows of a NamedTuple `kind`.

    Empty fields are None. ValueError names the line that is malformed, or the line, the column, and the value that
    `kind` does not permit.
    """
    with open_file(path) as file:
        text = file.read().decode("utf-8", "replace")
    lines = csv.reader(io.StringIO(text[: text.rfind("\n") + 1]))
    names = tuple(get_type_hints(kind))
    try:
        if tuple(next(lines, ())) != names:
            raise ValueError(f"{path}: the first line must be {','.join(names)}")
        return [_row(line, names, kind) for line in lines]
    except (csv.Error, _RowError) as error:
        raise ValueError(f"{path}, line {lines.line_num}: {error}") from None


class _RowError(Exception):
    """A row has a wrong number of values, or a wrong value."""


def _row(line: list[str], names: Sequence[str], kind: type[Row]) -> Row:
    """Convert the fields of a line, one for each of `names`."""
    if len(line) != len(names):
        raise _RowError(f"has {len(line)} values; must have {len(names)}")
    try:
        return msgspec.convert([each or None for each in line], kind, strict=False)
    except msgspec.ValidationError as error:
        wanted, _, place = str(error).partition(" - at `$[")
        column = int(place.partition("]")[0])
        must = wanted.partition(", got")[0].replace("Expected", "must be")
        raise _RowError(f"{names[column]} = {shown(line[column])}: {must}") from None


def close_all(files: Sequence[GrowingFile]) -> None:
    """Close files; OSError if one of them could not be written."""
    for file in files:
        file.close()
    for file in files:
        if file.failure is not None:
            raise file.failure
