"""The runs of an experiment: one case per run, executed by worker processes, and its row in the table of runs.

Invalid input is rejected before the first run.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from deploy.record.versions import versions
from deploy.run import memory
from deploy.run.workers import Workers
from deploy.scenario import plan as plans
from deploy.scenario import plugins
from deploy.scenario.errors import ScenarioError
from deploy.scenario.finding_maps import FILES
from deploy.scenario.scenario import Scenario, parse
from deploy.scenario.tables import MAX_RUNS
from deploy.scenario.thesis import thesis_settings
from deploy.scenario.toml_files import lay
from deploy.study.experiment import Experiment, settings_of
from deploy.study.measures import MEASURES
from deploy.study.progress import Report
from deploy.study.results import CODE, ERROR, KEY, PLACE, Results, Row
from deploy.study.tables import VARIANT
from worldsim.maps import Map

MEMORY = "memory"

MOST_STEPS = "most_steps"
"""Column of the setting `steps`; the column ``steps`` is the exploration time."""

SOURCES = (
    "agent", "netshaper", "protocol", "worldsim", "deploy/scenario", "deploy/record", "deploy/run",
    "deploy/study/measures.py", "deploy/study/recovery.py", "deploy/study/runs.py", "deploy/study/voronoi.py",
)  # fmt: skip
"""The sources that determine the metrics of a run."""


@dataclass(frozen=True)
class Case:
    """One run of an experiment."""

    place: dict[str, Any]
    """Its position in the grid, and its variant."""
    scenario: Scenario
    measure: str
    key: str
    """SHA-256 of scenario, measure and map, which identifies the run in the table."""
    code: str
    """SHA-256 of the sources and versions."""
    world: bytes = b""
    """Compressed `content` of the map, for processes without its file; empty for generated maps."""


def cases(experiment: Experiment) -> list[Case]:
    """All runs of an experiment, in the order of its grid; ScenarioError if one is invalid.

    Of runs that differ only in their seeds, the first is checked on its map; the others may fail as rows.
    """
    count = math.prod(map(len, (*experiment.grid.values(), experiment.variants)))
    if count > MAX_RUNS:
        raise ScenarioError(f"{experiment.where}: {count} runs: must be at most {MAX_RUNS}")
    files: dict[tuple[str, str], bytes] = {}
    drawn: dict[tuple[str, str, int], Map] = {}
    checked: set[str] = set()
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
            scenario = _scenario(experiment, (experiment.base, settings, keys), where)
            plugins.check_importable(scenario, "the processes of a sweep")
            building = scenario.map, repr(scenario.map_options)
            try:
                if is_file(scenario.map) and building not in files:
                    files[building] = content(plans.load_map(scenario))
                without_seeds = repr(scenario.model_copy(update={"seed": 0, "map_seed": 0}))
                if without_seeds not in checked:
                    memory.check(plans.make(scenario, _map_of(scenario, drawn)))
                    checked.add(without_seeds)
            except ScenarioError as error:
                raise ScenarioError(f"{where}: {error}") from None
            world, measure = files.get(building, b""), experiment.measure
            key = identity(scenario, measure, world)
            result.append(
                Case(place, scenario, measure, key, code_of(scenario), world and zlib.compress(world))
            )
    plugins.check_distinct(case.scenario for case in result)
    return result


def _map_of(scenario: Scenario, drawn: dict[tuple[str, str, int], Map]) -> Map | None:
    """Return the map of a scenario, which is added to those of earlier ones; None if the log of a run gives it."""
    if scenario.is_recorded:
        return None
    key = scenario.map, repr(scenario.map_options), scenario.map_seed
    if key not in drawn:
        drawn[key] = plans.load_map(scenario)
    return drawn[key]


def _scenario(experiment: Experiment, layers: Sequence[dict[str, Any]], where: str) -> Scenario:
    """The scenario of some layers of settings; ScenarioError if it is invalid."""
    data: dict[str, Any] = {"bus": MEMORY}
    for layer in layers:
        lay(data, layer, where)
    data |= {key: data[leader] for key, leader in experiment.follow.items() if leader in data}
    by_thesis = data.pop("thesis", False)
    if not isinstance(by_thesis, bool):
        raise ScenarioError(f"{where}: thesis = {by_thesis!r}: must be true or false")
    if by_thesis:
        lay(data, thesis_settings(data), where)
    if data["bus"] != MEMORY:
        raise ScenarioError(f"{where}: bus = {data['bus']!r}: sweeps run on the memory bus; leave it out")
    return parse(data, where)


def make(
    todo: Sequence[Case],
    results: Results,
    workers: Workers,
    report: Report | None = None,
    *,
    retry: bool = False,
) -> None:
    """Execute all runs that the table lacks, equal runs once; each run enters the table as soon as it ends.

    `report` is called with the number of finished runs, and the total. `retry` repeats failed runs.
    """
    distinct = {case.key: case for case in todo}
    missing = [case for key, case in distinct.items() if not results.knows(key, case.code, retry=retry)]
    done = len(distinct) - len(missing)
    report = report or (lambda *_: None)
    report(done, len(distinct))
    for case, row in workers.each(missing, run_case):
        results.add(row if isinstance(row, dict) else _failed(case, row))
        done += 1
        report(done, len(distinct))


@dataclass(frozen=True, eq=False, repr=False)
class StudyRuns:
    """The runs of a study, with the table that has them and their series."""

    cases: list[Case]
    results: Results

    @cached_property
    def rows(self) -> list[Row]:
        """The successful runs in the order of the cases, each with its `PLACE` in the study."""
        rows = self.results.rows({case.key for case in self.cases})
        return [
            {**rows[case.key], PLACE: case.place}
            for case in self.cases
            if case.key in rows and rows[case.key][ERROR] is None
        ]

    @cached_property
    def failures(self) -> dict[str, int]:
        """Error messages of failed runs, and their counts."""
        rows = self.results.rows({case.key for case in self.cases}).values()
        return dict(Counter(row[ERROR] for row in rows if row[ERROR] is not None))


def run_case(case: Case) -> Row:
    """Execute a run; an error becomes a column of its row."""
    try:
        if case.code != code_of(case.scenario):
            raise RuntimeError("this process has a different version of the code than the requesting process")
        world = world_of(zlib.decompress(case.world)) if case.world else None
        metrics = MEASURES[case.measure](plans.make(case.scenario, world))
    except Exception as error:  # a failed run is a row
        return _failed(case, f"{type(error).__name__}: {error}")
    return metrics | _settings(case) | {ERROR: None}


def _failed(case: Case, why: str) -> Row:
    return {**_settings(case), ERROR: why}


def _settings(case: Case) -> Row:
    """The columns of a case that are known before its run: settings, with tables as JSON."""
    plain = case.scenario.model_dump(mode="json")
    plain[MOST_STEPS] = plain.pop("steps")
    settings = {
        name: str(value) if name == "bandwidth"
        else json.dumps(value, sort_keys=True) if isinstance(value, dict | list) or name == "start"
        else value
        for name, value in plain.items()
    }  # fmt: skip
    return {KEY: case.key, CODE: case.code, "measure": case.measure, **settings}


def identity(scenario: Scenario, measure: str, world: bytes) -> str:
    """SHA-256 of settings, measure, and the `content` of a map file."""
    settings = scenario.model_dump(mode="json")
    if world:
        settings["map"] = Path(scenario.map).name
    text = json.dumps((settings, measure), sort_keys=True)
    return hashlib.sha256(text.encode() + world).hexdigest()


def code_of(scenario: Scenario) -> str:
    """SHA-256 of versions and sources, including those of plug-ins."""
    text = json.dumps([versions(), _sources(), plugins.sources(scenario)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def _sources() -> str:
    """SHA-256 of the sources."""
    total = hashlib.sha256()
    root = Path(__file__).parents[2]
    for name in SOURCES:
        path = root / name
        for file in sorted([*path.rglob("*.py"), *path.rglob("*.npz")]) if path.is_dir() else [path]:
            total.update(file.read_bytes())
    return total.hexdigest()


def is_file(name: str) -> bool:
    """Return whether the name of a map is that of a file; other maps are generated."""
    return name.endswith(FILES) or Path(name).is_file()


def content(world: Map) -> bytes:
    """Serialize the map of a file, for processes without the file."""
    head = json.dumps([world.name, world.resolution, world.origin, world.cells.shape])
    return head.encode() + b"\n" + world.cells.tobytes()


def world_of(content: bytes) -> Map:
    """Deserialize the map of a file."""
    head, _, cells = content.partition(b"\n")
    name, resolution, origin, shape = json.loads(head)
    return Map(name, np.frombuffer(cells, np.uint8).reshape(shape).copy(), resolution, tuple(origin))
