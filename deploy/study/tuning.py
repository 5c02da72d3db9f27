"""Search for the weights of a strategy on training seeds: `murmur tune`.

The search is a coordinate search with multiplicative steps. It starts with the default weights. In each round, it
visits all weights in random order. It multiplies and divides each by the step, first `STEP`, and keeps the better of
the two values if it lowers the score. After a round without improvement, the step becomes its square root.

The score of weights is the mean over all runs of their steps divided by those of the default weights for the same map
and seed. It decides which weights are kept, so it is optimistic for the winner. Therefore the winner runs again on
check seeds, which the search did not use.

Each run is an entry of a table of runs (`deploy.study.results`). Draws depend on the search's seed only; so a search
that was interrupted finds its runs in the table, and continues.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import fmean
from typing import Any, NamedTuple

import polars as pl
import tomli_w

from agent.strategies.options import option_lines
from agent.strategies.registry import strategy
from deploy.run.failure import RunFailed
from deploy.run.workers import Workers
from deploy.study.experiment import Experiment
from deploy.study.progress import Report
from deploy.study.results import PLACE, Results
from deploy.study.runs import MOST_STEPS, StudyRuns, cases, make
from deploy.study.statistics import Interval, interval
from deploy.study.sweep import as_text
from deploy.study.tables import VARIANT, Table, has_finished
from protocol.keyed_random import keyed_random
from worldsim.generators.seeds import check_training_seeds

MAPS = ("office", "mixed", "caves", "warehouse", "maze", "wings", "office-campus")
"""Maps on which weights are searched by default: one per kind of building."""

DEFAULTS = {"robots": 8, "bandwidth": 50, "steps": 2000}
"""Settings of all runs, unless the user overrides them."""

STEP = 2.0
"""First factor between a weight and the values that are tried for it."""

LEAST_STEP = 1.1
"""The search ends when the factor is below this one."""

Weights = dict[str, float]
Run = tuple[str, int]
"""Map and seed."""


@dataclass(frozen=True)
class Search:
    """What to search."""

    strategy: str
    maps: Sequence[str] = MAPS
    """Generators or map files. Generators draw the map of each run with its seed."""
    seeds: Sequence[int] = (0, 1, 2)
    check_seeds: Sequence[int] = (3, 4, 5)
    """Seeds on which the result is compared with the default weights."""
    evaluations: int = 20
    """Maximum number of weights that are tried, the default weights included."""
    only: Sequence[str] = ()
    """Weights to search; all numeric options of the strategy that are not 0 if empty."""
    search_seed: int = 0
    """Seed of the search's order."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Scenario settings of all runs, on top of `DEFAULTS`."""

    def __post_init__(self) -> None:
        for name, values in (("maps", self.maps), ("seeds", self.seeds)):
            if not values:
                raise ValueError(f"{name} = {values!r}: is an empty list; give at least one value")
        check_training_seeds([*self.seeds, *self.check_seeds])
        if both := sorted({*self.seeds} & {*self.check_seeds}):
            raise ValueError(f"check_seeds: {both[0]} is a seed of the search as well; choose other seeds")
        for name, value in self.settings.items():
            if name.partition(".")[0] in ("seed", "map_seed", "map", "strategy", "options"):
                raise ValueError(f"{name} = {value!r}: is chosen by the search; remove it")
        weights = default_weights(self.strategy)
        for name in self.only:
            if name not in weights:
                known = ", ".join(weights) or "none"
                raise ValueError(f"{self.strategy} has no weight {name!r}; there are: {known}")
        if not weights:
            raise ValueError(f"{self.strategy} has no numeric options to search")

    def experiment(self, candidates: Sequence[Weights], seeds: Sequence[int]) -> Experiment:
        """Return the runs of some weights on all maps and `seeds`; the variants are numbers of the candidates."""
        base = {**DEFAULTS, **self.settings, "strategy": self.strategy}
        grid: dict[str, list[Any]] = {"map": list(self.maps), "seed": list(seeds)}
        variants = {str(at): {"options": weights} for at, weights in enumerate(candidates)}
        return Experiment("tune", "tune", base, grid, {"map_seed": "seed"}, variants, Table(["map"], []))

    def check(self) -> None:
        """Raise ScenarioError if a map or a setting is invalid."""
        cases(self.experiment([default_weights(self.strategy)], self.seeds))


class Trial(NamedTuple):
    """Weights that were tried."""

    number: int
    """Position in the search; 0 for the default weights."""
    weights: Weights
    ratios: dict[Run, float]
    """Steps over those of the default weights, by map and seed."""

    @property
    def score(self) -> float:
        """Mean of the ratios; all maps have the same number of seeds, and so the same weight."""
        return fmean(self.ratios.values())

    @property
    def spread(self) -> Interval:
        """The score with its 95 % interval."""
        return interval(list(self.ratios.values()))


@dataclass(frozen=True)
class Tuning:
    """Result of a search."""

    search: Search
    trials: list[Trial]
    """All trials in their order; the first has the default weights."""
    best: Trial
    """The trial with the least score."""
    check: Trial | None
    """The best weights on the check seeds; None if the default weights are the best, or there are no check seeds."""

    @property
    def table(self) -> pl.DataFrame:
        """A row per trial: number, score with bounds, score by map, and weights."""
        rows = []
        for trial in self.trials:
            spread = trial.spread
            row = {"trial": trial.number, "score": trial.score, "low": spread.low, "high": spread.high}
            for name in self.search.maps:
                row[f"score {name}"] = fmean(ratio for run, ratio in trial.ratios.items() if run[0] == name)
            rows.append(row | trial.weights)
        return pl.DataFrame(rows)

    @property
    def lines(self) -> list[list[str]]:
        """The table as text, header first."""
        rows = ([f"{value:.4g}" for value in row] for row in self.table.drop("low", "high").iter_rows())
        return [self.table.drop("low", "high").columns, *rows]

    @property
    def sentence(self) -> str:
        """The result on the check seeds as a sentence."""
        if not self.best.number:
            return f"No weights were better than the defaults in {len(self.trials)} trials."
        found = f"Trial {self.best.number} takes {self.best.score:.3f} of the default weights' steps in the search"
        if self.check is None:
            return f"{found}; there were no check seeds."
        spread, seeds = self.check.spread, ", ".join(map(str, self.search.check_seeds))
        return f"{found}, and {spread.mean:.3f} ± {spread.half:.3f} on the check seeds {seeds}."

    @property
    def record(self) -> str:
        """The best weights and how they were found, as TOML."""
        record = {
            "strategy": self.search.strategy,
            "method": f"murmur tune, trial {self.best.number} of {len(self.trials)}",
            "maps": list(self.search.maps),
            "seeds": [*self.search.seeds, *self.search.check_seeds],
            "score": round(self.best.score, 4),
            "weights": self.best.weights,
        }
        return tomli_w.dumps(record)


def default_weights(name: str) -> Weights:
    """Return the numeric options of a strategy with their defaults, without those that are 0; ValueError if unknown."""
    lines = option_lines(strategy(name).options_type)
    return {line.name: line.default for line in lines if isinstance(line.default, float) and line.default > 0}


def tune(search: Search, results: Results, workers: Workers, report: Report | None = None) -> Tuning:
    """Run a search, or continue the one in `results`.

    `report` is called with the number of finished evaluations, and their maximum. Raises RunFailed if a run failed,
    ScenarioError if a setting is invalid.
    """
    return _Tuner(search, results, workers, report or (lambda *_: None)).run()


class _Tuner:
    """A search in progress."""

    def __init__(self, search: Search, results: Results, workers: Workers, report: Report) -> None:
        self._search, self._results, self._workers, self._report = search, results, workers, report
        self._defaults = default_weights(search.strategy)
        self._trials: list[Trial] = []

    def run(self) -> Tuning:
        """Search until the evaluations are used up, or the step is small."""
        search = self._search
        (baseline,) = self._steps([self._defaults], search.seeds)
        best = self._keep(self._defaults, baseline, baseline)
        step, rounds = STEP, 0
        while step >= LEAST_STEP and len(self._trials) < search.evaluations:
            before = best
            for name in self._order(rounds):
                candidates = self._candidates(best.weights, name, step)
                steps = self._steps(candidates, search.seeds)
                trials = [self._keep(*each, baseline) for each in zip(candidates, steps, strict=True)]
                best = min((best, *trials), key=lambda trial: trial.score)
            if best is before:
                step = math.sqrt(step)
            rounds += 1
        return Tuning(search, self._trials, best, self._check(best))

    def _order(self, number: int) -> list[str]:
        """Return the weights in the order in which round `number` visits them."""
        names = [name for name in self._defaults if name in (self._search.only or self._defaults)]
        random = keyed_random(self._search.search_seed, "tune", number)
        return [names[at] for at in random.permutation(len(names)).tolist()]

    def _candidates(self, weights: Weights, name: str, step: float) -> list[Weights]:
        """Return weights with a larger and a smaller value of one, without those that were tried before."""
        tried = [trial.weights for trial in self._trials]
        new = [weights | {name: float(f"{weights[name] * factor:.4g}")} for factor in (step, 1 / step)]
        left = self._search.evaluations - len(self._trials)
        return [each for each in new if each not in tried][:left]

    def _keep(self, weights: Weights, steps: Mapping[Run, int], baseline: Mapping[Run, int]) -> Trial:
        trial = Trial(len(self._trials), weights, _ratios(steps, baseline))
        self._trials.append(trial)
        self._report(len(self._trials), self._search.evaluations)
        return trial

    def _check(self, best: Trial) -> Trial | None:
        """Run the best weights and the default ones on the check seeds."""
        if not best.number or not self._search.check_seeds:
            return None
        baseline, steps = self._steps([self._defaults, best.weights], self._search.check_seeds)
        return best._replace(ratios=_ratios(steps, baseline))

    def _steps(self, candidates: Sequence[Weights], seeds: Sequence[int]) -> list[dict[Run, int]]:
        """Run weights on all maps and some seeds; return the steps of each, by map and seed.

        A run that did not finish counts with the maximum number of steps.
        """
        experiment = self._search.experiment(candidates, seeds)
        runs = StudyRuns(cases(experiment) if candidates else [], self._results)
        make(runs.cases, self._results, self._workers)
        if runs.failures:
            raise RunFailed(f"runs failed: {as_text(runs.failures)}")
        steps: dict[str, dict[Run, int]] = {name: {} for name in experiment.variants}
        for row in runs.rows:
            place = row[PLACE]
            run = place["map"], place["seed"]
            steps[place[VARIANT]][run] = row["steps"] if has_finished(row) else row[MOST_STEPS]
        return list(steps.values())


def _ratios(steps: Mapping[Run, int], baseline: Mapping[Run, int]) -> dict[Run, float]:
    """Steps over those of the baseline, by map and seed."""
    return {run: value / baseline[run] for run, value in steps.items()}
