"""Run one scenario and write its run directory: the common part of `murmur explore` and the Python API."""

from __future__ import annotations

import base64
import contextlib
import io
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from deploy.dashboard.process import RECORDING, ViewTask, watching
from deploy.dashboard.windows import Window, optimize
from deploy.record import run_directory
from deploy.record.pandas_tables import to_pandas
from deploy.record.records import RecorderNode, Records
from deploy.record.summary import summarize
from deploy.run import launch, limits, memory
from deploy.run.control import Control, as_it_went
from deploy.run.crash_report import traceback_of
from deploy.run.failure import RunFailed
from deploy.run.hosts import Hosts
from deploy.run.in_memory import MemoryRun, check_clock
from deploy.run.interrupt import Interrupt
from deploy.run.process_table import load_fork_server
from deploy.run.ssh import Fleet
from deploy.scenario import plan as plans
from deploy.scenario import plugins
from deploy.scenario.effective_radio import effective_radio
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario, ScenarioError, check_incarnations, parse
from protocol import keys as names
from protocol.grid import Grid
from protocol.kernels import compilation_s
from protocol.messages import Missed
from worldsim.ending import ALL_LOST
from worldsim.pace import Pace

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    from matplotlib.figure import Figure

EXPLORED, NOT_FINISHED, BAD_INPUT, BROKEN_OFF = range(4)
"""Exit codes of `murmur explore`."""

INCARNATIONS = 4
"""How often each robot may start with `restart`, if packets can address so many maps."""

MOST_REPEATS = 2
"""How often a run that breaks off is repeated without getting further."""


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
        """One row per step and robot: its pose and state; metres in the map's frame (``steps.parquet``)."""
        return frame(run_directory.steps_table(self.plan, self.records))

    @cached_property
    def ledger(self) -> pl.DataFrame:
        """One row per frame and packet kind (``ledger.parquet``, columns in docs/protocol.md)."""
        return frame(run_directory.ledger_table(self.records.ledger()))

    def to_pandas(self) -> dict[str, pd.DataFrame]:
        """Return the tables as pandas frames: ``"steps"`` and ``"ledger"``, with the columns of the parquet files.

        Raises ImportError if pandas is not installed.
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
            named["team"] = np.maximum.reduce([grid for _, grid in sorted(self.records.own.items())])
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
            f"<Result: {summary['robots']} robots on {summary['map']}, {ended} after {summary['steps']} steps, "
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
    "steps",
    "coverage",
    "map_accuracy",
    "mean_map_accuracy",
    "worst_map_accuracy",
    "t90",
    "t99",
    "strategy",
    "map_encoding",
    "bandwidth",
    "digest",
)
"""Keys of the summary that a notebook shows."""


def explore(
    scenario: Scenario | None = None,
    *,
    out: Path | str | None = None,
    keep: bool = True,
    watch: Callable[[Plan, Records], object] | None = None,
    notify: Callable[[str], object] = lambda _: None,
    window: Window | None = None,
    pace: float | None = None,
    hosts: Hosts | None = None,
    control: Control | None = None,
    restart: bool = False,
    missed: Sequence[Missed] | None = None,
    check: bool = True,
    **settings: Any,
) -> Result:
    """Run a scenario. Viewing and pace do not affect its results.

    Parameters
    ----------
    scenario : Scenario, optional
        The scenario; default settings if omitted.
    out : Path or str, optional
        The run directory; a new one under ``runs`` if omitted.
    keep : bool
        Whether to write a run directory.
    watch, notify : callable, optional
        Called with the plan and the records during the run; called with messages for the user.
    window : Window, optional
        Shows the run live, and records the view in the run directory.
    pace : float, optional
        Maximum steps per second.
    hosts : Hosts, optional
        Other hosts that robots run on.
    control : Control, optional
        Pauses the run, kills robots, and changes the radio; the result's scenario contains these events.
    restart : bool
        Whether to restart processes that end unexpectedly: robots, up to `INCARNATIONS` times each; after the end of
        relay or world the whole run (docs/reliability.md).
    missed : sequence of Missed, optional
        The record of a run by the wall clock, which this run repeats on the memory bus (docs/clocks.md).
    check : bool
        Whether to raise RunFailed; else only `Result.exit_code` tells that the run failed.
    **settings
        Settings that replace those of `scenario`: ``explore(robots=5, bandwidth=1000)``.

    Raises
    ------
    ScenarioError
        The scenario is invalid, or a host cannot run its robots; nothing has been started.
    RunFailed
        World or relay ended unexpectedly, or all robots did; `RunFailed.result` has the results until then. A run that
        loses some of its robots has a result, with the exit code `BROKEN_OFF`.
    OSError
        A file cannot be written; the error names it.
    ValueError
        The pace is too slow, arguments contradict each other, or memory or open files do not suffice.
    """
    _check_output(out, window, keep=keep)
    limits.check_memory()
    scenario = scenario_of(scenario, settings)
    if scenario.bus == "memory":
        check_clock(scenario, missed)
    plan = _planned(scenario, hosts, pace, restart=restart, keep=keep)
    for note in _notes(plan):
        notify(note)
    interrupt = Interrupt(notify, control.resume if control is not None else (lambda: None))
    if control is not None:
        control.attach(plan, pace, may_kill=hosts is None)
    if scenario.bus == "zenoh":
        load_fork_server()
    with (
        Fleet(hosts, scenario.robots, notify, plugins.on_robots(scenario))
        if hosts is not None
        else contextlib.nullcontext() as fleet,
        interrupt.caught() if keep else contextlib.nullcontext(),
    ):
        folder = run_directory.create(Path(out) if out is not None else None, plan) if keep else None
        chosen = folder, watch, notify, window, pace, fleet, control, interrupt, restart, missed
        result, failure = _Execution(*chosen).complete(plan)
    if check and failure and not interrupt.came:
        raise RunFailed(failure, result)
    return result


def _notes(plan: Plan) -> list[str]:
    """Return what the user should know about the radio and the logs of a plan."""
    radio = effective_radio(plan)
    return ([radio] if radio else []) + list(plan.recording.notes if plan.recording is not None else ())


def _planned(
    scenario: Scenario, hosts: Hosts | None, pace: float | None, *, restart: bool, keep: bool
) -> Plan:
    """Return the plan of a run, for which pace, hosts, memory, and open files suffice; ValueError if they do not."""
    _check_pace_and_hosts(pace, hosts, scenario)
    if scenario.bus == "zenoh":
        plugins.check_importable(scenario, "the robots' processes", ", or set bus = 'memory'")
    incarnations = _incarnations(scenario, hosts) if restart else 1
    plan = plans.make(scenario, incarnations=incarnations, record_maps=keep)
    memory.check(plan, sum(map(len, hosts.placing(scenario.robots).values())) if hosts is not None else 0)
    limits.check_files(scenario.robots if scenario.bus == "zenoh" else 0)
    if keep:
        with limits.importing():
            run_directory.load_writers()
    return plan


@dataclass(frozen=True, eq=False)
class _Execution:
    """The execution of one plan in this process or as processes, again after a crash if `restart` is set."""

    directory: Path | None
    watch: Callable[[Plan, Records], object] | None
    notify: Callable[[str], object]
    window: Window | None
    pace: float | None
    fleet: Fleet | None
    control: Control | None
    interrupt: Interrupt
    restart: bool
    missed: Sequence[Missed] | None

    def complete(self, plan: Plan) -> tuple[Result, str]:
        """Run a plan to its end, write the results, and return them, and why the run failed (`_failure`)."""
        began, compiled_s = time.perf_counter(), compilation_s()
        plan, outcome = self._run(plan)
        wall_s = time.perf_counter() - began - (compilation_s() - compiled_s)
        result = conclude(plan, outcome, self.directory, wall_s)
        if self.directory is not None and self.window is not None and outcome.view_fault:
            optimize(self.directory / RECORDING)  # the failed viewer did not close it
        return result, _failure(outcome)

    def _run(self, plan: Plan) -> tuple[Plan, launch.Outcome]:
        """Run a plan; return it with the events of the run, and the outcome.

        If it breaks off, and `restart` is set, run it again: unpaced up to the step that it had reached. The outcome is
        that of the attempt with the most steps.
        """
        run = self._run_in_memory if plan.scenario.bus == "memory" else self._run_processes
        best = plan, launch.Outcome(launch.no_records(plan), {})
        done = repeats = 0
        attempts = count()
        while True:
            with run_directory.open_capture(self.directory, plan, again=next(attempts) > 0) as capture:
                outcome = run(plan, capture, done)
            if capture is not None and capture.failure is not None:
                outcome.failures.append(capture.failure)
            step = outcome.records.step
            if step >= done:
                best = plan, outcome
            run_directory.settle_capture(self.directory, accept=step >= done)
            repeats = repeats + 1 if step <= done else 0
            done = max(step, done)
            cause = _break_off(outcome) if self.restart and not self.interrupt.came else ""
            if not cause or repeats > MOST_REPEATS:
                return best
            actual = as_it_went(best[0], best[1].records)
            if actual is not best[0]:
                keep = self.directory is not None
                plan = plans.make(actual.scenario, plan.map, incarnations=plan.incarnations, record_maps=keep)
            self.notify(
                f"{cause} at step {step}: repeating the run" + (f" up to step {done}" if done else "")
            )
            if self._journals is not None:
                shutil.rmtree(self._journals, ignore_errors=True)

    @property
    def _logs(self) -> Path | None:
        return self.directory / run_directory.LOGS if self.directory is not None else None

    @property
    def _journals(self) -> Path | None:
        return self.directory / run_directory.JOURNALS if self.directory is not None else None

    def _run_in_memory(self, plan: Plan, capture: BinaryIO | None, _: int) -> launch.Outcome:
        task, ready = self._view(plan)
        wait: Callable[[], object] = Pace(self.pace).wait if self.pace is not None else (lambda: None)
        if self.control is not None:
            wait = self.control.gate().wait
        deaths: dict[str, str] = {}

        def note_crash(name: str, error: Exception) -> None:
            report = traceback_of(error)
            deaths[name] = f"exit code 1; last output: {report}"
            if self._logs is not None:
                self._logs.mkdir(exist_ok=True)
                (self._logs / f"{name}.log").write_text(f"{report}\n", encoding="utf-8")

        with watching(task) if task is not None else contextlib.nullcontext() as view:
            ready()
            records = MemoryRun(
                plan,
                capture,
                view=view,
                wait=wait,
                on_crash=note_crash,
                journals=self._journals,
                missed=self.missed,
            ).complete(self._observer(plan), heed=self._heed)
        return launch.Outcome(records, deaths)

    def _run_processes(self, plan: Plan, capture: BinaryIO | None, done: int) -> launch.Outcome:
        task, ready = self._view(plan)
        return launch.run(
            plan,
            self._logs,
            self._observer(plan),
            capture,
            heed=self._heed,
            show=launch.Show(task, ready) if task is not None else None,
            pace=self.pace,
            live=self.directory,
            fleet=self.fleet,
            journals=self._journals,
            free=done,
            revive=self.restart,
            gate=self.control.gate(done) if self.control is not None else None,
        )

    def _view(self, plan: Plan) -> tuple[ViewTask | None, Callable[[], object]]:
        """Return the viewer's task, if there is a window, and what to call once the viewer has joined."""
        if self.directory is None or self.window is None:
            return None, (lambda: None)
        return ViewTask(plan, self.directory.absolute(), self.window.port), self.window.open

    def _observer(self, plan: Plan) -> Callable[[Records], object]:
        watch = self.watch
        return lambda records: watch(plan, records) if watch is not None else None

    def _heed(self, recorder: RecorderNode) -> bool:
        """Pass on the requests of `control`; return whether the run was interrupted."""
        if self.control is not None:
            self.control.heed(recorder)
        return self.interrupt.heed(recorder)


def _break_off(outcome: launch.Outcome) -> str:
    """Return why a run broke off before its end; empty if it did not."""
    end, deaths = outcome.records.end, outcome.deaths
    dead = sorted({names.RELAY, names.WORLD} & deaths.keys())
    if dead or end is None:
        return f"{' and '.join(dead or sorted(deaths)) or 'the run'} died"
    return end.reason if end.step < 0 or end.reason == launch.FORK_SERVER_DIED else ""


def _failure(outcome: launch.Outcome) -> str:
    """Return why a run has no usable result: it broke off, or lost all robots unexpectedly; empty if it has one."""
    lost, end = outcome.records.lost, outcome.records.end
    if cause := _break_off(outcome):
        failure = f"the run was aborted at step {outcome.records.step}: {cause}"
    elif lost and end is not None and end.reason == ALL_LOST:
        robots = "; ".join(f"robot {robot}: {why}" for robot, why in sorted(lost.items()))
        failure = f"all robots were lost by step {end.step}: {robots}"
    else:
        return ""
    return "\n".join([failure, *dict.fromkeys(outcome.deaths.values())])


def _check_output(out: Path | str | None, window: Window | None, *, keep: bool) -> None:
    """Raise ValueError if the arguments need a run directory and forbid it."""
    if not keep and window is not None:
        raise ValueError("keep = False: a window needs a run directory")
    if not keep and out is not None:
        raise ValueError(f"out = {str(out)!r}: keep = False writes no directory; omit one of them")


def _check_pace_and_hosts(pace: float | None, hosts: Hosts | None, scenario: Scenario) -> None:
    """Raise ValueError if the pace is too slow or not needed, ScenarioError if the scenario cannot run on hosts."""
    if pace is not None:
        Pace(pace)
        if scenario.clock == "wall":
            raise ValueError("pace: with clock = 'wall', step_s sets the speed (--step); omit the pace")
    if hosts is None:
        return
    if scenario.bus == "memory":
        raise ScenarioError("bus = 'memory': runs in one process; with hosts it must be 'zenoh'")
    if any(fault.kind in ("kill", "restart") for fault in scenario.faults):
        raise ScenarioError("fault: robots can be killed and restarted on this host only; omit --hosts")


def _incarnations(scenario: Scenario, hosts: Hosts | None) -> int:
    """Return how often robots may start if they are restarted; ScenarioError if they cannot be restarted."""
    if scenario.bus == "memory":
        raise ScenarioError("bus = 'memory': has no processes that could die; restart needs 'zenoh'")
    if hosts is not None:
        raise ScenarioError("restart: robots on other hosts cannot be restarted; omit --hosts or --restart")
    incarnations = INCARNATIONS
    if scenario.map_encoding != "none":
        incarnations = min(INCARNATIONS, scenario.most_maps // scenario.robots)
    check_incarnations(scenario, max(incarnations, 2))
    return incarnations


def scenario_of(scenario: Scenario | None, settings: Mapping[str, Any]) -> Scenario:
    """Return a scenario, or the defaults, with some settings replaced; ScenarioError lists all errors.

    Raises TypeError if `scenario` is not a Scenario.
    """
    if not isinstance(scenario, Scenario | None):
        raise TypeError(
            f"scenario = {scenario!r}: must be a Scenario; settings are given by name, as in "
            "explore(map='office', robots=3), and deploy.scenario.scenario.load(Path('office.toml'), {}) reads a file"
        )
    if scenario is not None and not settings:
        return scenario
    return parse((scenario.model_dump(exclude_unset=True) if scenario is not None else {}) | dict(settings))


def conclude(plan: Plan, outcome: launch.Outcome, directory: Path | None, wall_s: float) -> Result:
    """Summarize a run and write its results; the scenario of the result contains the events of the run."""
    summary = summarize(plan, outcome.records, wall_s)
    done = as_it_went(plan, outcome.records)
    if directory is not None and done is not plan:
        run_directory.write_inputs(directory, done)
    plan = done
    if directory is not None:
        run_directory.write_results(directory, plan, outcome.records, summary, outcome.failures)
    code = _exit_code(outcome, summary)
    return Result(summary, code, directory, outcome.records, outcome.deaths, plan, outcome.view_fault)


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
