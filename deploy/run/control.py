"""Live control of a run: pause, single steps, speed, killing robots, changing the radio (docs/dashboard.md).

The events become part of the run's scenario, with the step in which they occurred, so that the run can be repeated.
"""

from __future__ import annotations

import multiprocessing
import queue
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Any

from deploy.record.records import NO_MAPS, RecorderNode, Records
from deploy.run.gate import Gate
from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from deploy.scenario.tables import ChangeTable, FaultTable
from protocol import faults
from protocol.messages import Change, FaultEvent
from worldsim.pace import SLOWEST

CUT_SHORT = ("interrupted", "broken off")
"""End reasons of runs that were cut short."""


class Control:
    """Controls a run from any thread: ``explore(control=...)``."""

    def __init__(self) -> None:
        values = multiprocessing.get_context("forkserver")
        self._credit = values.Value("q", -1)
        """Number of steps that may be opened; -1: any number."""
        self._period = values.Value("d", 0.0)
        """Minimum seconds of a step; 0: no limit."""
        self._requests: queue.SimpleQueue[FaultEvent | Change] = queue.SimpleQueue()
        self._scenario: Scenario | None = None
        self._diagonal_m = 0.0
        self.step_now = 0
        """The last step that has begun."""
        self._may_kill = True

    @property
    def paused(self) -> bool:
        """Whether the run waits for `resume` or `step`."""
        return bool(self._credit.value == 0)

    @property
    def speed(self) -> float | None:
        """Maximum steps per second; None: unlimited."""
        return 1 / self._period.value if self._period.value else None

    @property
    def robots(self) -> int:
        """Number of robots; 0 before the run."""
        return self._scenario.robots if self._scenario is not None else 0

    def pause(self) -> None:
        """Open no further steps."""
        self._credit.value = 0

    def resume(self) -> None:
        """Continue a paused run."""
        self._credit.value = -1

    def step(self, steps: int = 1) -> None:
        """Open this number of steps, then pause."""
        self._credit.value = max(0, steps)

    def set_speed(self, steps_per_s: float | None) -> None:
        """Limit the steps per second; None: unlimited. ValueError if that is too slow."""
        if steps_per_s is not None and not steps_per_s >= SLOWEST:
            raise ValueError(f"speed = {steps_per_s:g}: must be {SLOWEST:g} steps per second or more")
        self._period.value = 1 / steps_per_s if steps_per_s else 0.0

    def kill(self, robot: int) -> None:
        """Kill a robot's process at the start of the next step; ValueError if the robot does not exist."""
        request = kill(self._expect(), robot)
        if not self._may_kill:
            raise ValueError("kill: possible only if all robots run on this host")
        self._requests.put(request)

    def change(self, *, bandwidth: int | str | None = None, range: float | str | None = None) -> None:
        """Change the radio from the next step on; values as in a scenario. ScenarioError if they are invalid."""
        self._requests.put(change(self._expect(), self._diagonal_m, bandwidth=bandwidth, range=range))

    def attach(self, plan: Plan, pace: float | None = None, *, may_kill: bool = True) -> None:
        """Control the run of `plan`, at most `pace` steps per second; `may_kill`: whether robots can be killed."""
        self._scenario, self._diagonal_m, self._may_kill = plan.scenario, plan.map.diagonal_m, may_kill
        if pace is not None:
            self.set_speed(pace)

    def heed(self, recorder: RecorderNode) -> None:
        """Send the pending requests."""
        self.step_now = recorder.records.step
        while not self._requests.empty():
            recorder.request(self._requests.get())

    def gate(self, free: int = 0) -> Gate:
        """Return the gate that the world passes before each step, except the first `free` steps."""
        return Gate(self._credit, self._period, free)

    def _expect(self) -> Scenario:
        if self._scenario is None:
            raise ValueError("the run has not started")
        return self._scenario


def kill(scenario: Scenario, robot: int) -> FaultEvent:
    """Return the request to kill a robot; ValueError if the robot does not exist."""
    if not 0 <= robot < scenario.robots:
        raise ValueError(f"kill: unknown robot {robot}; the last one is {scenario.robots - 1}")
    return FaultEvent(0, robot, "kill")


def change(
    scenario: Scenario, diagonal_m: float, *, bandwidth: int | str | None, range: float | str | None
) -> Change:
    """Return the request to change the radio; ScenarioError if the values are invalid."""
    table = {"step": 1, "bandwidth": bandwidth, "range": range}
    try:
        valid = Scenario(**scenario.model_dump() | {"change": [table]}).changes(diagonal_m)[0]
    except ScenarioError as error:
        raise ScenarioError(str(error).replace("change.0.", "")) from None  # no scenario file has this table
    return Change(0, valid.budget, valid.range_mm)


def as_it_went(plan: Plan, records: Records) -> Plan:
    """Return the plan with the kills and radio changes of the run in its scenario, which then repeats the run."""
    scenario = plan.scenario
    scheduled = {(fault.step, fault.robot) for fault in scenario.faults if fault.kind in ("kill", "restart")}
    kills = [
        FaultTable(step=event.step, robot=event.robot, kind="kill")
        for event in records.fault_events
        if event.kind == "kill" and (event.step, event.robot) not in scheduled
    ]
    update: dict[str, Any] = {}
    if kills:
        update["fault"] = _applied((*scenario.fault, *kills), scenario.robots)
    if not set(records.changes) <= set(plan.radio.changes):
        update["change"] = _merged((*scenario.change, *map(_table, records.changes)))
    return replace(plan, scenario=scenario.model_copy(update=update)) if update else plan


def _applied(tables: Iterable[FaultTable], robots: int) -> tuple[FaultTable, ...]:
    """Return the faults by step, without those of robots that an earlier kill has removed."""
    applied: list[FaultTable] = []
    for table in sorted(tables, key=lambda table: table.event):
        with suppress(ValueError):  # the robot is gone by then
            faults.check([each.event for each in (*applied, table)], robots)
            applied.append(table)
    return tuple(applied)


def _merged(changes: Iterable[ChangeTable]) -> tuple[ChangeTable, ...]:
    """Merge the changes of each step into one table; of several values of a setting, the last one counts."""
    merged: dict[int, dict[str, Any]] = {}
    for each in changes:
        merged.setdefault(each.step, {}).update(each.model_dump(exclude_none=True))
    return tuple(ChangeTable(**merged[step]) for step in sorted(merged))


def _table(change: Change) -> ChangeTable:
    """The table ``[[change]]`` of a change that has occurred."""
    range_m = None if change.range_mm is None else repr(change.range_mm / 1000)
    bandwidth: Any = None if change.budget is None else str(change.budget)
    return ChangeTable(step=change.step, bandwidth=bandwidth, range=range_m)


def why_unrepeatable(summary: dict[str, Any]) -> str:
    """Return why a run cannot be repeated: an event that its scenario does not contain; empty if it can."""
    if summary.get("clock") == "field":
        return "it was in the field"
    if summary["reason"] in CUT_SHORT:
        return f"it was {summary['reason']} at step {summary['steps']}"
    back = "; ".join(
        f"robot {robot} was lost at step {step} and came back" for step, robot in summary.get("returned", [])
    )
    if back:
        return f"{back}, unexpectedly"
    if summary.get("clock") == "wall" and summary["reconnected"]:
        return "connections were cut and restored, by the wall clock"
    lost = "; ".join(
        f"robot {robot} was lost: {cause}" for robot, cause in summary["lost"].items() if cause != NO_MAPS
    )
    return f"{lost}, unexpectedly" if lost else ""


def maps_not_sent(summary: dict[str, Any]) -> set[int]:
    """Return the robots that took part in all steps of a run, but whose maps did not arrive afterwards."""
    return {int(robot) for robot, cause in summary["lost"].items() if cause == NO_MAPS}
