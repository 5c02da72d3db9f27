"""Whether every strategy finishes: in its own paper's environments, alone and in teams, and on maps of files.

``python -m deploy.study.finish [STRATEGY ...] [--seeds 5] [--jobs 1] [--map FILE.yaml] [--out FILE.jsonl]`` prints a
row a strategy and environment: how many runs explored all there is, their mean steps, the least coverage.
Only the potential field may stall, which its run has to say. Runs are on the memory bus without a limit of
bandwidth. Each outcome is a line of FILE.jsonl as soon as it is known; what stands there is not run again.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track
from rich.table import Table

from agent.strategies.registry import strategies
from deploy.run import in_memory
from deploy.scenario import plan
from deploy.scenario.scenario import parse
from deploy.study.claims import LEAST_COVERAGE, UNLIMITED
from deploy.study.run_pool import collect
from worldsim import generators
from worldsim.process import EXPLORED, STALLED

ROBOTS = (1, 3, 5)

MAY_STALL = ("potential-field",)

TEAM_ON_A_MAP = 3
"""Robots on the map of a file, with one seed."""


@dataclass(frozen=True)
class Paper:
    """What a paper explores, and with which strategies.

    Attributes
    ----------
    strategies : tuple of str
    body : dict
        Settings of a scenario: what robots are like.
    environments : dict of generator to parameters
        Cheap ones first.
    """

    strategies: tuple[str, ...]
    body: dict[str, Any]
    environments: dict[str, dict[str, float]]


_COARSE = {"resolution": 0.25}

PAPERS = (
    Paper(
        ("leaders", "potential-field"),
        {"sensor_range": 2.5, "speed": 1.0},
        {"leader-trap": {}, "leader-rooms": {}},
    ),
    Paper(
        ("meier", "repairmen"),
        {"sensor_range": 5.0, "speed": 0.5},
        {"unstructured": {}, "mixed": {}, "office": {}},
    ),
    Paper(
        ("burgard", "burgard-optimal", "nearest"),
        {"sensor_range": 5.0, "speed": 0.45},
        {"burgard-office": {}, "burgard-corridor": {}, "burgard-unstructured": {}},
    ),
    Paper(
        ("stop-scan-replan", "scan-replan", "continuous-replan", "classical", "sheng-bid"),
        {"sensor_range": 5.0, "speed": 0.25, "scanner_turn": 72},
        {
            "office-plain": _COARSE, "office-obstacles": _COARSE, "hilbert-1": _COARSE, "hilbert-2": _COARSE,
            "hilbert-3": _COARSE, "hilbert-walls-3": _COARSE, "hilbert-walls-4": _COARSE,
        },
    ),
    # One cell a step is the paper's, and a disc of 0.15 m; cells of 0.05 m would take twenty times as long.
    Paper(
        ("greedy", "iterative", "hungarian", "mtsp", "hungarian-depot", "mtsp-depot"),
        {"sensor_range": 5.0, "radius": 0.15, "speed": 0.15},
        {"em": {"resolution": 0.15}, "jh-like": {"resolution": 0.15}, "autolab-like": {"resolution": 0.15}},
    ),
    Paper(
        ("stop-scan-replan", "scan-replan", "continuous-replan", "classical", "sheng-bid"),
        {"sensor_range": 10.0, "speed": 0.4, "scanner_turn": 72},
        {"campus": {"resolution": 0.4}},
    ),
    Paper(
        ("greedy", "iterative", "hungarian", "mtsp", "hungarian-depot", "mtsp-depot"),
        {"sensor_range": 5.0, "radius": 0.15, "speed": 0.25},
        {"potholes": _COARSE},
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One run to be made."""

    strategy: str
    environment: str
    robots: int
    seed: int
    parameters: dict[str, float] = field(compare=False)
    body: dict[str, Any] = field(compare=False)

    @property
    def key(self) -> tuple[str, str, int, int]:
        """As that of its outcome."""
        return self.strategy, self.environment, self.robots, self.seed


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    strategy: str
    environment: str
    robots: int
    seed: int
    steps: int
    coverage: float
    reason: str

    @property
    def key(self) -> tuple[str, str, int, int]:
        """Which run it was."""
        return self.strategy, self.environment, self.robots, self.seed

    @property
    def finished(self) -> bool:
        """Whether it ended as explored, and had seen what there is."""
        return self.reason == EXPLORED and self.coverage >= LEAST_COVERAGE

    @property
    def holds(self) -> bool:
        """Whether it finished, or stalled, says so, and may."""
        return self.finished or (self.reason == STALLED and self.strategy in MAY_STALL)


def cases(chosen: Iterable[str], seeds: int, maps: Iterable[str] = ()) -> list[Case]:
    """All runs of the chosen strategies: seed by seed, paper by paper; those on maps of files come last."""
    chosen, maps = list(chosen), list(maps)
    found: dict[Case, None] = {}
    for seed in range(seeds):
        for paper in PAPERS:
            for environment, parameters in paper.environments.items():
                for name in (name for name in paper.strategies if name in chosen):
                    for robots in ROBOTS:
                        found[Case(name, environment, robots, seed, parameters, paper.body)] = None
    for file in maps:
        for paper in PAPERS:
            body = paper.body | {"sensor_range": 5.0, "speed": 0.5}
            for name in (name for name in paper.strategies if name in chosen):
                found.setdefault(Case(name, file, TEAM_ON_A_MAP, 0, {}, body))
    return list(found)


def run(case: Case) -> Outcome:
    """Run one case in this process."""
    scenario = parse(
        UNLIMITED
        | case.body
        | {"map": case.environment, "map_seed": case.seed, "seed": case.seed}
        | {"robots": case.robots, "strategy": case.strategy}
    )
    is_file = case.environment not in generators.names()
    world_map = None if is_file else generators.make(case.environment, seed=case.seed, **case.parameters)
    records = in_memory.run(plan.make(scenario, world_map))
    assert records.end is not None
    return Outcome(
        case.strategy, case.environment, case.robots, case.seed,
        records.step, round(records.explored, 5), records.end.reason,
    )  # fmt: skip


def table(outcomes: Iterable[Outcome]) -> Table:
    """A row a strategy and environment."""
    shown = Table(title="finish: every strategy sees all there is", title_justify="left")
    for column in ("strategy", "environment", "finished", *(f"steps, {n} robots" for n in ROBOTS)):
        shown.add_column(column)
    shown.add_column("least coverage")
    rows: dict[tuple[str, str], list[Outcome]] = {}
    for outcome in outcomes:
        rows.setdefault((outcome.strategy, Path(outcome.environment).stem), []).append(outcome)
    order = [(name, environment) for paper in PAPERS for name in paper.strategies for environment in
             dict.fromkeys(place for who, place in rows if who == name)]  # fmt: skip
    for name, environment in dict.fromkeys(order):
        these = rows[name, environment]
        done = [outcome for outcome in these if outcome.finished]
        means = (_mean([outcome.steps for outcome in done if outcome.robots == robots]) for robots in ROBOTS)
        stalled = sum(outcome.reason == STALLED for outcome in these)
        count = f"{len(done)} of {len(these)}" + (f", {stalled} stalled" if stalled else "")
        least = min(outcome.coverage for outcome in these)
        shown.add_row(name, environment, count, *means, f"{least:.4f}")
    return shown


def _mean(steps: list[int]) -> str:
    return f"{sum(steps) / len(steps):.0f}" if steps else ""


def main() -> int:
    """Run the strategies named on the command line, or all; exit code 1 if one does not finish."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    known = list(dict.fromkeys(name for paper in PAPERS for name in paper.strategies))
    assert set(known) <= set(strategies())
    parser.add_argument("strategies", nargs="*", metavar="STRATEGY", help="murmur strategies; default: all")
    parser.add_argument("--seeds", type=int, default=5, help="runs a point")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--map", action="append", default=[], metavar="FILE.yaml", help="a map; repeatable")
    parser.add_argument("--out", type=Path, metavar="FILE.jsonl", help="an outcome a line; known ones stay")
    asked = parser.parse_args()
    unknown = [name for name in asked.strategies if name not in known]
    if unknown:
        parser.error(f"no paper's strategy is called {unknown[0]}; there are {', '.join(known)}")
    todo = cases(asked.strategies or known, asked.seeds, asked.map)
    results = collect(todo, run, Outcome, asked.jobs, asked.out)
    try:
        outcomes = list(track(results, "finish", len(todo), console=Console(stderr=True)))
    except ValueError as error:
        parser.error(str(error))
    screen = Console(width=140)
    screen.print(table(outcomes))
    failed = [outcome for outcome in outcomes if not outcome.holds]
    for outcome in failed:
        screen.print(f"does not finish: {outcome}", highlight=False)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
