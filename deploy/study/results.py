"""The table of runs: one row per run, in a parquet file that is always written completely.

A key identifies a run; it follows from scenario, measure and map. Many experiments can share a table, and a run that
several of them contain is made once. `Results` is the open table. It is written again while runs are added, so that a
killed process loses only the last runs. Rows are sorted by their settings, not by the time of their end.
"""

from __future__ import annotations

import fcntl
import io
import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import polars as pl

from deploy.study import checked_parquet
from protocol.files import check_regular
from protocol.signals import held
from worldsim.atomic_files import DISK_ERRORS, link_target, write_whole

Row = dict[str, Any]
"""A run: key, settings and metrics by column; nested metrics have dotted names."""

PLACE = "place"
"""Key of a row for its position in an experiment: values of the grid's keys, and its variant; not in the table."""

KEY, CODE, ERROR = "key", "code", "error"
IDENTITY = (KEY, CODE, ERROR)
"""Columns of every table: the run's key, the version of the code, and the error (null: none)."""

ORDER = (
    "map", "strategy", "map_encoding", "dissemination", "bandwidth", "range", "robots", "map_seed", "seed",
)  # fmt: skip
"""The first columns after `IDENTITY`, by which rows are sorted before their key; other columns are sorted by name."""

MAX_WRITING_SHARE = 1 / 20
"""Maximum share of the time that is spent on writing the table."""


class Results:
    """An open table of runs; use it in a ``with`` statement.

    `file` is the file of the table, or a link to it; without one, the table is only in memory. Raises ValueError if it
    cannot be written, is not a table of runs, or is open in another process.
    """

    def __init__(self, file: Path | None) -> None:
        if file is not None:
            with _named(file):
                file = link_target(file)
        self._file = file
        self._added: dict[str, Row] = {}
        self._is_behind = False
        """Whether the file lacks some runs."""
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

    def __exit__(self, *_: object) -> None:
        try:
            if self._is_behind:
                self.write()
        finally:
            if self._lock is not None:
                os.close(self._lock)

    def knows(self, key: str, code: str, *, retry: bool = False) -> bool:
        """Return whether the table has a run made by `code`; with `retry`, failed runs do not count."""
        return self._known.get(key) == code and not (retry and key in self._failed)

    def add(self, row: Row) -> None:
        """Add a run, or replace the run with the same key; the file is written now or soon."""
        self._added[row[KEY]] = row
        self._is_behind = True
        self._known[row[KEY]] = row[CODE]
        self._failed.discard(row[KEY])
        if row[ERROR] is not None:
            self._failed.add(row[KEY])
        if MAX_WRITING_SHARE * (time.monotonic() - self._written) >= self._took:
            self.write()

    @property
    def frame(self) -> pl.DataFrame:
        """The whole table."""
        if self._added:
            fresh = pl.DataFrame(list(self._added.values()), infer_schema_length=None)
            old = self._frame.filter(~pl.col(KEY).is_in(list(self._added)))
            whole = self._joined(old, fresh)
            first = [name for name in ORDER if name in whole.columns]
            others = sorted(set(whole.columns) - {*IDENTITY, *first})
            self._frame = whole.select(*IDENTITY, *first, *others).sort([*first, KEY], nulls_last=True)
            self._added.clear()
        return self._frame

    def _joined(self, old: pl.DataFrame, fresh: pl.DataFrame) -> pl.DataFrame:
        """All rows; ValueError if a column has types that do not fit, as in tables of some earlier versions."""
        try:
            return pl.concat([old, fresh], how="diagonal_relaxed")
        except (pl.exceptions.SchemaError, pl.exceptions.InvalidOperationError):
            name = next(
                each for each in fresh.columns if each in old.columns and not _fit(old[each], fresh[each])
            )
            raise ValueError(
                f"{self._file}: column {name} has values of the type {old.schema[name]}, but new runs have "
                f"{fresh.schema[name]}; it is a table of another version: name a new file"
            ) from None

    def rows(self, keys: Iterable[str]) -> dict[str, Row]:
        """The existing runs among some keys, without their series."""
        frame = self.frame
        plain = [name for name, kind in frame.schema.items() if not isinstance(kind, pl.List)]
        found = frame.select(plain).filter(pl.col(KEY).is_in(list(keys)))
        return {row[KEY]: row for row in found.iter_rows(named=True)}

    def series(self, name: str, keys: Iterable[str]) -> dict[str, list[float]]:
        """A series over the steps (``explored``, ``carried``), by the keys of the runs that have it."""
        if name not in self.frame.columns:
            return {}
        found = self.frame.select(KEY, name).filter(
            pl.col(KEY).is_in(list(keys)) & pl.col(name).is_not_null()
        )
        return dict(found.iter_rows())

    def write(self) -> None:
        """Write the file, even if Ctrl-C comes meanwhile."""
        if self._file is not None:
            began = time.monotonic()
            with held(), _named(self._file):
                data = checked_parquet.serialize(self.frame)
                write_whole(self._file, lambda opened: opened.write(data))
                self._is_behind = False
                self._written = time.monotonic()
                self._took = self._written - began


def open_results(out: Path | str | None) -> Results:
    """Open the table of runs in file `out`, and make its folder; without a file, one in memory. Errors: `Results`."""
    if out is None:
        return Results(None)
    file = Path(out)
    if file.suffix != ".parquet":
        raise ValueError(f"out = {str(out)!r}: is a Parquet file; its name must end in .parquet")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(
            f"{file.parent}: cannot be created ({error.strerror}); name another folder"
        ) from None
    return Results(file)


def read(file: Path) -> pl.DataFrame:
    """Read a table of runs; an empty table if the file does not exist; ValueError for any other content."""
    with _named(file):
        if not file.exists():
            return pl.DataFrame(schema=dict.fromkeys(IDENTITY, pl.String))
        check_regular(file)
        try:
            frame = checked_parquet.parse(file.read_bytes())
        except checked_parquet.DamagedError:
            raise ValueError(
                f"{file}: is damaged, changed by another program, or not a Parquet file; "
                "restore a copy, remove it, or name another"
            ) from None
    if any(frame.schema.get(name) not in (pl.String, pl.Null) for name in IDENTITY):
        raise ValueError(f"{file}: is not a table of runs; name a new file")
    return frame


def write_table(frame: pl.DataFrame, file: Path) -> None:
    """Write a table as CSV or parquet, by the suffix of its name.

    Raises ValueError for other suffixes and for names that cannot be written, OSError if the disk is full.
    """
    writers: dict[str, Callable[[Any], object]] = {".csv": frame.write_csv, ".parquet": frame.write_parquet}
    if file.suffix not in writers:
        raise ValueError(f"{file}: must end in {' or '.join(writers)}")
    with _named(file):
        buffer = io.BytesIO()  # polars itself reports a full disk without its number
        writers[file.suffix](buffer)
        write_whole(file, lambda opened: opened.write(buffer.getbuffer()))


def _fit(one: pl.Series, other: pl.Series) -> bool:
    """Whether two columns have a common type."""
    try:
        pl.concat([one.to_frame(), other.to_frame()], how="vertical_relaxed")
    except (pl.exceptions.SchemaError, pl.exceptions.InvalidOperationError):
        return False
    return True


def _locked(file: Path) -> int:
    """Lock the table against other processes; the operating system removes the lock with this process."""
    with _named(file):
        lock = os.open(file.with_name(f".{file.name}.lock"), os.O_CREAT | os.O_RDWR, 0o644)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise ValueError(
            f"{file}: another process is adding runs; wait for it, or name another file"
        ) from None
    return lock


@contextmanager
def _named(file: Path) -> Iterator[None]:
    """Turn an OSError into a ValueError that names the file, unless the disk is full: another name would not help."""
    try:
        yield
    except OSError as error:
        if error.errno in DISK_ERRORS:
            raise
        raise ValueError(f"{file}: {error.strerror or error}; name a file that can be written") from None
