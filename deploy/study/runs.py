"""The runs of an experiment: one case each, run in a pool of processes on the memory bus, and its outcome.

Invalid input is refused before the first run.
"""

from __future__ import annotations

import hashlib
import inspect
import itertools
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from agent.strategies.registry import strategy
from deploy.record.versions import versions
from deploy.run import exploration
from deploy.scenario import plan
from deploy.scenario.scenario import Scenario, ScenarioError, parse
from deploy.study.experiment import Experiment, settings_of
from deploy.study.run_pool import collect
from deploy.study.tables import VARIANT
from worldsim.maps import Map

MEMORY = "memory"


@dataclass(frozen=True)
class Case:
    """One run of an experiment: its position in the grid, its scenario, and the `identity` of the run."""

    place: dict[str, Any]
    scenario: Scenario
    key: str


@dataclass(frozen=True)
class Outcome:
    """The outcome of a case."""

    key: str
    place: dict[str, Any]
    summary: dict[str, Any]


def cases(experiment: Experiment) -> list[Case]:
    """All runs of an experiment, in the order of its grid; ScenarioError if one is invalid."""
    worlds: dict[str, Map] = {}
    result = []
    for combination in itertools.product(*experiment.grid.values()):
        settings: dict[str, Any] = {}
        chosen: dict[str, Any] = {}
        for key, value in zip(experiment.grid, combination, strict=True):
            settings |= settings_of(key, value)
            chosen[key] = settings[key]
        for name, keys in experiment.variants.items():
            place = {**chosen, VARIANT: name}
            here = ", ".join(f"{key} = {value}" for key, value in place.items())
            where = f"{experiment.where} ({here})"
            data = {"bus": MEMORY, **experiment.base, **settings, **keys}
            data |= {key: data[leader] for key, leader in experiment.follow.items() if leader in data}
            if data["bus"] != MEMORY:
                raise ScenarioError(
                    f"{where}: bus = {data['bus']!r}: sweeps run on the memory bus; leave it out"
                )
            scenario = parse(data, where)
            source = repr((scenario.map, scenario.map_seed, scenario.map_options))
            try:
                if source not in worlds:
                    worlds[source] = plan.load_map(scenario)
                plan.make(scenario, worlds[source])
            except ScenarioError as error:
                raise ScenarioError(f"{where}: {error}") from None
            result.append(Case(place, scenario, identity(scenario, worlds[source])))
    return result


def run(todo: Sequence[Case], jobs: int, keep: Path | None = None) -> Iterator[Outcome]:
    """Run cases in `jobs` processes, equal ones once; outcomes in `keep` are reused (`collect`)."""
    return collect(list({case.key: case for case in todo}.values()), _run_one, Outcome, jobs, keep)


def summaries(todo: Sequence[Case], outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """The summaries of all cases whose outcome is known, with their positions, in the order of `todo`."""
    known = {outcome.key: outcome.summary for outcome in outcomes}
    return [{**known[case.key], "place": case.place} for case in todo if case.key in known]


def identity(scenario: Scenario, world_map: Map) -> str:
    """Sha256 over everything that determines a run: settings, cells of the map, versions, and our code."""
    about = (
        scenario.model_dump(mode="json"),
        (world_map.cells.shape, world_map.resolution, world_map.origin),
        versions(),
        _code(),
        inspect.getsource(sys.modules[strategy(scenario.strategy).__module__]),
    )
    total = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    total.update(world_map.cells.tobytes())
    return total.hexdigest()


@cache
def _code() -> str:
    """Sha256 of the sources."""
    total = hashlib.sha256()
    for package in ("agent", "deploy", "netshaper", "protocol", "worldsim"):
        for file in sorted((Path(__file__).parents[2] / package).rglob("*.py")):
            total.update(file.read_bytes())
    return total.hexdigest()


def _run_one(case: Case) -> Outcome:
    return Outcome(case.key, case.place, exploration.explore(case.scenario, keep=False).summary)
