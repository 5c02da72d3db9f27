"""A run directory, read back: the input of pictures, reports and exports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.record import run_directory
from deploy.record.columns import FILES
from deploy.record.snapshots import SNAPSHOTS, Snapshots
from deploy.record.summary import budgets
from deploy.run.repeat import maps_over_time, why_unrepeatable
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import ScenarioError

Table = dict[str, NDArray[Any]]
"""Columns by name."""


@dataclass(frozen=True)
class Archive:
    """One run, as recorded in its directory.

    Attributes
    ----------
    directory : Path
    plan : Plan
        The plan derived from its scenario.
    summary : dict
        The figures of ``summary.json``.
    """

    directory: Path
    plan: Plan
    summary: dict[str, Any]

    @cached_property
    def steps(self) -> Table:
        """``steps.parquet``: one row per step and robot, metres in the map's frame."""
        return _read_table(self.directory / run_directory.STEPS)

    @cached_property
    def ledger(self) -> Table:
        """``ledger.parquet``: one row per frame and packet kind."""
        return _read_table(self.directory / run_directory.LEDGER)

    @cached_property
    def budgets(self) -> NDArray[np.float64]:
        """Bytes that the team could put on the air, by step from 0 on; infinite where there is no limit."""
        radio = self.plan.radio
        return budgets(radio.budget, radio.changes, self.last_step + 1)

    def range_m(self, step: int) -> float:
        """The communication range in a step, in metres."""
        told = [
            each.range_mm / 1000
            for each in self.plan.radio.changes
            if each.step <= step and each.range_mm is not None
        ]
        return told[-1] if told else self.plan.range_m

    @property
    def last_step(self) -> int:
        """The last step of the run."""
        return int(self.steps["step"].max(initial=0))

    def of_robot(self, robot: int) -> Table:
        """The rows of `steps` of one robot, in the order of steps."""
        mine = self.steps["robot"] == robot
        return {name: column[mine] for name, column in self.steps.items()}

    def snapshots(self, tell: Callable[[str], object] = lambda _: None) -> Snapshots | None:
        """Robots' maps over time: those that were kept; otherwise the run is repeated in memory to get them.

        None if the run cannot be repeated (`why_unrepeatable`), or its digest differs here. `tell` is called
        with progress messages.
        """
        kept = self.directory / SNAPSHOTS
        if kept.is_file():
            return Snapshots.read(kept)
        if reason := why_unrepeatable(self.summary):
            tell(
                "No maps over time: none were kept (murmur explore --pictures does), and the run cannot be "
                f"repeated: {reason}."
            )
            return None
        tell(
            "No maps over time were kept (murmur explore --pictures does); the run is repeated in memory to get them."
        )
        snapshots = maps_over_time(self.plan, self.summary["digest"])
        if snapshots is None:
            tell("No maps over time: the repeated run differs here (murmur replay says more).")
        return snapshots


def read(directory: Path) -> Archive:
    """Read a run directory; ScenarioError says what is missing."""
    plan = plans.make(run_directory.read_scenario(directory))
    summary = run_directory.read_summary(directory)
    for name in (run_directory.STEPS, run_directory.LEDGER):
        if not (directory / name).is_file():
            raise ScenarioError(f"{directory}: {name} is missing, so there is nothing to tell of this run")
        _check_columns(directory / name)
    return Archive(directory, plan, summary)


def _check_columns(path: Path) -> None:
    """ScenarioError if a table of a run cannot be read, or lacks a column that such tables have."""
    from pyarrow import ArrowInvalid, parquet  # noqa: PLC0415  as below

    try:
        there = parquet.read_schema(path).names
    except ArrowInvalid as error:
        raise ScenarioError(f"{path}: is not a whole table ({error})") from None
    lacking = [column.name for column in FILES[path.name] if column.name not in there]
    if lacking:
        raise ScenarioError(f"{path}: is not that of a run, for it has no {', '.join(lacking)}")


def _read_table(path: Path) -> Table:
    from pyarrow import parquet  # noqa: PLC0415  takes half a second to import

    table = parquet.read_table(path)
    return {name: np.asarray(table[name].to_numpy(zero_copy_only=False)) for name in table.column_names}
