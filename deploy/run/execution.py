"""The execution of a plan: in this process or as processes, shown and controlled, repeated if it breaks off."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import BinaryIO

from deploy.dashboard.process import RECORDING, ViewTask, watching
from deploy.dashboard.windows import Window, optimize
from deploy.record import run_directory
from deploy.record.records import RecorderNode, Records
from deploy.run import launch
from deploy.run.control import Control, as_it_went
from deploy.run.crash_report import traceback_of
from deploy.run.hosts import Hosts
from deploy.run.in_memory import MemoryRun
from deploy.run.interrupt import Interrupt
from deploy.run.process_table import load_fork_server
from deploy.run.result import Result, conclude
from deploy.run.ssh import Fleet
from deploy.scenario import plan as plans
from deploy.scenario import plugins
from deploy.scenario.effective_radio import effective_radio
from deploy.scenario.errors import ScenarioError
from deploy.scenario.finding_maps import IMAGES
from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol.kernels import compilation_s
from protocol.messages import Missed
from worldsim.ending import ALL_LOST
from worldsim.pace import Pace

MOST_REPEATS = 2
"""How often a run that breaks off is repeated without getting further."""


class HubError(ScenarioError):
    """The hub cannot listen at its address; nothing has been run or written."""


@dataclass(frozen=True, eq=False)
class RunOptions:
    """How a run is executed, shown, and controlled; `deploy.run.exploration.explore` describes the options."""

    watch: Callable[[Plan, Records], object] | None
    notify: Callable[[str], object]
    window: Window | None
    pace: float | None
    hosts: Hosts | None
    control: Control | None
    restart: bool
    missed: Sequence[Missed] | None


def execute(plan: Plan, options: RunOptions, out: Path | None, *, keep: bool) -> tuple[Result, str]:
    """Run a plan and write its results; return them, and why the run failed: empty if it did not, or was interrupted.

    `out` is the run directory, by default a new one; without `keep`, nothing is written. HubError if nothing was run.
    """
    for note in _notes(plan):
        options.notify(note)
    control, hosts, scenario = options.control, options.hosts, plan.scenario
    interrupt = Interrupt(options.notify, control.resume if control is not None else (lambda: None))
    if control is not None:
        control.attach(plan, options.pace, may_kill=hosts is None)
    remote = None
    if hosts is not None:
        remote = Fleet(hosts, scenario.robots, options.notify, plugins.on_robots(scenario))
    if scenario.bus == "zenoh":
        load_fork_server()
    with (
        remote or contextlib.nullcontext() as fleet,
        interrupt.caught() if keep else contextlib.nullcontext(),
    ):
        is_new = out is None or not out.exists()
        folder = run_directory.create(out, plan) if keep else None
        try:
            result, failure = _Execution(options, folder, fleet, interrupt).complete(plan)
        except HubError:
            if folder is not None:
                run_directory.discard(folder, is_new=is_new)
            raise
    return result, "" if interrupt.came else failure


def _notes(plan: Plan) -> list[str]:
    """Return notes for the user: the size of a map whose resolution the user gave, the radio, and the logs."""
    is_picture = Path(plan.scenario.map).suffix.lower() in IMAGES
    notes = [f"map: {plan.map.size}" if is_picture else "", effective_radio(plan)]
    return [note for note in notes if note] + list(plan.recording.notes if plan.recording is not None else ())


@dataclass(frozen=True, eq=False)
class _Execution:
    """The execution of one plan in this process or as processes, again after a crash if `RunOptions.restart` is set."""

    options: RunOptions
    directory: Path | None
    fleet: Fleet | None
    interrupt: Interrupt

    def complete(self, plan: Plan) -> tuple[Result, str]:
        """Run a plan to its end, write the results, and return them, and why the run failed (`_failure`).

        HubError if nothing was run.
        """
        began, compiled_s = time.perf_counter(), compilation_s()
        plan, outcome = self._run(plan)
        if outcome.hub_fault:
            advice = "start the run again" if self.fleet is None else "give another port in the hosts file"
            raise HubError(f"{outcome.hub_fault}; nothing has been run or written: {advice}")
        wall_s = time.perf_counter() - began - (compilation_s() - compiled_s)
        result = conclude(plan, outcome, self.directory, wall_s)
        if self.directory is not None and self.options.window is not None and outcome.view_fault:
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
            cause = _break_off(outcome) if self.options.restart and not self.interrupt.came else ""
            if not cause or repeats > MOST_REPEATS:
                return best
            actual = as_it_went(best[0], best[1].records)
            if actual is not best[0]:
                keep = self.directory is not None
                plan = plans.make(actual.scenario, plan.map, incarnations=plan.incarnations, record_maps=keep)
            self.options.notify(
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
        show = self._show(plan)
        wait: Callable[[], object] = (
            Pace(self.options.pace).wait if self.options.pace is not None else (lambda: None)
        )
        if self.options.control is not None:
            wait = self.options.control.gate().wait
        deaths: dict[str, str] = {}

        def note_crash(name: str, error: Exception) -> None:
            report = traceback_of(error)
            deaths[name] = f"exit code 1; last output: {report}"
            if self._logs is not None:
                self._logs.mkdir(exist_ok=True)
                (self._logs / f"{name}.log").write_text(f"{report}\n", encoding="utf-8")

        with watching(show.task) if show is not None else contextlib.nullcontext() as view:
            if show is not None:
                show.ready()
            records = MemoryRun(
                plan,
                capture,
                view=view,
                wait=wait,
                on_crash=note_crash,
                journals=self._journals,
                missed=self.options.missed,
            ).complete(self._observer(plan), heed=self._heed)
        return launch.Outcome(records, deaths)

    def _run_processes(self, plan: Plan, capture: BinaryIO | None, done: int) -> launch.Outcome:
        return launch.run(
            plan,
            self._logs,
            self._observer(plan),
            capture,
            heed=self._heed,
            show=self._show(plan),
            pace=self.options.pace,
            live=self.directory,
            fleet=self.fleet,
            journals=self._journals,
            free=done,
            revive=self.options.restart,
            gate=self.options.control.gate(done) if self.options.control is not None else None,
        )

    def _show(self, plan: Plan) -> launch.Show | None:
        """Return the viewer of a run; None without a window."""
        if self.directory is None or (window := self.options.window) is None:
            return None
        return launch.Show(ViewTask(plan, self.directory.absolute(), window.port), window.open)

    def _observer(self, plan: Plan) -> Callable[[Records], object]:
        watch = self.options.watch
        return lambda records: watch(plan, records) if watch is not None else None

    def _heed(self, recorder: RecorderNode) -> bool:
        """Pass on the requests of `control`; return whether the run was interrupted."""
        if self.options.control is not None:
            self.options.control.heed(recorder)
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
