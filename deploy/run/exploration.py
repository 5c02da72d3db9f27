"""Run one scenario and write its run directory: the common part of `murmur explore` and the Python API."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from deploy.dashboard.windows import Window
from deploy.record import run_directory
from deploy.record.records import Records
from deploy.run import limits, memory
from deploy.run.control import Control
from deploy.run.execution import RunOptions, execute
from deploy.run.failure import RunFailed
from deploy.run.hosts import Hosts
from deploy.run.hosts import load as load_hosts
from deploy.run.in_memory import check_clock
from deploy.run.result import Result
from deploy.scenario import plan as plans
from deploy.scenario import plugins
from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario, check_incarnations, load, parse
from deploy.scenario.thesis import with_thesis
from deploy.scenario.toml_files import lay, remove_preset_keys
from protocol.messages import Missed
from worldsim.pace import Pace

INCARNATIONS = 4
"""How often each robot may start with `restart`, if packets can address so many maps."""


def explore(
    scenario: Scenario | Path | str | None = None,
    *,
    out: Path | str | None = None,
    keep: bool = True,
    watch: Callable[[Plan, Records], object] | None = None,
    notify: Callable[[str], object] = lambda _: None,
    window: Window | None = None,
    pace: float | None = None,
    hosts: Hosts | Path | str | None = None,
    control: Control | None = None,
    restart: bool = False,
    missed: Sequence[Missed] | None = None,
    check: bool = True,
    **settings: Any,
) -> Result:
    """Run a scenario. Viewing and pace do not affect its results.

    Parameters
    ----------
    scenario : Scenario, Path or str, optional
        The scenario, or its file, as ``"office.toml"``; default settings if omitted.
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
    hosts : Hosts, Path or str, optional
        Other hosts that robots run on, or the file that describes them (docs/hosts.md).
    control : Control, optional
        Pauses the run, kills robots, and changes the radio; the result's scenario contains these events.
    restart : bool
        Whether to restart processes that end unexpectedly: robots, up to `INCARNATIONS` times each; after the end of
        relay or world the whole run (docs/reliability.md).
    missed : sequence of Missed, optional
        The record of a run by the wall clock, which this run repeats on the memory bus (docs/clocks.md).
    check : bool
        Whether to raise RunFailed; else only `Result.exit_code` shows that the run failed.
    **settings
        Settings that replace those of `scenario`: ``explore(robots=5, bandwidth=1000)``. A dotted name sets one key of
        a table: ``explore(**{"radio.loss": 0.1})``. ``thesis=True`` is ``--thesis``.

    Raises
    ------
    ScenarioError
        The scenario is invalid, a host cannot run its robots, or another program has the hub's port; nothing has run.
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
    hosts = load_hosts(Path(hosts)) if isinstance(hosts, Path | str) else hosts
    options = RunOptions(watch, notify, window, pace, hosts, control, restart, missed)
    plan = _planned(scenario_of(scenario, settings), options, keep=keep)
    result, failure = execute(plan, options, Path(out) if out is not None else None, keep=keep)
    if check and failure:
        raise RunFailed(failure, result)
    return result


def _planned(scenario: Scenario, options: RunOptions, *, keep: bool) -> Plan:
    """Return the plan of a run that the options, memory, and open files allow; ValueError if they do not."""
    hosts = options.hosts
    if scenario.bus == "memory":
        check_clock(scenario, options.missed)
    _check_pace_and_hosts(options.pace, hosts, scenario)
    if scenario.bus == "zenoh":
        plugins.check_importable(scenario, "the robots' processes", ", or set bus = 'memory'")
    incarnations = _incarnations(scenario, hosts) if options.restart else 1
    plan = plans.make(scenario, incarnations=incarnations, record_maps=keep)
    memory.check(plan, sum(map(len, hosts.placing(scenario.robots).values())) if hosts is not None else 0)
    limits.check_files(scenario.robots if scenario.bus == "zenoh" else 0)
    if keep:
        with limits.importing():
            run_directory.load_writers()
    return plan


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


def scenario_of(scenario: Scenario | Path | str | None, settings: Mapping[str, Any]) -> Scenario:
    """Return a scenario, or the defaults, with some settings replaced, as `explore` describes them.

    Raises ScenarioError, which lists all errors; TypeError if `scenario` is neither a Scenario nor a file.
    """
    if isinstance(scenario, Path) or (isinstance(scenario, str) and scenario.endswith(".toml")):
        scenario = load(scenario)
    if not isinstance(scenario, Scenario | None):
        raise TypeError(
            f"scenario = {scenario!r}: must be a Scenario; settings are given by name, as in "
            "explore(map='office', robots=3), and explore('office.toml') reads a file"
        )
    if scenario is not None and not settings:
        return scenario
    data = scenario.model_dump(exclude_unset=True) if scenario is not None else {}
    given = plugins.plain_settings(settings)
    if given.pop("thesis", False):
        given = with_thesis(given, data)
    remove_preset_keys(data, given)
    lay(data, given, "scenario")
    return parse(data)
