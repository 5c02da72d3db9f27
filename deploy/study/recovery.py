"""What a fault costs: how soon a robot that comes back knows what it knew, and what teammates explore again.

The scenario's first ``kill`` or ``restart`` is measured, whoever else something happens to.
"""

from __future__ import annotations

from operator import attrgetter
from typing import Any

import numpy as np

from deploy.run.in_memory import MemoryRun
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import ScenarioError
from protocol.grid import FREE, UNKNOWN, Grid

ENOUGH = 0.97
"""Part of what a robot knew before that it knows again once it has recovered."""


def recovery(plan: Plan) -> dict[str, Any]:
    """Run the plan's scenario to its end, and measure its first ``kill`` or ``restart``.

    Returns
    -------
    dict
        ``recovery.steps``: those until the robot's new life knows `ENOUGH` of the cells of its old planning grid,
        None if it never does; ``recovery.bytes``: on the air meanwhile; ``recovery.alone``: free cells that the robot
        alone had seen; ``recovery.again``: such cells that teammates explored, by robot: they saw them themselves, and
        had not known of them; ``recovery.end``: steps of the run.

    Raises
    ------
    ScenarioError
        Nothing is killed or restarted.
    """
    struck = [fault for fault in plan.scenario.fault if fault.kind in ("kill", "restart")]
    if not struck:
        raise ScenarioError("measure = 'recovery': needs a [[fault]] of kind 'kill' or 'restart'")
    first = min(struck, key=attrgetter("step"))
    run, whose = MemoryRun(plan), first.robot
    knew = alone = np.zeros(plan.map.cells.shape, np.bool_)
    recovered: int | None = None
    again = 0
    known: dict[int, tuple[Grid, Grid]] = {}
    for step in run.steps():
        robots = {number: agent.robot for number, agent in enumerate(run.agents) if agent.robot is not None}
        others = robots.keys() - {whose}
        if step < first.step and whose in robots:
            knew = robots[whose].planning != UNKNOWN
            alone = (robots[whose].own == FREE) & ~np.any(
                [robots[other].own == FREE for other in others], axis=0
            )
        if step < first.step - 1:
            continue
        for other in others:
            own, planning = robots[other].own, robots[other].planning
            if other in known:
                seen, told = known[other]
                again += int((alone & (own == FREE) & (seen == UNKNOWN) & (told == UNKNOWN)).sum())
            known[other] = own.copy(), planning.copy()
        back = first.kind == "restart" and step >= first.step and whose in robots
        if back and recovered is None and (robots[whose].planning != UNKNOWN)[knew].mean() >= ENOUGH:
            recovered = step
    rows = run.records.ledger()
    meanwhile = (rows["step"] >= first.step) & (rows["step"] <= (recovered or 0)) & (rows["carried"] == 1)
    return {
        "recovery.steps": None if recovered is None else recovered - first.step + 1,
        "recovery.bytes": None if recovered is None else int(rows["bytes"][meanwhile].sum()),
        "recovery.alone": int(alone.sum()),
        "recovery.again": again,
        "recovery.end": run.records.step,
    }
