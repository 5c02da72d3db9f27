"""Live control of a run: pause it, step, set its speed, kill a robot, change the radio (docs/dashboard.md).

What was done is recorded as data of its scenario, with the step at which it came true, so that the run repeats.
"""

from __future__ import annotations

import multiprocessing
import queue
from dataclasses import replace
from typing import Literal

from deploy.record.records import RecorderNode, Records
from deploy.run.gate import Gate
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from deploy.scenario.tables import ChangeTable, FaultTable
from protocol.messages import Change, FaultEvent
from worldsim.pace import SLOWEST


class Control:
    """What can be done to a run while it is under way; from any thread. Give it to `explore`, as ``control=...``.

    Parameters
    ----------
    pace : float, optional
        Steps a second at most, at first.
    """

    def __init__(self, pace: float | None = None) -> None:
        values = multiprocessing.get_context("forkserver")
        self._credit = values.Value("q", -1)
        """Steps that may be opened; -1: any number."""
        self._period = values.Value("d", 1 / pace if pace else 0.0)
        self._wishes: queue.SimpleQueue[FaultEvent | Change] = queue.SimpleQueue()
        self._scenario: Scenario | None = None
        self._diagonal_m = 0.0
        self._may_kill = True

    @property
    def paused(self) -> bool:
        """Whether the run waits for `resume` or `step`."""
        return bool(self._credit.value == 0)

    @property
    def speed(self) -> float | None:
        """Steps a second at most; None: as fast as it goes."""
        return 1 / self._period.value if self._period.value else None

    def pause(self) -> None:
        """Open no further step."""
        self._credit.value = 0

    def resume(self) -> None:
        """Go on."""
        self._credit.value = -1

    def step(self, steps: int = 1) -> None:
        """Open so many steps, then pause."""
        self._credit.value = max(0, steps)

    def set_speed(self, steps_per_s: float | None) -> None:
        """Open no more steps a second; None: as fast as it goes. ValueError if that is too slow."""
        if steps_per_s is not None and not steps_per_s >= SLOWEST:
            raise ValueError(f"speed = {steps_per_s:g}: must be {SLOWEST:g} steps a second or more")
        self._period.value = 1 / steps_per_s if steps_per_s else 0.0

    def kill(self, robot: int) -> None:
        """Kill a robot with all that it knows, at the beginning of the next step; ValueError if there is none."""
        wish = kill(self._expect(), robot)
        if not self._may_kill:
            raise ValueError("kill: robots can be killed where all of them run on this host")
        self._wishes.put(wish)

    def change(self, *, bandwidth: int | str | None = None, range: float | str | None = None) -> None:
        """Change the radio from the next step on; values as in a scenario. ScenarioError says what is wrong."""
        self._wishes.put(change(self._expect(), self._diagonal_m, bandwidth=bandwidth, range=range))

    def attach(self, plan: Plan, *, may_kill: bool = True) -> None:
        """Say which run it is that is controlled, and whether its robots can be killed."""
        self._scenario, self._diagonal_m, self._may_kill = plan.scenario, plan.map.diagonal_m, may_kill

    def heed(self, recorder: RecorderNode) -> None:
        """Pass on what was wished for."""
        while not self._wishes.empty():
            recorder.request(self._wishes.get())

    def gate(self, free: int = 0) -> Gate:
        """What the world passes before it opens a step; the first `free` ones it opens without."""
        return Gate(self._credit, self._period, free)

    def _expect(self) -> Scenario:
        if self._scenario is None:
            raise ValueError("the run has not begun")
        return self._scenario


def kill(scenario: Scenario, robot: int) -> FaultEvent:
    """The wish that a robot be killed; ValueError if there is no such robot."""
    if not 0 <= robot < scenario.robots:
        raise ValueError(f"kill: there is no robot {robot}; the last one is {scenario.robots - 1}")
    return FaultEvent(0, robot, "kill")


def change(
    scenario: Scenario, diagonal_m: float, *, bandwidth: int | str | None, range: float | str | None
) -> Change:
    """The wish that the radio be another; ScenarioError says what is wrong."""
    asked = {"step": 1, "bandwidth": bandwidth, "range": range}
    wished = Scenario(**scenario.model_dump() | {"change": [asked]}).changes(diagonal_m)[0]
    return Change(0, wished.budget, wished.range_mm)


def as_it_went(plan: Plan, records: Records) -> Plan:
    """The plan with what was done to the run: its scenario then repeats it."""
    scenario = plan.scenario
    known = {(fault.step, fault.robot) for fault in scenario.faults if fault.kind in ("kill", "restart")}
    kills = [
        FaultTable(step=event.step, robot=event.robot, kind="kill")
        for event in records.fault_events
        if event.kind == "kill" and (event.step, event.robot) not in known
    ]
    had = {(each.step, each.budget, each.range_mm) for each in plan.radio.changes}
    changes = [
        ChangeTable(
            step=each.step,
            bandwidth=_bandwidth(each),
            range=None if each.range_mm is None else repr(each.range_mm / 1000),
        )
        for each in records.changes
        if (each.step, each.budget, each.range_mm) not in had
    ]
    if not kills and not changes:
        return plan
    update = {"fault": (*scenario.fault, *kills), "change": (*scenario.change, *changes)}
    return replace(plan, scenario=scenario.model_copy(update=update))


def _bandwidth(change: Change) -> int | Literal["unlimited"] | None:
    """The bandwidth of a change as a scenario writes it."""
    if change.budget is None:
        return None
    return "unlimited" if change.budget.limit is None else change.budget.limit
