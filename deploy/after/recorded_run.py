"""A finished run, read from its directory into Python: its summary, tables, and maps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deploy.after.archive import read
from deploy.record.pandas_tables import to_pandas
from deploy.record.run_directory import LEDGER, STEPS
from deploy.scenario.plan import Plan
from protocol.grid import Grid
from worldsim.maps import load

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


@dataclass(frozen=True, eq=False, repr=False)
class RecordedRun:
    """A run directory."""

    directory: Path
    summary: dict[str, Any]
    """The figures of ``summary.json``."""
    plan: Plan
    """The plan of the run, derived from its scenario."""

    @cached_property
    def steps(self) -> pl.DataFrame:
        """One row per step and robot: its pose and state; meters in the map's frame (``steps.parquet``)."""
        return _frame(self.directory / STEPS)

    @cached_property
    def ledger(self) -> pl.DataFrame:
        """One row per frame and packet kind (``ledger.parquet``)."""
        return _frame(self.directory / LEDGER)

    @cached_property
    def maps(self) -> dict[str | int, Grid]:
        """The maps at the end by name and robot, as `Result.maps`, from ``team.yaml`` and ``planning-rN.yaml``."""
        named: dict[str | int, Grid] = {"truth": self.plan.map.cells} if self.plan.has_truth else {}
        files = {"team": "team.yaml"} | {
            robot: f"planning-r{robot}.yaml" for robot in range(self.plan.scenario.robots)
        }
        paths = {name: self.directory / file for name, file in files.items()}
        return named | {name: load(path).cells for name, path in paths.items() if path.exists()}

    def to_pandas(self) -> dict[str, pd.DataFrame]:
        """Return the tables as pandas frames, as `Result.to_pandas` does."""
        return to_pandas(steps=self.steps, ledger=self.ledger)

    def report(self, out: Path | str | None = None) -> Path:
        """Write ``report.html`` into the directory, or the page `out`, as ``murmur report`` does; return the page."""
        from deploy.after.report import write_report  # noqa: PLC0415  loads matplotlib

        return write_report(self.directory, out=None if out is None else Path(out))

    def __repr__(self) -> str:
        return f"<RecordedRun: {self.summary['robots']} robots on {self.summary['map']}, in {self.directory}>"


def read_run(directory: Path | str) -> RecordedRun:
    """Read a run directory: its summary, its tables as polars or pandas frames, and its maps as arrays.

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
    return RecordedRun(archive.directory, archive.summary, archive.plan)


def _frame(path: Path) -> pl.DataFrame:
    import polars  # noqa: PLC0415  slow to import, and few callers need it

    return polars.read_parquet(path)
