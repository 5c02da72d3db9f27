"""Of A, B and C only A hears B, which is then killed: what was passed on is not lost with it (thesis, 5.1.2)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deploy.run.in_memory import MemoryRun
from deploy.scenario.plan import make
from deploy.scenario.scenario import load
from protocol.grid import FREE, UNKNOWN

A, B, C = range(3)


def explored_again(*, pass_on: bool) -> tuple[int, int, int]:
    """Run the shipped line; return cells of B's part, those that A or C explored again, and the steps.

    B's part is what B alone has seen before it is killed. Explored is what a robot sees that it did not know.
    """
    scenario = load(Path("line.toml"), {"pass_on": pass_on, "bus": "memory"})
    (fault,) = scenario.fault
    assert (fault.robot, fault.kind) == (B, "kill")
    run = MemoryRun(make(scenario))
    part, again = None, 0
    known: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for step in run.steps():
        robots = {number: agent.robot for number, agent in enumerate(run.agents) if agent.robot is not None}
        if step == fault.step - 1:
            seen = {number: robot.own == FREE for number, robot in robots.items()}
            part = seen[B] & ~seen[A] & ~seen[C]
        for number in (A, C) if step else ():
            own, planning = robots[number].own, robots[number].planning
            if part is not None and number in known:
                before, plan = known[number]
                again += int((part & (own == FREE) & (before == UNKNOWN) & (plan == UNKNOWN)).sum())
            known[number] = own.copy(), planning.copy()
    assert part is not None
    assert run.records.end is not None
    assert run.records.end.reason == "explored"
    return int(part.sum()), again, run.records.end.step


def test_without_passing_on_b_s_part_is_explored_again_and_with_it_it_is_not() -> None:
    (part, lost, longer), (_, kept, shorter) = explored_again(pass_on=False), explored_again(pass_on=True)
    assert lost > 0.9 * part
    assert kept < 0.05 * part
    assert shorter < longer
