"""A finished run, read from its directory into Python: its summary and its tables."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deploy.after.archive import read
from deploy.record.pandas_tables import to_pandas
from deploy.record.run_directory import LEDGER, STEPS

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


@dataclass(frozen=True, eq=False, repr=False)
class RecordedRun:
    """A run directory."""

    directory: Path
    summary: dict[str, Any]
    """The figures of ``summary.json``."""

    @cached_property
    def steps(self) -> pl.DataFrame:
        """One row per step and robot: its pose and state; meters in the map's frame (``steps.parquet``)."""
        return _frame(self.directory / STEPS)

    @cached_property
    def ledger(self) -> pl.DataFrame:
        """One row per frame and packet kind (``ledger.parquet``)."""
        return _frame(self.directory / LEDGER)

    def to_pandas(self) -> dict[str, pd.DataFrame]:
        """Return the tables as pandas frames, as `Result.to_pandas` does."""
        return to_pandas(steps=self.steps, ledger=self.ledger)

    def report(self) -> Path:
        """Write ``report.html`` into the directory, as ``murmur report`` does, and return it."""
        from deploy.after.report import write_report  # noqa: PLC0415  loads matplotlib

        return write_report(self.directory)

    def __repr__(self) -> str:
        return f"<RecordedRun: {self.summary['robots']} robots on {self.summary['map']}, in {self.directory}>"


def read_run(directory: Path | str) -> RecordedRun:
    """Read a run directory: its summary, and its tables as polars or pandas frames.

    Parameters
    ----------
    directory : Path or str
        As `explore` or ``murmur explore --out`` writes it.

    Raises
    ------
    ScenarioError
        It is not a run directory, or a table is missing or damaged.
    """
    archive = read(Path(directory))
    return RecordedRun(archive.directory, archive.summary)


def _frame(path: Path) -> pl.DataFrame:
    import polars  # noqa: PLC0415  slow to import, and few callers need it

    return polars.read_parquet(path)
