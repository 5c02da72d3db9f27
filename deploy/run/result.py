"""The result of a run: its figures, tables, and maps, and how they are computed from the records and written."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deploy.record import run_directory
from deploy.record.number_texts import counted
from deploy.record.pandas_tables import to_pandas
from deploy.record.records import Records
from deploy.record.summary import summarize
from deploy.run import launch
from deploy.run.control import as_it_went
from deploy.run.exit_codes import BROKEN_OFF, EXPLORED, NOT_FINISHED
from deploy.scenario.plan import Plan
from protocol.grid import Grid

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """The results of a run. A notebook displays its maps and figures."""

    summary: dict[str, Any]
    """The figures of ``summary.json``."""
    exit_code: int
    """`EXPLORED`, `NOT_FINISHED` or `BROKEN_OFF`."""
    directory: Path | None
    """The run directory; None if nothing was written."""
    records: Records
    """Everything that was recorded, in memory."""
    deaths: dict[str, str]
    """Participants that ended unexpectedly, with their crash report: the traceback of an exception, else the last line
    of output. On the memory bus, a robot whose code raises is lost in the same way.
    """
    plan: Plan
    """The plan of the run, with its scenario and map."""
    view_fault: str = ""
    """Error of the viewer, without which the run continued; empty if there was none."""

    @cached_property
    def steps(self) -> pl.DataFrame:
        """One row per step and robot: its pose and state; meters in the map's frame (``steps.parquet``)."""
        return frame(run_directory.steps_table(self.plan, self.records))

    @cached_property
    def ledger(self) -> pl.DataFrame:
        """One row per frame and packet kind (``ledger.parquet``; docs/protocol.md, The ledger)."""
        return frame(run_directory.ledger_table(self.records.ledger()))

    def to_pandas(self) -> dict[str, pd.DataFrame]:
        """Return the tables as pandas frames: ``"steps"`` and ``"ledger"``, with the columns of the parquet files.

        Raises MissingPackageError, an ImportError, if pandas is not installed.
        """
        return to_pandas(steps=self.steps, ledger=self.ledger)

    @property
    def maps(self) -> dict[str | int, Grid]:
        """The maps at the end, uint8 arrays of shape (h, w), row 0 on top.

        ``"truth"``, which robots in the field do not have; ``"team"``, the union of the cells that the robots have seen
        themselves; and by number the planning grid of each robot that has reported its maps.
        """
        named: dict[str | int, Grid] = {"truth": self.plan.map.cells} if self.plan.has_truth else {}
        if self.records.own:
            named["team"] = self.records.team_map()
        return named | dict(sorted(self.records.planning.items()))

    def plot(self) -> Figure:
        """The world with all paths, the team's map, and each robot's planning grid, as in ``maps.png``.

        Raises ValueError if no robot has reported its maps.
        """
        from deploy.record.map_pictures import maps_figure  # noqa: PLC0415  half a second to import

        if not self.records.own:
            raise ValueError("there are no maps to plot: no robot has reported its maps")
        return maps_figure(self.plan, self.records, self.summary)

    def __repr__(self) -> str:
        summary = self.summary
        ended = "explored" if summary["finished"] else summary["reason"]
        where = f", in {self.directory}" if self.directory is not None else ""
        share = f"coverage {summary['coverage']:.3f}, " if summary["coverage"] is not None else ""
        return (
            f"<Result: {counted(summary['robots'], 'robot')} on {summary['map']}, {ended} after "
            f"{counted(summary['steps'], 'step')}, "
            f"{share}{summary['bytes']['total']} bytes{where}>"
        )

    def __str__(self) -> str:
        return "\n".join([repr(self), *(f"{name} died: {crash}" for name, crash in self.deaths.items())])

    def _repr_html_(self) -> str:
        """Return the result as HTML, for notebooks."""
        rows = "".join(
            f"<tr><td>{name}</td><td>{escape(str(self.summary[name]))}</td></tr>" for name in _SHOWN
        )
        picture = ""
        if self.records.own:
            file = io.BytesIO()
            self.plot().savefig(file, format="png", dpi=80)
            picture = f'<img src="data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}">'
        deaths = "".join(f"<pre>{name} died: {escape(crash)}</pre>" for name, crash in self.deaths.items())
        return f"<p>{escape(repr(self)[1:-1])}</p>{deaths}{picture}<table>{rows}</table>"


_SHOWN = (
    "steps", "coverage", "map_accuracy", "mean_map_accuracy", "worst_map_accuracy", "t90", "t99", "strategy",
    "map_encoding", "bandwidth", "digest",
)  # fmt: skip
"""Keys of the summary that a notebook shows."""


def conclude(plan: Plan, outcome: launch.Outcome, directory: Path | None, wall_s: float) -> Result:
    """Summarize a run and write its results; the scenario of the result contains the events of the run."""
    summary = summarize(plan, outcome.records, wall_s)
    done = as_it_went(plan, outcome.records)
    if directory is not None:
        if done is not plan:
            run_directory.write_inputs(directory, done)
        run_directory.write_results(directory, done, outcome.records, summary, outcome.failures)
    code = _exit_code(outcome, summary)
    return Result(summary, code, directory, outcome.records, outcome.deaths, done, outcome.view_fault)


def _exit_code(outcome: launch.Outcome, summary: dict[str, Any]) -> int:
    end = outcome.records.end
    if outcome.deaths or outcome.records.lost or end is None or end.step < 0:
        return BROKEN_OFF
    return EXPLORED if summary["finished"] else NOT_FINISHED


def frame(table: Any) -> pl.DataFrame:
    """Return an arrow table as a polars frame."""
    import polars  # noqa: PLC0415  slow to import, and few callers need it

    frame = polars.from_arrow(table)
    assert isinstance(frame, polars.DataFrame)
    return frame
