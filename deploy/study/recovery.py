"""The cost of a fault: when a returning robot has its knowledge back, and how much its teammates explore again.

The measurement concerns the scenario's first ``kill`` or ``restart``; other faults may occur as well.
"""

from __future__ import annotations

from operator import attrgetter
from typing import Any

import numpy as np

from deploy.run.in_memory import MemoryRun
from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import Plan
from protocol.grid import FREE, UNKNOWN, Grid

RECOVERED = 0.97
"""Share of its former knowledge that a recovered robot has."""


def recovery(plan: Plan) -> dict[str, Any]:
    """Run the plan's scenario to its end, and measure its first ``kill`` or ``restart``; ScenarioError without one.

    - ``recovery.steps``: steps until the robot knows `RECOVERED` of the known cells of its former planning grid; None
      if it never does
    - ``recovery.bytes``: bytes transmitted in these steps
    - ``recovery.exclusive``: free cells that only this robot had seen
    - ``recovery.reexplored``: these cells as seen again by teammates that did not know them, summed over robots
    - ``recovery.end``: steps of the run
    """
    faults = [fault for fault in plan.scenario.fault if fault.kind in ("kill", "restart")]
    if not faults:
        raise ScenarioError("measure = 'recovery': needs a [[fault]] of kind 'kill' or 'restart'")
    fault = min(faults, key=attrgetter("step"))
    run, failing = MemoryRun(plan), fault.robot
    known_before = exclusive = np.zeros(plan.map.cells.shape, np.bool_)
    recovered: int | None = None
    reexplored = 0
    previous: dict[int, tuple[Grid, Grid]] = {}
    for step in run.steps():
        robots = {number: agent.robot for number, agent in enumerate(run.agents) if agent.robot is not None}
        others = robots.keys() - {failing}
        if step < fault.step and failing in robots:
            known_before = robots[failing].planning != UNKNOWN
            seen_by_others = np.any([robots[other].own == FREE for other in others], axis=0)
            exclusive = (robots[failing].own == FREE) & ~seen_by_others
        if step < fault.step - 1:
            continue
        for other in others:
            own, planning = robots[other].own, robots[other].planning
            if other in previous:
                unknown = np.logical_and(*(grid == UNKNOWN for grid in previous[other]))
                reexplored += int((exclusive & (own == FREE) & unknown).sum())
            previous[other] = own.copy(), planning.copy()
        is_back = fault.kind == "restart" and step >= fault.step and failing in robots
        if is_back and recovered is None:
            known = (robots[failing].planning != UNKNOWN)[known_before].mean()
            recovered = step if known >= RECOVERED else None
    rows = run.records.ledger()
    meanwhile = (rows["step"] >= fault.step) & (rows["step"] <= (recovered or 0)) & (rows["carried"] == 1)
    return {
        "recovery.steps": None if recovered is None else recovered - fault.step + 1,
        "recovery.bytes": None if recovered is None else int(rows["bytes"][meanwhile].sum()),
        "recovery.exclusive": int(exclusive.sum()),
        "recovery.reexplored": reexplored,
        "recovery.end": run.records.step,
    }
