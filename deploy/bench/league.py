"""The league table: every strategy on the same maps, from the same starts, compared with offline exploration.

The baseline is the plan of a team that knows the map (`deploy.run.offline_bound`): the table gives a strategy's steps
as a multiple of that plan's. By default robots share raw scans over an unlimited radio, so that only their
destinations differ.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from agent.strategies.registry import strategies, strategy
from deploy.bench.replanning import DecisionTimer
from deploy.run.exploration import explore
from deploy.run.offline_bound import KnownBuilding, offline_steps
from deploy.run.workers import workers
from deploy.scenario import plan as plans
from deploy.scenario.scenario import Scenario, parse

OFFLINE = "(map known)"
"""The row of the table that is not a strategy."""

DEFAULTS = {
    "bus": "memory",
    "map_encoding": "scans",
    "bandwidth": "unlimited",
    "sensor_range": 5.0,
    "speed": 0.5,
}
"""Settings of all scenarios, unless the user overrides them."""

Run = dict[str, Any]
"""One run: strategy, map, robots, seed, steps. Strategies also have finished, t90, t99, coverage, driven (meters of
each robot) and replan_ms, the mean processor time of a decision in which a robot chooses a target."""


@dataclass(frozen=True)
class Task:
    """One strategy in one scenario; or `OFFLINE`, the plans of all scenarios of a map."""

    name: str
    scenarios: tuple[Scenario, ...]

    @property
    def key(self) -> str:
        """A unique name."""
        first = self.scenarios[0]
        return f"{self.name} on {first.map}, {first.robots} robots, seed {first.seed}"


def tasks(
    maps: Sequence[str], robots: Sequence[int], seeds: int, names: Sequence[str], settings: dict[str, Any]
) -> list[Task]:
    """The units of work: the offline plans of each map, and each strategy in each scenario.

    `maps` are names of shipped maps, or files, `robots` the team sizes, `seeds` the number of seeds, from 0, and
    `names` the strategies: all if empty. `settings` are settings of all scenarios, on top of `DEFAULTS`. Raises
    ValueError if a name or a setting is invalid.
    """
    competing = [*names] or sorted(strategies())
    for name in competing:
        strategy(name)
    scenarios = [
        parse({**DEFAULTS, **settings, "map": name, "robots": size, "seed": seed})
        for name, size, seed in product(maps, robots, range(seeds))
    ]
    offline = [
        Task(OFFLINE, tuple(each for each in scenarios if each.map == name)) for name in dict.fromkeys(maps)
    ]
    return offline + [Task(name, (scenario,)) for scenario in scenarios for name in competing]


def compete(todo: Sequence[Task], jobs: int | None = None) -> Iterator[list[Run]]:
    """Yield the runs of each task as it ends, by `jobs` processes; ConnectionError if a process dies."""
    for task, found in workers(jobs, None).each(todo, _run_task):
        if isinstance(found, str):
            raise ConnectionError(f"{task.key}: {found}")
        yield found


def _run_task(task: Task) -> list[Run]:
    return _run_offline(task.scenarios) if task.name == OFFLINE else _run_strategy(task.name, *task.scenarios)


def _run_strategy(name: str, scenario: Scenario) -> list[Run]:
    timer = DecisionTimer()
    with timer.attached_to(strategy(name)):
        summary = explore(scenario, keep=False, strategy=name).summary
    kept = {key: summary[key] for key in ("finished", "steps", "t90", "t99", "coverage")}
    mean = float(np.mean(timer.spent_ms)) if timer.spent_ms else None
    return [_run(name, scenario, **kept, driven=summary["path_length"], replan_ms=mean)]


def _run_offline(scenarios: Sequence[Scenario]) -> list[Run]:
    """The offline plan of each team on one map."""
    building: KnownBuilding | None = None
    found = []
    for scenario in scenarios:
        plan = plans.make(scenario)
        settings = plan.world
        body, starts = settings.bodies[0], settings.starts
        if building is None or not building.reaches(starts[0]):
            building = KnownBuilding(
                plan.map.cells, starts[0], body.range_cells, body.speed, settings.beams, body.radius_cells
            )
        found.append(_run(OFFLINE, scenario, steps=offline_steps(building, starts)))
    return found


def _run(name: str, scenario: Scenario, **values: Any) -> Run:
    run = {"strategy": name, "map": scenario.map, "robots": scenario.robots, "seed": scenario.seed}
    return run | values


def table(runs: Sequence[Run]) -> pl.DataFrame:
    """The league table: a row per strategy with means over its runs, the fastest strategy first.

    Columns: strategy, runs, finished (share of runs); over the finished runs steps, t90, t99 and multiple (steps over
    those of the offline plan for the same map, team and start); min_coverage, path_m (meters of the whole team),
    max_path and min_path (longest and shortest path of a robot over the team's mean), replan_ms.
    """
    frame = pl.DataFrame(list(runs), infer_schema_length=None)
    case = ["map", "robots", "seed"]
    offline = frame.filter(pl.col("strategy") == OFFLINE).select(*case, pl.col("steps").alias("offline"))
    paths = pl.col("driven").list
    finished = pl.col("finished").fill_null(value=True)
    return (
        frame.join(offline, on=case)
        .with_columns(finished, pl.when(finished).then(pl.col("steps", "t90", "t99")))
        .group_by("strategy")
        .agg(
            pl.len().alias("runs"),
            pl.col("finished").mean(),
            pl.col("steps", "t90", "t99").mean(),
            (pl.col("steps") / pl.col("offline")).mean().alias("multiple"),
            pl.col("coverage").min().alias("min_coverage"),
            paths.sum().mean().alias("path_m"),
            (paths.max() / paths.mean()).mean().alias("max_path"),
            (paths.min() / paths.mean()).mean().alias("min_path"),
            pl.col("replan_ms").mean(),
        )
        .sort("finished", "multiple", "strategy", descending=[True, False, False])
    )


DIGITS = {"finished": 2, "multiple": 2, "min_coverage": 4, "max_path": 2, "min_path": 2, "replan_ms": 2}
"""Decimals of the table's columns; none for the others."""


def lines(league: pl.DataFrame) -> list[list[str]]:
    """The table as text, header first."""

    def text(name: str, value: object) -> str:
        if isinstance(value, float):
            return f"{value:.{DIGITS.get(name, 0)}f}"
        return "" if value is None else str(value)

    rows = [[text(name, value) for name, value in row.items()] for row in league.iter_rows(named=True)]
    return [league.columns, *rows]


def draw(league: pl.DataFrame, file: Path) -> None:
    """Draw the table as bars: steps to 90 %, to 99 % and to the end, as multiples of the offline plan's."""
    from matplotlib.figure import Figure  # noqa: PLC0415  slow to import

    rows = league.filter(pl.col("finished") > 0, pl.col("strategy") != OFFLINE).reverse()
    per_step = rows["multiple"] / rows["steps"]
    figure = Figure((8, 1 + 0.32 * len(rows)), layout="constrained")
    axes = figure.subplots()
    for name, column, shade in (
        ("to the end", "steps", "#c9d7e8"),
        ("to 99 %", "t99", "#7fa3cc"),
        ("to 90 %", "t90", "#2f5f95"),
    ):
        axes.barh(rows["strategy"], (rows[column] * per_step).fill_null(0.0), color=shade, label=name)
    axes.axvline(1.0, color="#444444", linewidth=1)
    axes.set_xlabel("steps, as a multiple of the plan that knows the map")
    figure.legend(frameon=False, loc="outside upper right", ncols=3)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(file, dpi=130)
