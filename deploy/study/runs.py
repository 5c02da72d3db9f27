"""The runs of an experiment: one case each, made where there are processes for it, and its row in the table.

Invalid input is refused before the first run.
"""

from __future__ import annotations

import hashlib
import inspect
import itertools
import json
import sys
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from agent.encodings.catalog import encoding_class
from agent.strategies.registry import strategy
from deploy.record.versions import versions
from deploy.run.workers import Workers
from deploy.scenario import plan as plans
from deploy.scenario.finding_maps import FILES
from deploy.scenario.scenario import Scenario, ScenarioError, parse
from deploy.scenario.thesis import with_thesis
from deploy.study.experiment import Experiment, lay, settings_of
from deploy.study.measures import MEASURES
from deploy.study.progress import Tell
from deploy.study.results import CODE, ERROR, KEY, Results, Row
from deploy.study.tables import VARIANT
from worldsim.maps import Map

MEMORY = "memory"

PLACE = "place"
"""Of a row that has been looked up for an experiment: its position there, by keys of the grid, and its variant."""

MOST_STEPS = "most_steps"
"""The setting `steps`, in rows of which ``steps`` is the exploration time."""

SPOT_CHECKS = 3
"""Runs of other code that are made again before any of them are taken."""

MAKERS = (
    "agent", "netshaper", "protocol", "worldsim", "deploy/scenario", "deploy/record", "deploy/run",
    "deploy/study/measures.py", "deploy/study/recovery.py", "deploy/study/runs.py", "deploy/study/voronoi.py",
)  # fmt: skip
"""The sources that a run's figures come from."""


@dataclass(frozen=True)
class Case:
    """One run of an experiment.

    Attributes
    ----------
    place : dict
        Its position in the grid, and its variant.
    scenario : Scenario
    measure : str
        What is measured (`deploy.study.measures`).
    key : str
        Sha256 of scenario, measure and map: the run's name in the table.
    code : str
        Sha256 of the sources and versions that are to make it.
    world : bytes
        The map's `content`, compressed, for processes that have not its file; empty for generated maps.
    """

    place: dict[str, Any]
    scenario: Scenario
    measure: str
    key: str
    code: str
    world: bytes = b""


def cases(experiment: Experiment) -> list[Case]:
    """All runs of an experiment, in the order of its grid; ScenarioError if one is invalid.

    Of runs that differ in their seeds only, the first is checked on its map; the others would fail as rows.
    """
    files: dict[str, bytes] = {}
    checked = set()
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
            data: dict[str, Any] = {"bus": MEMORY}
            try:
                for layer in (experiment.base, settings, keys):
                    lay(data, layer)
            except ValueError as error:
                raise ScenarioError(f"{where}: {error}") from None
            data |= {key: data[leader] for key, leader in experiment.follow.items() if leader in data}
            data = with_thesis(data, where)
            if data["bus"] != MEMORY:
                raise ScenarioError(
                    f"{where}: bus = {data['bus']!r}: sweeps run on the memory bus; leave it out"
                )
            scenario = parse(data, where)
            without_seeds = scenario.model_copy(update={"seed": 0, "map_seed": 0})
            try:
                if is_file(scenario.map) and scenario.map not in files:
                    files[scenario.map] = content(plans.load_map(scenario))
                if repr(without_seeds) not in checked:
                    plans.make(scenario)
                    checked.add(repr(without_seeds))
            except ScenarioError as error:
                raise ScenarioError(f"{where}: {error}") from None
            world = files.get(scenario.map, b"")
            key = identity(scenario, experiment.measure, world)
            result.append(
                Case(
                    place,
                    scenario,
                    experiment.measure,
                    key,
                    code_of(scenario),
                    world and zlib.compress(world),
                )
            )
    return result


def make(
    todo: Sequence[Case],
    results: Results,
    workers: Workers,
    tell: Tell | None = None,
    *,
    any_code: bool = False,
    retry: bool = False,
) -> None:
    """Make all runs that the table has not; equal ones once; each is in the table as soon as it is over.

    Parameters
    ----------
    tell : callable, optional
        Called with the number of runs that are there, and of all.
    any_code : bool
        Whether runs that other versions of the code have made are taken for the same, if some that are made again
        have the same digests. Settings that the table does not know were not there yet: they count as their defaults.
    retry : bool
        Whether failed runs are made again.

    Raises
    ------
    ValueError
        With `any_code`: a run comes out otherwise now.
    """
    distinct = {case.key: case for case in todo}
    if any_code:
        results.rename(key_by_settings)
        _same_as_ever(distinct, results)
    missing = [
        case
        for key, case in distinct.items()
        if not results.knows(key, None if any_code else case.code, retry=retry)
    ]
    done = len(distinct) - len(missing)
    tell = tell or _nothing
    tell(done, len(distinct))
    for case, row in workers.each(missing, run_case):
        results.add(row if isinstance(row, dict) else _failed(case, row))
        done += 1
        tell(done, len(distinct))


def key_by_settings(row: Row) -> str:
    """The key that a row's run would have today; its own if it has a map that is a file, or no such run is possible."""
    data = {name: row[name] for name in Scenario.model_fields if row.get(name) is not None}
    data["steps"] = row[MOST_STEPS]
    tables = ("start", *(name for name, value in data.items() if str(value)[:1] in ("{", "[")))
    data |= {name: json.loads(data[name]) for name in tables if name in data}
    try:
        return row[KEY] if is_file(row["map"]) else identity(parse(data), row["measure"], b"")
    except ScenarioError:
        return str(row[KEY])


def _same_as_ever(distinct: Mapping[str, Case], results: Results) -> None:
    """Make some of the runs of other code again; ValueError if one of them has another digest than it had."""
    foreign = [case for key, case in sorted(distinct.items()) if results.knows(key, None)]
    foreign = [case for case in foreign if not results.knows(case.key, case.code)]
    rows = results.rows(case.key for case in foreign)
    checked = [case for case in foreign if rows[case.key].get("digest") is not None][:SPOT_CHECKS]
    for case in checked:
        digest = run_case(case).get("digest")
        if digest != rows[case.key]["digest"]:
            raise ValueError(
                f"--any-code: the run with {case.place} comes out otherwise now than in the table; leave --any-code out"
            )


def looked_up(todo: Sequence[Case], results: Results) -> list[Row]:
    """The rows of all cases that have been run without an error, each with its `PLACE`, in the order of `todo`."""
    rows = results.rows({case.key for case in todo})
    return [
        {**rows[case.key], PLACE: case.place}
        for case in todo
        if case.key in rows and rows[case.key][ERROR] is None
    ]


def failures(todo: Iterable[Case], results: Results) -> dict[str, int]:
    """What went wrong, and how often."""
    counts: dict[str, int] = {}
    for row in results.rows({case.key for case in todo}).values():
        if row[ERROR] is not None:
            counts[row[ERROR]] = counts.get(row[ERROR], 0) + 1
    return counts


def _nothing(done: int, total: int) -> None:
    """Nobody wants to know how far the runs are."""


def run_case(case: Case) -> Row:
    """Make a run; what goes wrong in it is told in its row."""
    try:
        if case.code != code_of(case.scenario):
            raise RuntimeError(
                "this process has another version of the code than the one that asked for the run"
            )
        world = world_of(zlib.decompress(case.world)) if case.world else None
        figures = MEASURES[case.measure](plans.make(case.scenario, world))
    except Exception as error:  # a failed run is a row
        return _failed(case, f"{type(error).__name__}: {error}")
    return figures | _settings(case) | {ERROR: None}


def _failed(case: Case, why: str) -> Row:
    return {**_settings(case), ERROR: why}


def _settings(case: Case) -> Row:
    """The columns of a case that are known before it is run: settings, tables among them as JSON."""
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
    """Sha256 over what is run: the settings, what is measured, and the map's `content` if it is a file's."""
    settings = scenario.model_dump(mode="json")
    if world:
        settings["map"] = Path(scenario.map).name
    map_id = json.dumps((settings, measure), sort_keys=True)
    return hashlib.sha256(map_id.encode() + world).hexdigest()


def code_of(scenario: Scenario) -> str:
    """Sha256 over what runs it: versions, our sources, the strategy's and the exchange's."""
    theirs = f"{_strategy(scenario.strategy)} {_encoding(scenario.map_encoding)}"
    return hashlib.sha256(f"{_versions()} {_sources()} {theirs}".encode()).hexdigest()


@cache
def _versions() -> str:
    return json.dumps(versions(), sort_keys=True)


@cache
def _strategy(name: str) -> str:
    """The source of a strategy, which may be somebody's own."""
    return inspect.getsource(sys.modules[strategy(name).__module__])


@cache
def _encoding(name: str) -> str:
    """The source of an exchange, likewise."""
    return inspect.getsource(sys.modules[encoding_class(name).__module__])


@cache
def _sources() -> str:
    """Sha256 of the sources."""
    total = hashlib.sha256()
    root = Path(__file__).parents[2]
    for name in MAKERS:
        path = root / name
        for file in sorted([*path.rglob("*.py"), *path.rglob("*.npz")]) if path.is_dir() else [path]:
            total.update(file.read_bytes())
    return total.hexdigest()


def is_file(name: str) -> bool:
    """Whether a map is that of a file; others are generated."""
    return name.endswith(FILES) or Path(name).is_file()


def content(world: Map) -> bytes:
    """A map of a file, for processes that may not have it."""
    head = json.dumps([world.name, world.resolution, world.origin, world.cells.shape])
    return head.encode() + b"\n" + world.cells.tobytes()


def world_of(content: bytes) -> Map:
    """The map that this is the content of."""
    head, _, cells = content.partition(b"\n")
    name, resolution, origin, shape = json.loads(head)
    return Map(name, np.frombuffer(cells, np.uint8).reshape(shape).copy(), resolution, tuple(origin))
