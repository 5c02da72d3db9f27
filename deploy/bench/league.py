"""The league table: every strategy on the same buildings, from the same starts, against what is possible at all.

The yardstick is the plan of a team that knows the building (`deploy.bench.offline_bound`): a strategy's steps are given as
a multiple of that plan's. Robots share raw scans over an unlimited radio unless told otherwise, so that what
differs is where they go.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from agent.strategies.registry import strategies, strategy
from deploy.bench.offline_bound import OfflineBound, fewest_steps, offline_steps
from deploy.bench.replanning import Watch
from deploy.run.exploration import explore
from deploy.run.workers import workers
from deploy.scenario import plan as plans
from deploy.scenario.scenario import Scenario, parse

BOUND, KNOWN = "(lower bound)", "(map known)"
"""Contestants that are no strategies."""

COMMON = {
    "bus": "memory",
    "map_encoding": "scans",
    "bandwidth": "unlimited",
    "sensor_range": 5.0,
    "speed": 0.5,
}
"""What all scenarios of a contest are, unless it says otherwise."""

Run = dict[str, Any]
"""One run: strategy, map, robots, seed, steps; of a strategy also finished, t90, t99, coverage, driven (metres of each
robot) and replan_ms, the mean processor time of a decision in which a robot chooses a target."""


@dataclass(frozen=True)
class Task:
    """A strategy in a scenario; or `KNOWN`, what is possible in all scenarios of a map."""

    name: str
    scenarios: tuple[Scenario, ...]

    @property
    def key(self) -> str:
        """Its name, which no other has."""
        first = self.scenarios[0]
        return f"{self.name} on {first.map}, {first.robots} robots, seed {first.seed}"


@dataclass(frozen=True)
class Contest:
    """What is run.

    Attributes
    ----------
    maps : sequence of str
        Names of shipped maps, or files.
    robots : sequence of int
        Sizes of teams.
    seeds : int
        Seeds 0 to this less 1 of each.
    strategies : sequence of str
        All if empty.
    settings : dict
        Keys of a scenario for all runs, on top of `COMMON`.
    """

    maps: Sequence[str] = ("office",)
    robots: Sequence[int] = (6,)
    seeds: int = 3
    strategies: Sequence[str] = ()
    settings: dict[str, Any] = field(default_factory=dict)

    def names(self) -> list[str]:
        """Who competes; ValueError if there is no strategy of such a name."""
        return [strategy(name).name for name in self.strategies] or sorted(strategies())

    def tasks(self) -> list[Task]:
        """The pieces of work: what is possible on each map, and each strategy in each scenario."""
        scenarios = self.scenarios()
        known = [
            Task(KNOWN, tuple(each for each in scenarios if each.map == where))
            for where in dict.fromkeys(self.maps)
        ]
        return known + [Task(name, (scenario,)) for scenario in scenarios for name in self.names()]

    def scenarios(self) -> list[Scenario]:
        """One a map, team and seed, seeds and teams of one map on end; ScenarioError if one makes no sense."""
        return [
            parse({**COMMON, **self.settings, "map": where, "robots": robots, "seed": seed})
            for where, robots, seed in product(self.maps, self.robots, range(self.seeds))
        ]


def compete(tasks: Sequence[Task], jobs: int | None = None) -> Iterator[list[Run]]:
    """Yield the runs of each piece of work as it ends, by `jobs` processes; ConnectionError if one of them dies."""
    for task, found in workers(jobs, None).each(tasks, _do):
        if isinstance(found, str):
            raise ConnectionError(f"{task.key}: {found}")
        yield found


def _do(task: Task) -> list[Run]:
    return _with_the_map_known(task.scenarios) if task.name == KNOWN else _with(task.name, *task.scenarios)


def _with(name: str, scenario: Scenario) -> list[Run]:
    watch = Watch()
    with watch.over(strategy(name)):
        summary = explore(scenario, keep=False, strategy=name).summary
    kept = {key: summary[key] for key in ("finished", "steps", "t90", "t99", "coverage")}
    mean = float(np.mean(watch.spent)) if watch.spent else None
    return [_run(name, scenario, **kept, driven=summary["path_length"], replan_ms=mean)]


def _with_the_map_known(scenarios: Sequence[Scenario]) -> list[Run]:
    """The offline plan, and the bound, of each team on one map."""
    building: OfflineBound | None = None
    found = []
    for scenario in scenarios:
        settings = plans.make(scenario).world
        truth, body, starts = plans.make(scenario).map.cells, settings.bodies[0], settings.starts
        if building is None or not building.is_reached_from(starts[0]):
            building = OfflineBound(
                truth, starts[0], body.range_cells, body.speed, settings.beams, body.radius_cells
            )
        found.append(_run(KNOWN, scenario, steps=offline_steps(building, starts)))
        found.append(_run(BOUND, scenario, steps=fewest_steps(building, starts)))
    return found


def _run(name: str, scenario: Scenario, **figures: Any) -> Run:
    return {
        "strategy": name,
        "map": scenario.map,
        "robots": scenario.robots,
        "seed": scenario.seed,
        **figures,
    }


def table(runs: Sequence[Run]) -> pl.DataFrame:
    """The league table: a row a strategy, means over its runs, the fastest on top.

    Columns: strategy, runs, finished (their share), of those that finished steps, t90, t99, multiple (steps over those
    of the offline plan for the same map, team and start), coverage (the least), path_m (metres of the whole team), most
    and least (the way of the robot that drives most and least, over the team's mean), replan_ms.
    """
    frame = pl.DataFrame(list(runs), infer_schema_length=None)
    case = ["map", "robots", "seed"]
    known = frame.filter(pl.col("strategy") == KNOWN).select(*case, pl.col("steps").alias("possible"))
    way = pl.col("driven").list
    ended = pl.col("finished").fill_null(value=True)
    return (
        frame.join(known, on=case)
        .with_columns(ended, pl.when(ended).then(pl.col("steps", "t90", "t99")))
        .group_by("strategy")
        .agg(
            pl.len().alias("runs"),
            pl.col("finished").mean(),
            pl.col("steps", "t90", "t99").mean(),
            (pl.col("steps") / pl.col("possible")).mean().alias("multiple"),
            pl.col("coverage").min(),
            way.sum().mean().alias("path_m"),
            (way.max() / way.mean()).mean().alias("most"),
            (way.min() / way.mean()).mean().alias("least"),
            pl.col("replan_ms").mean(),
        )
        .sort("finished", "multiple", "strategy", descending=[True, False, False])
    )


def lines(league: pl.DataFrame) -> list[list[str]]:
    """The table as text, its header first."""
    digits = {"finished": 2, "multiple": 2, "coverage": 4, "most": 2, "least": 2, "replan_ms": 2}
    rows = [
        [
            ""
            if value is None
            else f"{value:.{digits.get(name, 0)}f}"
            if isinstance(value, float)
            else str(value)
            for name, value in row.items()
        ]
        for row in league.iter_rows(named=True)
    ]
    return [league.columns, *rows]


def draw(league: pl.DataFrame, file: Path) -> None:
    """Draw the table as bars: steps to 90 %, to 99 % and to the end, as multiples of the offline plan's."""
    from matplotlib.figure import Figure  # noqa: PLC0415  slow to import

    rows = league.filter(pl.col("finished") > 0, ~pl.col("strategy").is_in([BOUND, KNOWN])).reverse()
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
    axes.set_xlabel("steps, as a multiple of what a team needs that knows the map")
    figure.legend(frameon=False, loc="outside upper right", ncols=3)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(file, dpi=130)
