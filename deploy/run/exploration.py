"""One run, from a scenario to its directory: what `murmur explore` and Python callers share."""

from __future__ import annotations

import base64
import contextlib
import io
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deploy.dashboard.process import RECORDING, ViewTask, watching
from deploy.dashboard.windows import Window, optimize
from deploy.record import run_directory
from deploy.record.records import RecorderNode, Records
from deploy.record.summary import summarize
from deploy.run import in_memory, launch
from deploy.run.control import Control, as_it_went
from deploy.run.crash_report import traceback_of
from deploy.run.hosts import Hosts
from deploy.run.interrupt import Interrupt
from deploy.run.ssh import Fleet
from deploy.scenario import plan as plans
from deploy.scenario.effective_radio import effective_radio
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario, ScenarioError, check_incarnations, parse
from protocol import keys as names
from protocol.grid import Grid
from worldsim.pace import Pace

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.figure import Figure

EXPLORED, NOT_FINISHED, BAD_INPUT, BROKEN_OFF = range(4)
"""Exit codes of the contract."""

INCARNATIONS = 4
"""How often a robot may begin, with `restart`, if there is room for the maps of so many lives."""


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """The results of a run. In a notebook it shows its maps and figures.

    Attributes
    ----------
    summary : dict
        The figures of ``summary.json``.
    exit_code : int
        `EXPLORED`, `NOT_FINISHED` or `BROKEN_OFF`.
    directory : Path or None
        Where everything was written; None if nothing was kept.
    records : Records
        All that was recorded, in memory.
    deaths : dict
        Processes that ended prematurely, with their last words: the traceback of what a strategy or an exchange
        raised, else the last line of output. A robot in memory whose code raises dies as a process does.
    plan : Plan
        What was run: the scenario and its map.
    view_fault : str
        What went wrong with the viewer; the run continued without it.
    """

    summary: dict[str, Any]
    exit_code: int
    directory: Path | None
    records: Records
    deaths: dict[str, str]
    plan: Plan
    view_fault: str = ""

    @cached_property
    def steps(self) -> pl.DataFrame:
        """One row per step and robot: its pose and state; metres in the map's frame (``steps.parquet``)."""
        return frame(run_directory.steps_table(self.plan, self.records))

    @cached_property
    def ledger(self) -> pl.DataFrame:
        """One row per frame and packet kind (``ledger.parquet``, columns in docs/protocol.md)."""
        return frame(run_directory.ledger_table(self.records.ledger()))

    @property
    def maps(self) -> dict[str | int, Grid]:
        """The maps at the end, uint8 arrays of shape (h, w), row 0 on top.

        ``"truth"``; ``"team"``, the union of what the robots have seen themselves; and by number the planning
        grid of each robot that has handed it in.
        """
        named: dict[str | int, Grid] = {"truth": self.plan.map.cells}
        if self.records.own:
            named["team"] = np.maximum.reduce([grid for _, grid in sorted(self.records.own.items())])
        return named | dict(sorted(self.records.planning.items()))

    def plot(self) -> Figure:
        """The world with all paths, the team's map, and each robot's planning grid, as in ``maps.png``.

        Raises
        ------
        ValueError
            No robot has handed in its maps.
        """
        from deploy.record.map_pictures import maps_figure  # noqa: PLC0415  half a second to import

        if not self.records.own:
            raise ValueError("there are no maps to plot: no robot has handed in its own")
        return maps_figure(self.plan, self.records, self.summary)

    def __repr__(self) -> str:
        summary = self.summary
        ended = "explored" if summary["finished"] else summary["reason"]
        where = f", in {self.directory}" if self.directory is not None else ""
        return (
            f"<Result: {summary['robots']} robots on {summary['map']}, {ended} after {summary['steps']} steps, "
            f"coverage {summary['coverage']:.3f}, {summary['bytes']['total']} bytes{where}>"
        )

    def __str__(self) -> str:
        return "\n".join([repr(self), *(f"{name} died: {words}" for name, words in self.deaths.items())])

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        rows = "".join(
            f"<tr><td>{name}</td><td>{escape(str(self.summary[name]))}</td></tr>" for name in _SHOWN
        )
        picture = ""
        if self.records.own:
            file = io.BytesIO()
            self.plot().savefig(file, format="png", dpi=80)
            picture = f'<img src="data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}">'
        deaths = "".join(f"<pre>{name} died: {escape(words)}</pre>" for name, words in self.deaths.items())
        return f"<p>{escape(repr(self)[1:-1])}</p>{deaths}{picture}<table>{rows}</table>"


_SHOWN = (
    "steps",
    "coverage",
    "map_accuracy",
    "t90",
    "t99",
    "strategy",
    "map_encoding",
    "bandwidth",
    "digest",
)
"""Figures that a notebook shows."""


def explore(
    scenario: Scenario | None = None,
    *,
    out: Path | str | None = None,
    keep: bool = True,
    watch: Callable[[Plan, Records], object] | None = None,
    tell: Callable[[str], object] = lambda _: None,
    window: Window | None = None,
    pace: float | None = None,
    hosts: Hosts | None = None,
    control: Control | None = None,
    restart: bool = False,
    **settings: Any,
) -> Result:
    """Run a scenario. Viewing and pace do not affect its results.

    Parameters
    ----------
    scenario : Scenario, optional
        ``Scenario(robots=5)`` or ``deploy.scenario.scenario.load(path, {})`` makes one; the defaults if left out.
    out : Path or str, optional
        The run directory; a new one under ``runs`` if left out.
    keep : bool
        Whether to write a run directory at all.
    watch : callable, optional
        Called with the plan and the records during the run.
    tell : callable, optional
        Called with what is worth a word: the radio, at the beginning, if a scenario changes it; and once Ctrl-C or
        SIGTERM takes effect: a run that is kept ends after the step, and is written.
    window : Window, optional
        Shows the run live; it is also recorded in its directory.
    pace : float, optional
        Steps a second at most.
    hosts : Hosts, optional
        Other hosts that robots run on (`deploy.run.hosts`).
    control : Control, optional
        Pauses the run, kills robots, changes the radio, from another thread or from `watch` (`deploy.run.control`).
        What was done is in the scenario of the run directory, and of the result's plan.
    restart : bool
        Whether what dies unasked is started again: a robot where it fell, as often as it has lives; and where relay or
        world die the whole run, which gets to the step that it was in and goes on from there (docs/reliability.md).
    **settings
        Settings of the scenario, over those of `scenario`: ``explore(robots=5, bandwidth=1000)``.

    Raises
    ------
    ScenarioError
        The scenario cannot be run, or a host cannot take its robots; nothing has been started.
    OSError
        Something cannot be written: the error names it.
    ValueError
        The pace is too slow, or a run that is shown is not kept.
    """
    if not keep and window is not None:
        raise ValueError("a run that is shown needs a directory: keep = True")
    if not keep and out is not None:
        raise ValueError(f"out = {str(out)!r}: with keep = False nothing is written; leave one of them out")
    scenario = scenario_of(scenario, settings)
    wait: Callable[[], object] = Pace(pace).wait if pace is not None else _nothing
    plan = plans.make(scenario, incarnations=_lives(scenario, hosts) if restart else 1, record_maps=keep)
    if hosts is not None and scenario.bus == "memory":
        raise ScenarioError("bus = 'memory': is one process of one host; with hosts it must be 'zenoh'")
    if radio := effective_radio(plan):
        tell(radio)
    if hosts is not None and any(fault.kind in ("kill", "restart") for fault in scenario.faults):
        raise ScenarioError("fault: robots can be killed and restarted on this host only; leave --hosts out")
    interrupt = Interrupt(tell, control.resume if control is not None else _nothing)
    if control is not None:
        control.attach(plan, may_kill=hosts is None)
        if pace is not None:
            control.set_speed(pace)
        wait = control.gate().wait

    def heed(recorder: RecorderNode) -> bool:
        if control is not None:
            control.heed(recorder)
        return interrupt.heed(recorder)

    with (
        Fleet(hosts, scenario.robots, tell) if hosts is not None else contextlib.nullcontext() as fleet,
        interrupt.caught() if keep else contextlib.nullcontext(),
    ):
        directory = run_directory.create(Path(out) if out is not None else None, plan) if keep else None
        logs = directory / run_directory.LOGS if directory is not None else None
        journals = directory / run_directory.JOURNALS if directory is not None else None
        began = time.perf_counter()

        def look(records: Records) -> None:
            if watch is not None:
                watch(plan, records)

        task = None
        if directory is not None and window is not None:
            task = ViewTask(plan, directory.absolute(), window.port)
        ready: Callable[[], object] = window.open if window is not None else _nothing
        show = launch.Show(task, ready) if task is not None else None
        done = 0
        while True:
            with run_directory.open_capture(directory, plan) as capture:
                if scenario.bus == "memory":
                    with watching(task) if task is not None else contextlib.nullcontext() as view:
                        ready()
                        fallen = _Fallen(logs)
                        records = in_memory.run(
                            plan,
                            look,
                            capture,
                            heed=heed,
                            view=view,
                            wait=wait,
                            fell=fallen.take,
                            journals=journals,
                        )
                    outcome = launch.Outcome(records, fallen.deaths)
                else:
                    outcome = launch.run(
                        plan,
                        logs,
                        look,
                        capture,
                        heed=heed,
                        show=show,
                        pace=pace,
                        live=directory,
                        fleet=fleet,
                        journals=journals,
                        free=done,
                        revive=restart,
                        gate=control.gate(done) if control is not None else None,
                    )
            dead = sorted({names.RELAY, names.WORLD} & outcome.deaths.keys())
            if not (restart and dead and outcome.records.step > done) or interrupt.came:
                break
            done = outcome.records.step
            went = as_it_went(plan, outcome.records)
            plan = (
                plan
                if went is plan
                else plans.make(went.scenario, plan.map, incarnations=plan.incarnations, record_maps=keep)
            )
            tell(
                f"{' and '.join(dead)} died at step {done}: going through the run again up to there, then on"
            )
            if journals is not None:
                shutil.rmtree(journals, ignore_errors=True)
        result = conclude(plan, outcome, directory, time.perf_counter() - began)
        if directory is not None and window is not None and outcome.view_fault:
            optimize(directory / RECORDING)  # the failed viewer did not close it
    return result


def _lives(scenario: Scenario, hosts: Hosts | None) -> int:
    """How often robots may begin if they are started again; ScenarioError if they cannot be."""
    if scenario.bus == "memory":
        raise ScenarioError("bus = 'memory': has no processes that could die; restart needs 'zenoh'")
    if hosts is not None:
        raise ScenarioError(
            "restart: robots of other hosts cannot be started again; leave --hosts or --restart out"
        )
    incarnations = (
        INCARNATIONS
        if scenario.map_encoding == "none"
        else min(INCARNATIONS, scenario.most_maps // scenario.robots)
    )
    check_incarnations(scenario, max(incarnations, 2))
    return incarnations


def scenario_of(scenario: Scenario | None, settings: Mapping[str, Any]) -> Scenario:
    """Lay settings over a scenario, or over the defaults; ScenarioError names all that is wrong.

    Raises
    ------
    TypeError
        It is no scenario.
    """
    if not isinstance(scenario, Scenario | None):
        raise TypeError(
            f"scenario = {scenario!r}: must be a Scenario; settings are given by name, as in "
            "explore(map='office', robots=3), and deploy.scenario.scenario.load(Path('office.toml'), {}) reads a file"
        )
    if scenario is not None and not settings:
        return scenario
    return parse((scenario.model_dump(exclude_unset=True) if scenario is not None else {}) | dict(settings))


class _Fallen:
    """Robots in memory whose code raised: their last words, and their logs, as of processes."""

    def __init__(self, logs: Path | None) -> None:
        self.deaths: dict[str, str] = {}
        self._logs = logs

    def take(self, name: str, error: Exception) -> None:
        said = traceback_of(error)
        self.deaths[name] = f"exit code 1; its last words: {said}"
        if self._logs is not None:
            self._logs.mkdir(exist_ok=True)
            (self._logs / f"{name}.log").write_text(f"{said}\n", encoding="utf-8")


def conclude(plan: Plan, outcome: launch.Outcome, directory: Path | None, wall_s: float) -> Result:
    """Summarise a run and write its results; what was done to it becomes a part of its scenario."""
    summary = summarize(plan, outcome.records, wall_s)
    done = as_it_went(plan, outcome.records)
    if directory is not None and done is not plan:
        run_directory.write_inputs(directory, done)
    plan = done
    if directory is not None:
        run_directory.write_results(directory, plan, outcome.records, summary)
    code = _exit_code(outcome, summary)
    return Result(summary, code, directory, outcome.records, outcome.deaths, plan, outcome.view_fault)


def _exit_code(outcome: launch.Outcome, summary: dict[str, Any]) -> int:
    end = outcome.records.end
    if outcome.deaths or outcome.records.lost or end is None or end.step < 0:
        return BROKEN_OFF
    return EXPLORED if summary["finished"] else NOT_FINISHED


def frame(table: Any) -> pl.DataFrame:
    """An arrow table as a polars frame."""
    import polars  # noqa: PLC0415  only who asks for a frame needs it

    frame = polars.from_arrow(table)
    assert isinstance(frame, polars.DataFrame)
    return frame


def _nothing() -> None:
    """No pace and no viewer."""
