"""Measures: functions from the plan of a case to its metrics.

An experiment names one of `MEASURES`; ``exploration``, the default, runs the scenario on the memory bus. The metrics of
a measure become columns of the table of runs. A new measure is a function in this file, its name in `MEASURES`, and the
names of its metrics in `METRICS`.
"""

from __future__ import annotations

import json
import time
import timeit
from collections.abc import Callable, Sequence
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.planning.assignment import Assignment, best_of_all, in_turn, total_value
from agent.planning.frontier import frontier_cells
from deploy.record.records import Records
from deploy.record.summary import VALUE_BYTES, raw_scan_bytes, summarize
from deploy.run.in_memory import MemoryRun
from deploy.run.offline_bound import known_map_steps
from deploy.scenario.plan import Plan
from deploy.study.recovery import recovery
from netshaper.ledger import KIND_NUMBER
from protocol.grid import FREE, UNKNOWN, Grid
from protocol.keyed_random import keyed_random

EXPLORATION = "exploration"

Metrics = dict[str, Any]
Measure = Callable[[Plan], Metrics]

KNOWN_DISCS = 8
"""Number of known discs on the map of the assignment measure."""

RENDEZVOUS_STEPS = 10
"""Steps after two robots have come into range of each other, in which they transmit their backlog."""

AGREEMENT_EVERY = 5
"""Steps from one comparison of the robots' planning grids to the next."""

SERIES = ("explored", "carried")
"""Series over the steps: share of the reachable cells that the team has seen, and transmitted bytes."""


def exploration(plan: Plan) -> Metrics:
    """Run the plan's scenario; return its summary with dotted names for nested values, series, and channel load."""
    began = time.perf_counter()
    return _metrics(plan, MemoryRun(plan).complete(), began)


def agreement(plan: Plan) -> Metrics:
    """Run the plan's scenario as `exploration` does; also compare the robots' grids with each other on the way.

    The agreement of two grids is the share of equal cells among those that at least one of them knows. It is averaged
    over all pairs, every `AGREEMENT_EVERY` steps. ``agreement.planning`` is the mean over these steps for planning
    grids, ``agreement.least`` the minimum, ``agreement.last`` the last value, and ``agreement.own`` the mean for
    self-explored grids, which shows what robots would have without maps of others.
    """
    began = time.perf_counter()
    run = MemoryRun(plan)
    found: list[tuple[float, float]] = []
    for step in run.steps():
        if step and step % AGREEMENT_EVERY == 0:
            robots = [agent.robot for agent in run.agents if agent.robot is not None]
            grids = [robot.planning for robot in robots], [robot.own for robot in robots]
            found.append((_agreement(grids[0]), _agreement(grids[1])))
    planning, own = np.array(found).reshape(-1, 2).T
    return _metrics(plan, run.records, began) | {
        "agreement.planning": float(planning.mean()) if len(planning) else None,
        "agreement.least": float(planning.min()) if len(planning) else None,
        "agreement.last": float(planning[-1]) if len(planning) else None,
        "agreement.own": float(own.mean()) if len(own) else None,
    }


def offline(plan: Plan) -> Metrics:
    """Run the plan's scenario as `exploration` does; ``offline.steps`` is the time of a team that knows the map."""
    return exploration(plan) | {"offline.steps": known_map_steps(plan)}


def _agreement(grids: Sequence[Grid]) -> float:
    """Return the mean over all pairs of grids of the share of equal cells among those that either knows."""
    shares = [
        ((one == other) & (one != UNKNOWN)).sum() / max(((one != UNKNOWN) | (other != UNKNOWN)).sum(), 1)
        for one, other in combinations(grids, 2)
    ]
    return float(np.mean(shares)) if shares else 1.0


def _metrics(plan: Plan, records: Records, began: float) -> Metrics:
    """The summary of a run that started at `began`, with dotted names for nested values, series, and channel load."""
    metrics: Metrics = {}
    for name, value in summarize(plan, records, time.perf_counter() - began).items():
        if name in ("lost", "returned", "reconnected", "robot_maps", "versions"):
            metrics[name] = json.dumps(value, sort_keys=True)
        elif isinstance(value, dict):
            metrics |= {f"{name}.{inner}": number for inner, number in value.items()}
        else:
            metrics[name] = value
    carried = _carried(records)
    metrics["explored"] = [round(report.seen / report.reachable, 6) for report in records.world]
    metrics["carried"] = carried.tolist()
    return metrics | _until_known(plan, metrics["known_at"], carried) | _load(plan, records, carried)


def assignment(plan: Plan) -> Metrics:
    """Processor time and value of one assignment by Algorithms 1 and 2 of Burgard et al., and without coordination.

    Robots stand in random cells of a map on which discs of the sensor range around random cells are known. All
    frontier cells are goals. The time is the minimum of three repetitions. It does not include the costs of ways.
    ``assignment.ms`` is the time of the rule of the scenario's strategy: `nearest`, `burgard`, or `burgard-optimal`.
    Other strategies have none.
    """
    scenario, truth = plan.scenario, plan.map.cells
    reachable = np.argwhere(plan.reachable)
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
    search = partial(best_of_all, grid, goals, utility, costs**2, ranges)
    _, nearest_ms = _timed(lambda: costs.argmin(axis=1))
    greedy, greedy_ms = _timed(lambda: in_turn(grid, goals, utility, costs, ranges))
    optimal, optimal_ms = _timed(lambda: search(keyed_random(scenario.seed, "search")))
    times = {"nearest": nearest_ms, "burgard": greedy_ms, "burgard-optimal": optimal_ms}
    return {
        "assignment.ms": times.get(scenario.strategy),
        "assignment.greedy_ms": greedy_ms,
        "assignment.optimal_ms": optimal_ms,
        "assignment.greedy_value": total_value(grid, goals, utility, costs**2, ranges, greedy),
        "assignment.optimal_value": total_value(grid, goals, utility, costs**2, ranges, optimal),
    }


def _timed(work: Callable[[], Assignment]) -> tuple[Assignment, float]:
    """Call a function three times; return its result and the minimum processor time in milliseconds."""
    ms = min(timeit.repeat(work, timer=time.process_time, number=1, repeat=3))
    return work(), 1000 * ms


def voronoi(plan: Plan) -> Metrics:
    """Voronoi pixels per contour pixel of the plan's cleaned map, before and after smoothing (thesis, Table 3.1)."""
    from deploy.study.voronoi import cleaned, free_space, pixels, smoothed  # noqa: PLC0415  scipy, for few measures

    free = cleaned(free_space(plan.map.cells), plan.map.resolution)
    before, after = pixels(free), pixels(smoothed(free))
    return {
        "voronoi.ratio": before.ratio,
        "voronoi.ratio_smoothed": after.ratio,
        "voronoi.pixels": before.voronoi,
        "voronoi.contour": before.contour,
    }


_ALL = (exploration, agreement, assignment, voronoi, recovery, offline)
MEASURES: dict[str, Measure] = {each.__name__: each for each in _ALL}

EXPLORED = (
    "load.first_quarter", "load.last_quarter", "load.emerging", "load.rendezvous",
    "known.bytes", "known.raw_scan_bytes", "known.scan_values",
)  # fmt: skip
"""Metrics that measures of explorations have, besides those of a summary."""
RECORDED = "scans", "bytes_per_scan", "steps_after_scans", "backlog_after_scans", "backlog"
"""Metrics that only recorded runs have."""

METRICS: dict[str, tuple[str, ...]] = {
    EXPLORATION: (*EXPLORED, *RECORDED),
    "agreement": (
        *EXPLORED, "agreement.planning", "agreement.least", "agreement.last", "agreement.own",
    ),
    "assignment": (
        "assignment.ms", "assignment.greedy_ms", "assignment.optimal_ms",
        "assignment.greedy_value", "assignment.optimal_value",
    ),
    "voronoi": ("voronoi.ratio", "voronoi.ratio_smoothed", "voronoi.pixels", "voronoi.contour"),
    "offline": (*EXPLORED, "offline.steps"),
    "recovery": ("recovery.steps", "recovery.bytes", "recovery.exclusive", "recovery.reexplored", "recovery.end"),
}  # fmt: skip
"""Metrics of each measure; `exploration`, `agreement` and `offline` have those of a summary as well."""


def _carried(records: Records) -> NDArray[np.int64]:
    """Transmitted bytes by step."""
    rows = records.ledger()
    sent: NDArray[np.int64] = np.zeros(max(records.step + 1, 1), np.int64)
    np.add.at(sent, rows["step"], rows["bytes"] * (rows["carried"] == 1))
    return sent[1:]


def _until_known(plan: Plan, known_at: int | None, carried: NDArray[np.int64]) -> Metrics:
    """Transmitted bytes until the first robot knew the full map, and those of raw scans by the thesis' formula.

    ``known.scan_values`` is the number of values in these scans, and so their bytes with one byte a value.
    """
    if known_at is None:
        return dict.fromkeys(("known.bytes", "known.raw_scan_bytes", "known.scan_values"))
    return {
        "known.bytes": int(carried[:known_at].sum()),
        "known.raw_scan_bytes": raw_scan_bytes(known_at, plan.scenario.robots),
        "known.scan_values": raw_scan_bytes(known_at, plan.scenario.robots) // VALUE_BYTES,
    }


def _load(plan: Plan, records: Records, carried: NDArray[np.int64]) -> Metrics:
    """Metrics of the channel load: the used share of the budget in the first and the last quarter of the steps.

    ``load.rendezvous`` is the mean load of the steps just after two robots have come into each other's range, relative
    to all other steps. ``load.emerging`` is the same for the steps with many new objects: at least half of the maximum,
    after the first ten steps.
    """
    quarter = max(1, len(carried) // 4)
    budget = plan.radio.budget.limit
    shares: Metrics = {name: None for name in EXPLORED if name.startswith("load.")}
    if budget and len(carried):
        shares["load.first_quarter"] = float(carried[:quarter].mean() / budget)
        shares["load.last_quarter"] = float(carried[-quarter:].mean() / budget)
    rows = records.ledger()
    born = np.zeros(len(carried) + 1, np.int64)
    chosen = rows[(rows["kind"] == KIND_NUMBER["em"]) & (rows["carried"] == 1)]
    np.add.at(born, chosen["step"], chosen["packets"])
    later, born = carried[10:], born[11:]
    many = born >= max(1, born.max(initial=0) / 2)
    shares["load.emerging"] = _relative_to_rest(later, many)
    shares["load.rendezvous"] = _relative_to_rest(carried, _rendezvous(plan, records))
    return shares


def _relative_to_rest(values: NDArray[np.int64], chosen: NDArray[np.bool_]) -> float | None:
    """Mean of the chosen values over the mean of the others; None if either set is empty, or the others are 0."""
    if not chosen.any() or chosen.all() or not values[~chosen].any():
        return None
    return float(values[chosen].mean() / values[~chosen].mean())


def _rendezvous(plan: Plan, records: Records) -> NDArray[np.bool_]:
    """The steps in which two robots come into range, and the `RENDEZVOUS_STEPS` - 1 steps after each."""
    rendezvous = np.zeros(records.step, np.bool_)
    before: set[tuple[int, int]] | None = None
    for number, report in enumerate(records.world):
        poses = report.pose_rows
        apart = np.hypot(*(poses[:, None, 1:3] - poses[None, :, 1:3]).transpose(2, 0, 1)) / 1000
        ones, others = np.nonzero(apart <= plan.range_m)
        names = poses[:, 0].tolist()
        now = {(names[one], names[other]) for one, other in zip(ones, others, strict=True) if one < other}
        if before is not None and now - before:
            rendezvous[number : number + RENDEZVOUS_STEPS] = True
        before = now
    return rendezvous
