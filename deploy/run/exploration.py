"""One run, from a scenario to its directory: what `murmur explore` and Python callers share."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deploy.dashboard.process import RECORDING, ViewTask, watching
from deploy.dashboard.windows import Window, optimise
from deploy.record import run_directory
from deploy.record.records import Records
from deploy.record.summary import summarise
from deploy.run import in_memory, launch
from deploy.run.hosts import Hosts
from deploy.run.interrupt import Interrupt
from deploy.run.ssh import Fleet
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario, ScenarioError
from worldsim.pace import Pace

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
    view_fault : str
        What went wrong with the viewer, without which the run went on.
    """

    summary: dict[str, Any]
    exit_code: int
    directory: Path | None
    records: Records
    deaths: dict[str, str]
    view_fault: str = ""


def explore(
    scenario: Scenario,
    *,
    out: Path | None = None,
    keep: bool = True,
    watch: Callable[[Plan, Records], object] | None = None,
    tell: Callable[[str], object] = lambda _: None,
    window: Window | None = None,
    snapshots: bool = False,
    pace: float | None = None,
    hosts: Hosts | None = None,
) -> Result:
    """Run a scenario. What is shown of it, and at which pace, changes nothing in its results.

    Parameters
    ----------
    scenario : Scenario
        ``deploy.scenario.scenario.parse({...})`` or ``deploy.scenario.scenario.load(path, {})`` makes one.
    out : Path, optional
        The run directory; found under ``runs`` if left out.
    keep : bool
        Whether to write a run directory at all.
    watch : callable, optional
        Called with the plan and the records while the run goes on.
    tell : callable, optional
        Hears that Ctrl-C or SIGTERM is heeded: a run that is kept ends after the step, and is written.
    window : Window, optional
        Shows the run live, and has it recorded in its directory.
    snapshots : bool
        Whether to keep the robots' maps over time (`deploy.after.figures` draws them).
    pace : float, optional
        Steps a second at most.
    hosts : Hosts, optional
        Other hosts that robots run on (`deploy.run.hosts`).

    Raises
    ------
    ScenarioError
        The scenario cannot be run, or a host cannot take its robots; nothing has been started.
    OSError
        Something cannot be written: the error names it.
    ValueError
        The pace is too slow, or what is to be shown is not to be kept.
    """
    if not keep and (window is not None or snapshots):
        raise ValueError("a run that is shown, or whose maps are kept, needs a directory: keep = True")
    wait: Callable[[], object] = Pace(pace).wait if pace is not None else _nothing
    plan = plans.make(scenario)
    if hosts is not None and scenario.bus == "memory":
        raise ScenarioError("bus = 'memory': is one process of one host; with hosts it must be 'zenoh'")
    interrupt = Interrupt(tell)
    with (
        Fleet(hosts, scenario.robots, tell) if hosts is not None else contextlib.nullcontext() as fleet,
        interrupt.caught() if keep else contextlib.nullcontext(),
    ):
        directory = run_directory.create(out, plan) if keep else None
        began = time.perf_counter()

        def look(records: Records) -> None:
            if watch is not None:
                watch(plan, records)

        task = None
        if directory is not None and (window is not None or snapshots):
            port = window.port if window is not None else None
            task = ViewTask(plan, directory.absolute(), records=window is not None, port=port)
        ready: Callable[[], object] = window.open if window is not None else _nothing
        with run_directory.open_capture(directory, plan) as capture:
            if scenario.bus == "memory":
                with watching(task) if task is not None else contextlib.nullcontext() as view:
                    ready()
                    records = in_memory.run(plan, look, capture, heed=interrupt.heed, view=view, wait=wait)
                outcome = launch.Outcome(records, {})
            else:
                show = launch.Show(task, ready) if task is not None else None
                logs = directory / run_directory.LOGS if directory else None
                outcome = launch.run(
                    plan,
                    logs,
                    look,
                    capture,
                    heed=interrupt.heed,
                    show=show,
                    pace=pace,
                    live=directory,
                    fleet=fleet,
                )
        result = conclude(plan, outcome, directory, time.perf_counter() - began)
        if directory is not None and window is not None and outcome.view_fault:
            optimise(directory / RECORDING)  # closed by nobody
    return result


def conclude(plan: Plan, outcome: launch.Outcome, directory: Path | None, wall_s: float) -> Result:
    """Sum a run up and write its results."""
    summary = summarise(plan, outcome.records, wall_s)
    if directory is not None:
        run_directory.write_results(directory, plan, outcome.records, summary)
    code = _exit_code(outcome, summary)
    return Result(summary, code, directory, outcome.records, outcome.deaths, outcome.view_fault)


def _exit_code(outcome: launch.Outcome, summary: dict[str, Any]) -> int:
    if outcome.deaths or outcome.records.lost or outcome.records.end is None:
        return BROKEN_OFF
    return EXPLORED if summary["finished"] else NOT_FINISHED


def _nothing() -> None:
    """Nobody waits, nobody looks."""
