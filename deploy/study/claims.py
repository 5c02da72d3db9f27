"""First looks at what the papers of the strategies claim: few seeds, small environments, one table.

``python -m deploy.study.claims [CLAIM ...] [--seeds 5] [--jobs 2] [--out FILE.jsonl]`` prints it (docs/strategies.md).
Each claim is a set of scenarios, run on the memory bus without a limit of bandwidth, and a comparison of their
means. With five seeds a difference is a hint, not a proof: the interval beside each mean is of 95 %
(Student's t). Each outcome is a line of FILE.jsonl as soon as it is known; what stands there is not run again.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy import stats

from deploy.run import in_memory
from deploy.scenario import plan
from deploy.scenario.scenario import parse
from deploy.study.run_pool import collect
from worldsim import generators

UNLIMITED: dict[str, Any] = {"bandwidth": "unlimited", "exchange": "laser", "bus": "memory"}

LEAST_COVERAGE = 0.99


@dataclass(frozen=True)
class Claim:
    """A claim to look at.

    Attributes
    ----------
    name : str
        As in the papers' list.
    says : str
        In one line.
    scenario : dict
        What all runs share.
    variants : dict of label to settings
        What is compared.
    environments : tuple of (name, parameters)
        Generated maps (`worldsim.generators`).
    robots : tuple of int
    """

    name: str
    says: str
    scenario: dict[str, Any]
    variants: dict[str, dict[str, Any]]
    environments: tuple[tuple[str, dict[str, float]], ...]
    robots: tuple[int, ...]


_ROTATING = {
    label: {"strategy": label}
    for label in ("continuous-replan", "scan-replan", "stop-scan-replan", "classical")
}
_COARSE = {"resolution": 0.25}
_CELL_A_STEP = {"sensor_range": 5.0, "speed": 0.25}

CLAIMS = (
    Claim(
        "B1",
        "coordinated beats uncoordinated, for 2 robots and more (Burgard et al., Fig. 9)",
        {"sensor_range": 5.0, "speed": 0.5},
        {label: {"strategy": label} for label in ("burgard", "burgard-optimal", "nearest")},
        (("burgard-office", {}), ("burgard-corridor", {}), ("burgard-unstructured", {})),
        (2, 4),
    ),
    Claim(
        "L1",
        "without leaders the team stalls where with leaders it finishes (leader paper, Fig. 3)",
        {"sensor_range": 2.5, "speed": 1.0},
        {label: {"strategy": label} for label in ("leaders", "potential-field")},
        (("leader-trap", {}),),
        (3,),
    ),
    Claim(
        "L2",
        "where both finish, leaders are faster (leader paper, Figs. 4 and 5)",
        {"sensor_range": 1.5, "speed": 1.0},
        {label: {"strategy": label} for label in ("leaders", "potential-field")},
        (("leader-rooms", {}),),
        (4,),
    ),
    Claim(
        "F1",
        "replanning at once beats replanning at the goal (Faigl and Vanek, Figs. 7 and 8)",
        {"sensor_range": 5.0, "speed": 0.3},
        {
            f"{label} {short}": {"strategy": label, "options": {"replan": replan}}
            for label in ("greedy", "hungarian")
            for short, replan in (("IR", "at-once"), ("GR", "at-goal"))
        },
        (("jh-like", {"resolution": 0.15}), ("potholes", {"resolution": 0.2})),
        (3, 5),
    ),
    Claim(
        "A1",
        "continuous <= scan-replan <= stop-scan-replan < classical (Al-khawaldah, Figs. 3 and 4)",
        _CELL_A_STEP,
        {
            f"{label} {turn}": {**settings, "scanner_turn": turn}
            for turn in (72, 18)
            for label, settings in _ROTATING.items()
        },
        (("office-plain", _COARSE), ("office-obstacles", _COARSE)),
        (1, 2, 3, 4, 5),
    ),
    Claim(
        "A2",
        "more robots, less time, and less and less gain (Al-khawaldah, Fig. 6)",
        _CELL_A_STEP | {"scanner_turn": 72},
        {label: {"strategy": label} for label in ("continuous-replan", "stop-scan-replan")},
        (("office-plain", _COARSE), ("hilbert-2", _COARSE)),
        (1, 2, 3, 4, 5, 6, 8),
    ),
    Claim(
        "A3",
        "the more winding the walls, the more robots still help (Al-khawaldah, Fig. 11)",
        _CELL_A_STEP | {"scanner_turn": 72},
        {"stop-scan-replan": {"strategy": "stop-scan-replan"}},
        (("hilbert-walls-1", _COARSE), ("hilbert-walls-2", _COARSE), ("hilbert-walls-3", _COARSE)),
        (1, 2, 3, 4, 5, 6, 7, 8),
    ),
)


@dataclass(frozen=True)
class Case:
    """One run of a claim to be made."""

    claim: Claim
    environment: str
    parameters: dict[str, float]
    robots: int
    variant: str
    seed: int

    @property
    def key(self) -> tuple[str, str, int, str, int]:
        """As that of its outcome."""
        return self.claim.name, self.environment, self.robots, self.variant, self.seed


@dataclass(frozen=True)
class Run:
    """One run of a claim, and its outcome."""

    claim: str
    environment: str
    robots: int
    variant: str
    seed: int
    steps: int
    finished: bool

    @property
    def key(self) -> tuple[str, str, int, str, int]:
        """Which run it was."""
        return self.claim, self.environment, self.robots, self.variant, self.seed


def runs_of(claim: Claim, seeds: int) -> list[Case]:
    """All runs of a claim."""
    return [
        Case(claim, environment, parameters, robots, variant, seed)
        for environment, parameters in claim.environments
        for robots in claim.robots
        for variant in claim.variants
        for seed in range(seeds)
    ]


def run(case: Case) -> Run:
    """Run one scenario in this process."""
    claim, seed = case.claim, case.seed
    world_map = generators.make(case.environment, seed=seed, **case.parameters)
    settings = UNLIMITED | claim.scenario | claim.variants[case.variant]
    scenario = parse(
        settings | {"map": case.environment, "map_seed": seed, "robots": case.robots, "seed": seed}
    )
    records = in_memory.run(plan.make(scenario, world_map))
    end = records.end
    finished = end is not None and end.first >= 0 and records.explored >= LEAST_COVERAGE
    return Run(claim.name, case.environment, case.robots, case.variant, seed, records.step, finished)


def table(claim: Claim, runs: Iterable[Run]) -> Table:
    """Mean steps of the runs that finished, with intervals, and how many did."""
    shown = Table(title=f"{claim.name}: {claim.says}", title_justify="left")
    for column in ("environment", "robots", *claim.variants):
        shown.add_column(column)
    done = list(runs)
    for environment, _ in claim.environments:
        for robots in claim.robots:
            cells = []
            for variant in claim.variants:
                these = [
                    run for run in done if (run.environment, run.robots, run.variant) == (environment, robots, variant)
                ]  # fmt: skip
                cells.append(_mean([run.steps for run in these if run.finished], len(these)))
            shown.add_row(environment, str(robots), *cells)
    return shown


def _mean(steps: list[int], runs: int) -> str:
    """Mean and half its 95 % interval; how many finished, where not all did."""
    share = "" if len(steps) == runs else f" ({len(steps)} of {runs})"
    if not steps:
        return f"none{share}"
    if len(steps) == 1:
        return f"{steps[0]}{share}"
    half = stats.t.ppf(0.975, len(steps) - 1) * np.std(steps, ddof=1) / math.sqrt(len(steps))
    return f"{np.mean(steps):.0f} ± {half:.0f}{share}"


def main() -> None:
    """Run the claims named on the command line, or all, and print a table of each."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    known = {claim.name: claim for claim in CLAIMS}
    parser.add_argument("claims", nargs="*", metavar="CLAIM", help=f"of {', '.join(known)}; default: all")
    parser.add_argument("--seeds", type=int, default=5, help="runs a point")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--out", type=Path, metavar="FILE.jsonl", help="an outcome a line; known ones stay")
    asked = parser.parse_args()
    unknown = [name for name in asked.claims if name not in known]
    if unknown:
        parser.error(f"no claim is called {unknown[0]}; there are {', '.join(known)}")
    screen = Console(width=140)
    for claim in (known[name] for name in asked.claims or known):
        todo = runs_of(claim, asked.seeds)
        results = collect(todo, run, Run, asked.jobs, asked.out)
        progress = Console(stderr=True)
        try:
            screen.print(table(claim, track(results, claim.name, len(todo), console=progress)))
        except ValueError as error:
            parser.error(str(error))


if __name__ == "__main__":
    main()
