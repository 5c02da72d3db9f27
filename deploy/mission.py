"""One run, from a scenario to its directory: what `murmur explore` and Python callers share."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deploy import in_memory, launch, rundir
from deploy import plan as plans
from deploy.plan import Plan
from deploy.records import Records
from deploy.scenario import Scenario
from deploy.summary import summarise

EXPLORED, NOT_FINISHED, BAD_INPUT, BROKEN_OFF = range(4)
"""Exit codes of the contract."""


@dataclass(frozen=True, eq=False)
class Result:
    """What a run brought.

    Attributes
    ----------
    summary : dict
        The figures of ``summary.json``.
    exit_code : int
        `EXPLORED`, `NOT_FINISHED` or `BROKEN_OFF`.
    directory : Path or None
        Where everything was written; None if nothing was to be.
    records : Records
        All that was recorded, in memory.
    deaths : dict
        Processes that ended before their time, with their last words.
    """

    summary: dict[str, Any]
    exit_code: int
    directory: Path | None
    records: Records
    deaths: dict[str, str]


def explore(
    scenario: Scenario,
    *,
    out: Path | None = None,
    keep: bool = True,
    watch: Callable[[Plan, Records], object] | None = None,
) -> Result:
    """Run a scenario.

    Parameters
    ----------
    scenario : Scenario
        ``deploy.scenario.parse({...})`` or ``deploy.scenario.load(path, {})`` makes one.
    out : Path, optional
        The run directory; found under ``runs`` if left out.
    keep : bool
        Whether to write a run directory at all.
    watch : callable, optional
        Called with the plan and the records while the run goes on.

    Raises
    ------
    ScenarioError
        The scenario cannot be run; nothing has been started.
    """
    plan = plans.make(scenario)
    directory = rundir.create(out, plan) if keep else None
    began = time.perf_counter()

    def look(records: Records) -> None:
        if watch is not None:
            watch(plan, records)

    with rundir.open_capture(directory, plan) as capture:
        if scenario.bus == "memory":
            outcome = launch.Outcome(in_memory.run(plan, look, capture), {})
        else:
            outcome = launch.run(plan, directory / rundir.LOGS if directory else None, look, capture)
    return conclude(plan, outcome, directory, time.perf_counter() - began)


def conclude(plan: Plan, outcome: launch.Outcome, directory: Path | None, wall_s: float) -> Result:
    """Sum a run up and write its results."""
    summary = summarise(plan, outcome.records, wall_s)
    if directory is not None:
        rundir.write_results(directory, plan, outcome.records, summary)
    return Result(summary, _exit_code(outcome, summary), directory, outcome.records, outcome.deaths)


def _exit_code(outcome: launch.Outcome, summary: dict[str, Any]) -> int:
    if outcome.deaths or outcome.records.lost or outcome.records.end is None:
        return BROKEN_OFF
    return EXPLORED if summary["finished"] else NOT_FINISHED
