"""Sweeps: one scenario, many settings of it, run in a pool of processes on the memory bus.

An experiment is TOML: ``[base]`` holds a scenario's keys, ``[grid]`` lists of values of which every combination
is run, ``[[variant]]`` named sets of keys that are compared. ``[table]`` says what to print (`deploy.study.tables`).
All that can be known to be wrong is refused before the first run.
"""

from __future__ import annotations

import hashlib
import inspect
import itertools
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from agent.strategies.registry import strategy
from deploy.record.summary import versions
from deploy.run import exploration
from deploy.scenario import plan
from deploy.scenario.scenario import Scenario, ScenarioError, beside, parse, read_toml
from deploy.study import tables
from deploy.study.run_pool import collect
from deploy.study.tables import RELATIVE, VARIANT, Table
from worldsim.maps import Map

SHIPPED = Path(__file__).with_name("experiments")
"""Experiments that are installed with the code; their names do for a path."""

MEMORY = "memory"


@dataclass(frozen=True)
class Experiment:
    """What an experiment's file says.

    Attributes
    ----------
    where : str
        How errors name it.
    name : str
    base : dict
        Keys of a scenario that all runs share.
    grid : dict of key to list
        Every combination of these values is run.
    variants : dict of name to keys
        Named sets of keys, each run on the whole grid.
    table : Table
        What to print; rows and columns are keys of the grid, or ``variant``.
    """

    where: str
    name: str
    base: dict[str, Any]
    grid: dict[str, list[Any]]
    variants: dict[str, dict[str, Any]]
    table: Table


@dataclass(frozen=True)
class Case:
    """One run of an experiment: where it stands in the grid, its scenario, and the `identity` of the run."""

    place: dict[str, Any]
    scenario: Scenario
    key: str


@dataclass(frozen=True)
class Outcome:
    """What a case has led to."""

    key: str
    place: dict[str, Any]
    summary: dict[str, Any]


def read(path: Path) -> Experiment:
    """Read an experiment's file; files and the maps that they name are found as those of scenarios are.

    Raises
    ------
    ScenarioError
        It cannot be read, or a key is missing, unknown or of the wrong kind.
    """
    path, data = read_toml(path, "experiment", SHIPPED)
    where = f"experiment {path}"
    try:
        unknown = sorted(set(data) - {"name", "base", "grid", VARIANT, "table"})
        if unknown:
            raise ValueError(
                f"{unknown[0]} is no table of an experiment; there are: base, grid, {VARIANT}, table"
            )
        if not (set(data) & {"base", "grid", VARIANT}):
            raise ValueError("nothing to run; an experiment has [base], [grid] or [[variant]]")
        for key in ("base", "grid", "table"):
            if not isinstance(data.get(key, {}), dict):
                raise ValueError(f"{key} = {data[key]!r}: must be a table, [{key}]")
        base, grid = data.get("base", {}), data.get("grid", {})
        for key, values in grid.items():
            _check_values(f"grid.{key}", values)
        variants = _variants(data.get(VARIANT, [{"name": "plain"}]), grid)
        for settings in (base, *variants.values()):
            if "map" in settings:
                settings["map"] = beside(path, settings["map"])
        if "map" in grid:
            grid["map"] = [beside(path, value) for value in grid["map"]]
        table = _table(data.get("table", {}), grid, variants)
    except ValueError as error:
        raise ScenarioError(f"{where}: {error}") from None
    return Experiment(where, str(data.get("name", path.stem)), base, grid, variants, table)


def choose(experiment: Experiment, names: Sequence[str]) -> Experiment:
    """The experiment with the variants called `names` only (none: all); ScenarioError if there is no such one."""
    for name in names:
        if name not in experiment.variants:
            known = ", ".join(experiment.variants)
            raise ScenarioError(f"{experiment.where}: no variant is called {name!r}; there are: {known}")
    chosen = {
        name: keys for name, keys in experiment.variants.items() if name in (names or experiment.variants)
    }
    for value in experiment.table.values:
        against = value.partition(RELATIVE)[2]
        if against and against not in chosen:
            raise ScenarioError(f"{experiment.where}: the table has {value!r}: choose {against!r} as well")
    return replace(experiment, variants=chosen)


def override(experiment: Experiment, settings: dict[str, Any]) -> Experiment:
    """The experiment with other values of some keys.

    They replace lists of the grid by the same name (a single value is a list of one), and keys of the base
    otherwise.

    Raises
    ------
    ScenarioError
        A list is empty, or says something twice; or the value would be without effect.
    """
    base, grid = dict(experiment.base), dict(experiment.grid)
    for key, value in settings.items():
        if key == VARIANT:
            raise ScenarioError("--set variant: is no setting; --variant NAME chooses variants")
        if key in grid:
            grid[key] = value if isinstance(value, list) else [value]
            try:
                _check_values(f"--set {key}", grid[key])
            except ValueError as error:
                raise ScenarioError(str(error)) from None
        elif all(key in keys for keys in experiment.variants.values()):
            raise ScenarioError(
                f"--set {key}: without effect, for each variant of {experiment.where} sets {key} itself"
            )
        else:
            base[key] = value
    return replace(experiment, base=base, grid=grid)


def cases(experiment: Experiment) -> list[Case]:
    """All runs of an experiment, in the order of its grid; ScenarioError if one cannot be."""
    worlds: dict[tuple[str, int], Map] = {}
    result = []
    for combination in itertools.product(*experiment.grid.values()):
        chosen = dict(zip(experiment.grid, combination, strict=True))
        for name, keys in experiment.variants.items():
            place = {**chosen, VARIANT: name}
            here = ", ".join(f"{key} = {value}" for key, value in place.items())
            where = f"{experiment.where} ({here})"
            data = {"bus": MEMORY, **experiment.base, **chosen, **keys}
            if data["bus"] != MEMORY:
                raise ScenarioError(
                    f"{where}: bus = {data['bus']!r}: sweeps run on the memory bus; leave it out"
                )
            scenario = parse(data, where)
            source = scenario.map, scenario.map_seed
            try:
                if source not in worlds:
                    worlds[source] = plan.load_map(scenario)
                plan.make(scenario, worlds[source])
            except ScenarioError as error:
                raise ScenarioError(f"{where}: {error}") from None
            result.append(Case(place, scenario, identity(scenario, worlds[source])))
    return result


def run(todo: Sequence[Case], jobs: int, keep: Path | None = None) -> Iterator[Outcome]:
    """Run cases in `jobs` processes, equal ones once; outcomes in `keep` are given again (`lines.collect`)."""
    return collect(list({case.key: case for case in todo}.values()), _run_one, Outcome, jobs, keep)


def summaries(todo: Sequence[Case], outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """The summaries of all cases whose outcome is known, with their places, in the order of `todo`."""
    known = {outcome.key: outcome.summary for outcome in outcomes}
    return [{**known[case.key], "place": case.place} for case in todo if case.key in known]


def identity(scenario: Scenario, world_map: Map) -> str:
    """Sha256 over all that decides a run: settings, cells of the map, versions, and our code."""
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


def _check_values(key: str, values: Any) -> None:
    """Raise ValueError unless `values` is a list that a grid can run through."""
    if not isinstance(values, list) or not values:
        raise ValueError(f"{key} = {values!r}: must be a list of values, as [3, 5]")
    for value in values:
        if values.count(value) > 1:
            raise ValueError(f"{key} = {values!r}: says {value!r} twice")


def _variants(entries: Any, grid: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The keys of each variant, by its name; ValueError if one is unnamed, named twice, or sets the grid's."""
    if not isinstance(entries, list) or not entries:
        raise ValueError(f"{VARIANT} = {entries!r}: must be tables, [[{VARIANT}]]")
    variants: dict[str, dict[str, Any]] = {}
    for entry in entries:
        if not isinstance(entry, dict) or "name" not in entry:
            raise ValueError(f"each [[{VARIANT}]] needs a name")
        keys = {key: value for key, value in entry.items() if key != "name"}
        name = str(entry["name"])
        if name in variants:
            raise ValueError(f"two variants are called {name!r}; each needs a name of its own")
        for key in keys:
            if key in grid:
                raise ValueError(f"variant {name!r} sets {key}, which the grid sets; leave it to one of them")
        variants[name] = keys
    return variants


def _table(data: dict[str, Any], grid: dict[str, Any], variants: dict[str, Any]) -> Table:
    """What to print; ValueError if there is no such thing."""
    usual = {"rows": list(grid), "columns": [VARIANT], "values": ["steps", "coverage", "map_agreement"]}
    whole = usual | data
    for key, names in whole.items():
        if key not in usual:
            raise ValueError(f"table.{key} is no part of a table; there are: {', '.join(usual)}")
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ValueError(f"table.{key} = {names!r}: must be a list of names, as {usual[key]}")
    table = Table(**whole)
    for key in [*table.rows, *table.columns]:
        if key != VARIANT and key not in grid:
            there_are = ", ".join([*grid, VARIANT])
            raise ValueError(f"table speaks of {key!r}, which is not in the grid; there are: {there_are}")
    if not table.values:
        raise ValueError("table.values = []: must name a figure at least, as ['steps']")
    for value in table.values:
        tables.check(value, variants)
    return table


@cache
def _code() -> str:
    """Sha256 of the sources."""
    total = hashlib.sha256()
    for package in ("agent", "deploy", "netshaper", "protocol", "worldsim"):
        for file in sorted((Path(__file__).parents[1] / package).rglob("*.py")):
            total.update(file.read_bytes())
    return total.hexdigest()


def _run_one(case: Case) -> Outcome:
    return Outcome(case.key, case.place, exploration.explore(case.scenario, keep=False).summary)
