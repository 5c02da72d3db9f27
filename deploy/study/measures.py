"""What is measured of a case: an exploration, or something else that a case's plan allows to be measured.

An experiment names one of `MEASURES`; ``exploration``, the default, runs the scenario on the memory bus. A measure
takes a plan and returns figures by name, which become columns of the table of runs. A new one is a function in this
file, its line in `MEASURES`, and the names of its figures in `METRICS`.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.planning.assignment import Assignment, best_of_all, in_turn, total_value
from agent.planning.frontier import frontier_cells
from deploy.record.records import Records
from deploy.record.summary import summarize
from deploy.run import in_memory
from deploy.scenario.plan import Plan
from deploy.study.recovery import recovery
from netshaper.ledger import KIND_NUMBER
from protocol.budget import WORD_FOR_UNLIMITED
from protocol.grid import FREE, UNKNOWN
from protocol.keyed_random import keyed_random

EXPLORATION = "exploration"

Figures = dict[str, Any]
Measure = Callable[[Plan], Figures]

KNOWN_DISCS = 8
"""Of the building in which assignments are measured."""

AFTER_MEETING = 10
"""Steps after two robots have come into range of each other in which what waited is expected on the air."""

SERIES = ("explored", "carried")
"""Series over the steps: what share of the reachable cells the team has seen, and bytes on the air."""


def exploration(plan: Plan) -> Figures:
    """Run the plan's scenario; return its summary, nested figures with dotted names, and more about its medium."""
    began = time.perf_counter()
    records = in_memory.run(plan)
    figures: Figures = {}
    for name, value in summarize(plan, records, time.perf_counter() - began).items():
        if name in ("lost", "returned", "versions"):
            figures[name] = json.dumps(value, sort_keys=True)
        elif isinstance(value, dict):
            figures |= {f"{name}.{inner}": number for inner, number in value.items()}
        else:
            figures[name] = value
    carried = _carried(records)
    figures["explored"] = [round(report.seen / report.reachable, 6) for report in records.world]
    figures["carried"] = carried.tolist()
    return figures | _load(plan, records, carried)


def assignment(plan: Plan) -> Figures:
    """Time that one assignment takes by Algorithms 1 and 2 of Burgard et al., and what the two are worth.

    The team stands in cells drawn from the seed, in a building of which discs of the sensor range around drawn
    cells are known; all frontier cells are goals. Processor time, the least of three.
    """
    scenario, truth = plan.scenario, plan.map.cells
    reachable = np.argwhere(plan.make_world().reachable)
    ranges = np.array([body.range_cells for body in plan.world.bodies])
    random = keyed_random(scenario.seed, "assignment")
    grid = np.full_like(truth, UNKNOWN)
    rows, columns = np.indices(truth.shape)
    for y, x in reachable[random.integers(len(reachable), size=KNOWN_DISCS)]:
        near = (columns - x) ** 2 + (rows - y) ** 2 < ranges[0] ** 2
        grid[near] = truth[near]
    goals = frontier_cells(grid, grid == FREE)
    places = reachable[random.integers(len(reachable), size=scenario.robots)][:, ::-1]
    costs = np.hypot(*(places[:, None, :] - goals[None, :, :]).transpose(2, 0, 1)) / ranges[0]
    utility = np.ones(len(goals))
    greedy, greedy_ms = _timed(lambda: in_turn(grid, goals, utility, costs, ranges))
    optimal, optimal_ms = _timed(
        lambda: best_of_all(grid, goals, utility, costs**2, ranges, keyed_random(scenario.seed, "search"))
    )
    return {
        "assignment.greedy_ms": greedy_ms,
        "assignment.optimal_ms": optimal_ms,
        "assignment.greedy_value": total_value(grid, goals, utility, costs**2, ranges, greedy),
        "assignment.optimal_value": total_value(grid, goals, utility, costs**2, ranges, optimal),
    }


def _timed(work: Callable[[], Assignment]) -> tuple[Assignment, float]:
    """The outcome of some work, and the milliseconds of processor time that it took, the least of three times."""
    took = []
    for _ in range(3):
        began = time.process_time()
        outcome = work()
        took.append(1000 * (time.process_time() - began))
    return outcome, min(took)


def voronoi(plan: Plan) -> Figures:
    """Voronoi pixels for each contour pixel of the plan's map, as it is and smoothed (thesis, Table 3.1)."""
    from deploy.study.voronoi import free_space, pixels, smoothed  # noqa: PLC0415  scipy, which few measures need

    free = free_space(plan.map.cells)
    before, after = pixels(free), pixels(smoothed(free))
    return {
        "voronoi.ratio": before.ratio,
        "voronoi.ratio_smoothed": after.ratio,
        "voronoi.pixels": before.voronoi,
        "voronoi.contour": before.contour,
    }


MEASURES: dict[str, Measure] = {
    EXPLORATION: exploration,
    "assignment": assignment,
    "voronoi": voronoi,
    "recovery": recovery,
}

METRICS: dict[str, tuple[str, ...]] = {
    EXPLORATION: ("load.first_quarter", "load.last_quarter", "load.emerging", "load.meeting"),
    "assignment": (
        "assignment.greedy_ms", "assignment.optimal_ms", "assignment.greedy_value", "assignment.optimal_value",
    ),
    "voronoi": ("voronoi.ratio", "voronoi.ratio_smoothed", "voronoi.pixels", "voronoi.contour"),
    "recovery": ("recovery.steps", "recovery.bytes", "recovery.alone", "recovery.again", "recovery.end"),
}  # fmt: skip
"""Figures of each measure; `exploration` has those of a summary besides."""


def _carried(records: Records) -> NDArray[np.int64]:
    """Bytes on the air, by step."""
    rows = records.ledger()
    on_air: NDArray[np.int64] = np.zeros(max(records.step + 1, 1), np.int64)
    np.add.at(on_air, rows["step"], rows["bytes"] * (rows["carried"] == 1))
    return on_air[1:]


def _load(plan: Plan, records: Records, carried: NDArray[np.int64]) -> Figures:
    """Figures of the channel's load: what share of the budget was used in the first and the last quarter of the
    steps.

    ``load.meeting`` is the mean load of the steps just after two robots have come into each other's range, and
    ``load.emerging`` the mean load of the steps in which most objects emerge (at least half of the most of
    them, after the first ten steps), each over that of the other steps.
    """
    quarter = max(1, len(carried) // 4)
    budget = plan.scenario.bandwidth
    shares: Figures = dict.fromkeys(METRICS[EXPLORATION])
    if budget != WORD_FOR_UNLIMITED and budget and len(carried):
        shares["load.first_quarter"] = float(carried[:quarter].mean() / int(budget))
        shares["load.last_quarter"] = float(carried[-quarter:].mean() / int(budget))
    rows = records.ledger()
    born = np.zeros(len(carried) + 1, np.int64)
    chosen = rows[(rows["kind"] == KIND_NUMBER["em"]) & (rows["carried"] == 1)]
    np.add.at(born, chosen["step"], chosen["packets"])
    later, born = carried[10:], born[11:]
    many = born >= max(1, born.max(initial=0) / 2)
    shares["load.emerging"] = _over_the_rest(later, many)
    shares["load.meeting"] = _over_the_rest(carried, _meetings(plan, records))
    return shares


def _over_the_rest(values: NDArray[np.int64], chosen: NDArray[np.bool_]) -> float | None:
    """Mean of the chosen values over that of the others; None if there are none of either, or those are 0."""
    if not chosen.any() or chosen.all() or not values[~chosen].any():
        return None
    return float(values[chosen].mean() / values[~chosen].mean())


def _meetings(plan: Plan, records: Records) -> NDArray[np.bool_]:
    """Steps in which two robots have just come into range, and the `AFTER_MEETING` - 1 after each."""
    rendezvous = np.zeros(records.step, np.bool_)
    before: set[tuple[int, int]] | None = None
    for number, report in enumerate(records.world):
        poses = np.frombuffer(report.poses, "<i4").reshape(-1, 4)
        apart = np.hypot(*(poses[:, None, 1:3] - poses[None, :, 1:3]).transpose(2, 0, 1)) / 1000
        ones, others = np.nonzero(apart <= plan.range_m)
        names = poses[:, 0].tolist()
        now = {(names[one], names[other]) for one, other in zip(ones, others, strict=True) if one < other}
        if before is not None and now - before:
            rendezvous[number : number + AFTER_MEETING] = True
        before = now
    return rendezvous
