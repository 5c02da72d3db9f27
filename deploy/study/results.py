"""The table of runs: a row a run, a parquet file that is written whole or not at all.

A run is known by its key, which follows from its scenario and its map alone; many experiments can share a table,
and a run that two of them ask for is made once. `Results` is the open table. It is written again when runs have
been added, so that whoever is killed loses the last moments' runs and nothing else: they are made again, and the
table is the same. Its rows are in the order of their settings, not in that in which runs ended.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import polars as pl

from worldsim.atomic_files import write_whole

Row = dict[str, Any]
"""A run: its key, its settings and its figures, by column; nested figures have dots in their names."""

KEY, CODE, ERROR = "key", "code", "error"
IDENTITY = (KEY, CODE, ERROR)
"""Columns of every table: the run's key, the code that made it, and why it failed (null: it did not)."""

ORDER = (
    "map",
    "strategy",
    "map_encoding",
    "dissemination",
    "bandwidth",
    "range",
    "robots",
    "map_seed",
    "seed",
)
"""Settings by which rows are sorted, before their key, and the first columns after `IDENTITY`; the others are sorted
by name, so that a table does not tell which run was over first."""

PATIENCE = 20
"""A table is written when its last writing took less than this part of the time since."""


def make_folder(folder: Path) -> None:
    """Make a folder for results, if it is not there; ValueError if that cannot be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"{folder}: no folder can be made there ({error.strerror}); name another") from None


class Results:
    """An open table of runs; use it in a ``with`` statement.

    Parameters
    ----------
    file : Path, optional
        Where it is kept; without one, only in memory.

    Raises
    ------
    ValueError
        The file cannot be written, holds something else, or another process has it open.
    """

    def __init__(self, file: Path | None) -> None:
        self._file = file
        self._added: dict[str, Row] = {}
        self._is_behind = False
        """Whether there are runs that the file has not."""
        self._lock: int | None = None
        self._frame = pl.DataFrame(schema=dict.fromkeys(IDENTITY, pl.String))
        self._written, self._took = time.monotonic(), 0.0
        if file is not None:
            self._lock = _locked(file)
            try:
                self._frame = read(file)
                if not file.exists():
                    self.write()
            except BaseException:
                os.close(self._lock)
                raise
        self._known = dict(self._frame.select(KEY, CODE).iter_rows())
        self._failed = set(self._frame.filter(pl.col(ERROR).is_not_null())[KEY])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self._is_behind:
                self.write()
        finally:
            if self._lock is not None:
                os.close(self._lock)

    def knows(self, key: str, code: str | None, *, retry: bool = False) -> bool:
        """Whether a run is there, made by `code` (None: by whichever); with `retry` failed ones do not count."""
        if key not in self._known or (retry and key in self._failed):
            return False
        return code is None or self._known[key] == code

    def rename(self, key_of: Callable[[Row], str]) -> None:
        """Give each run that has not failed the key that `key_of` finds for its row."""
        plain = [name for name, kind in self.frame.schema.items() if not isinstance(kind, pl.List)]
        found = {
            row[KEY]: row[KEY] if row[ERROR] is not None else key_of(row)
            for row in self.frame.select(plain).iter_rows(named=True)
        }
        renamed = self.frame.with_columns(pl.col(KEY).replace(found)).unique(
            KEY, keep="last", maintain_order=True
        )
        self._is_behind = self._is_behind or any(old != new for old, new in found.items())
        self._frame = renamed
        self._known = dict(renamed.select(KEY, CODE).iter_rows())

    def add(self, row: Row) -> None:
        """Add a run, in place of the one with the same key; the file is written now or soon."""
        self._added[row[KEY]] = row
        self._is_behind = True
        self._known[row[KEY]] = row[CODE]
        self._failed.discard(row[KEY])
        if row[ERROR] is not None:
            self._failed.add(row[KEY])
        if time.monotonic() - self._written >= PATIENCE * self._took:
            self.write()

    @property
    def frame(self) -> pl.DataFrame:
        """The whole table."""
        if self._added:
            fresh = pl.DataFrame(list(self._added.values()), infer_schema_length=None)
            old = self._frame.filter(~pl.col(KEY).is_in(list(self._added)))
            whole = pl.concat([old, fresh], how="diagonal_relaxed")
            first = [name for name in ORDER if name in whole.columns]
            others = sorted(set(whole.columns) - {*IDENTITY, *first})
            self._frame = whole.select(*IDENTITY, *first, *others).sort([*first, KEY], nulls_last=True)
            self._added.clear()
        return self._frame

    def rows(self, keys: Iterable[str]) -> dict[str, Row]:
        """Runs by their keys, without their series; those that are not there are left out."""
        frame = self.frame
        plain = [name for name, kind in frame.schema.items() if not isinstance(kind, pl.List)]
        found = frame.select(plain).filter(pl.col(KEY).is_in(list(keys)))
        return {row[KEY]: row for row in found.iter_rows(named=True)}

    def series(self, name: str, keys: Iterable[str]) -> dict[str, list[float]]:
        """A series over the steps of each run that has it (``explored``, ``carried``)."""
        if name not in self.frame.columns:
            return {}
        found = self.frame.select(KEY, name).filter(
            pl.col(KEY).is_in(list(keys)) & pl.col(name).is_not_null()
        )
        return dict(found.iter_rows())

    def write(self) -> None:
        """Write the file."""
        if self._file is not None:
            began = time.monotonic()
            with _named(self._file):
                write_whole(self._file, self.frame.write_parquet)
            self._is_behind = False
            self._written = time.monotonic()
            self._took = self._written - began


def read(file: Path) -> pl.DataFrame:
    """Read a table of runs; an empty one if there is no such file; ValueError if it holds something else."""
    with _named(file):
        if not file.exists():
            return pl.DataFrame(schema=dict.fromkeys(IDENTITY, pl.String))
        try:
            frame = pl.read_parquet(file)
        except pl.exceptions.PolarsError:
            frame = pl.DataFrame()
    if not set(IDENTITY) <= set(frame.columns):
        raise ValueError(f"{file}: holds no table of runs; name a new file")
    return frame


def write_table(frame: pl.DataFrame, file: Path) -> None:
    """Write a table as CSV or parquet, by its name's ending; ValueError for any other, or if it cannot be written."""
    writers: dict[str, Callable[[Any], object]] = {".csv": frame.write_csv, ".parquet": frame.write_parquet}
    if file.suffix not in writers:
        raise ValueError(f"{file}: tables are written as {' or '.join(writers)}")
    with _named(file):
        write_whole(file, writers[file.suffix])


def _locked(file: Path) -> int:
    """Keep other processes from opening the table; the lock ends with this process, however it ends."""
    with _named(file):
        lock = os.open(file.with_name(f".{file.name}.lock"), os.O_CREAT | os.O_RDWR, 0o644)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise ValueError(
            f"{file}: another process is adding runs to it; wait for it, or name another file"
        ) from None
    return lock


class _named:  # noqa: N801  used like a statement
    """Turn what is wrong with a file into a message."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        if isinstance(error, OSError):
            raise ValueError(
                f"{self._file}: {error.strerror or error}; name a file that can be written"
            ) from None
