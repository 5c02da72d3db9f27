"""An experiment: one scenario over factors and seeds, and what to tabulate of its runs.

It is TOML: ``[base]`` holds a scenario's keys, ``[grid]`` lists of values of which every combination is run,
``[follow]`` keys that take the value of a key of the grid, ``[[variant]]`` named sets of keys that are compared.
A value of the grid that is a table with the key's own name in it sets all its keys; ``seeds = 20`` is short for the
seeds 0 to 19. ``scenario = "burgard.toml"`` names a scenario whose settings lie under ``[base]``; ``thesis = true``,
wherever a setting may stand, lays the thesis' plain rules under those of a run (`deploy.scenario.thesis`). ``[table]``
says what to print (`deploy.study.tables`), ``[[plot]]`` what to draw (`deploy.study.plots`), ``[claim]`` what a paper
claims of it and by which rules that is tested (`deploy.study.claims`). ``[quick]`` replaces values for a first look,
and ``measure`` names something other than an exploration (`deploy.study.measures`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from deploy.scenario.scenario import SHIPPED as SCENARIOS
from deploy.scenario.scenario import ScenarioError, beside, read_toml
from deploy.study.claims import Claim, read_claim
from deploy.study.measures import EXPLORATION, MEASURES, METRICS
from deploy.study.plots import Plot, read_plots
from deploy.study.tables import RELATIVE, VARIANT, Table, check
from protocol.errors import there_are

SHIPPED = Path(__file__).with_name("experiments")
"""Experiments that are installed with the code; they can be given by name instead of a path."""

TABLES = ("base", "grid", "follow", VARIANT, "table", "plot", "claim", "quick")
WORDS = ("name", "scenario", "seeds", "measure")

QUICK_SEEDS = 3


@dataclass(frozen=True)
class Experiment:
    """The content of an experiment's file.

    Attributes
    ----------
    where : str
        Its name in error messages.
    name : str
    base : dict
        Keys of a scenario that all runs share.
    grid : dict of key to list
        Every combination of these values is run.
    follow : dict of key to key
        The first takes the value of the second.
    variants : dict of name to keys
        Named sets of keys, each run on the whole grid.
    table : Table
        What to print; rows and columns are keys of the grid, or ``variant``.
    plots : tuple of Plot
        What to draw.
    claim : Claim, optional
        What a paper says of it.
    quick : dict
        Values for a first look: as for `override`, and ``variants``, the names of those that are run.
    measure : str
        What is measured of each case.
    """

    where: str
    name: str
    base: dict[str, Any]
    grid: dict[str, list[Any]]
    follow: dict[str, str]
    variants: dict[str, dict[str, Any]]
    table: Table
    plots: tuple[Plot, ...] = ()
    claim: Claim | None = None
    quick: dict[str, Any] = field(default_factory=dict)
    measure: str = EXPLORATION

    def with_plots(self, plots: tuple[Plot, ...]) -> Experiment:
        """The experiment with other plots."""
        return replace(self, plots=plots)


def read(path: Path) -> Experiment:
    """Read an experiment's file; files and the maps that they name are looked for as for scenarios.

    Raises
    ------
    ScenarioError
        It cannot be read, or a key is missing, unknown or of the wrong kind.
    """
    path, data = read_toml(path, "experiment", SHIPPED)
    where = f"experiment {path}"
    try:
        unknown = sorted(set(data) - {*WORDS, *TABLES})
        if unknown:
            raise ValueError(
                f"{unknown[0]} is no table of an experiment; there are: {', '.join((*TABLES, *WORDS))}"
            )
        if not (set(data) & {"base", "grid", "scenario", VARIANT}):
            raise ValueError("nothing to run; an experiment has [base], [grid], [[variant]] or a scenario")
        for key in ("base", "grid", "follow", "table", "quick"):
            if not isinstance(data.get(key, {}), dict):
                raise ValueError(f"{key} = {data[key]!r}: must be a table, [{key}]")
        base, grid = _under(path, data.get("scenario"), data.get("base", {})), data.get("grid", {})
        if "seeds" in data:
            if "seed" in grid:
                raise ValueError("seeds and grid.seed: say one of them")
            grid["seed"] = seeds(data["seeds"])
        for key, values in grid.items():
            _check_values(f"grid.{key}", values)
        measure = data.get("measure", EXPLORATION)
        if measure not in MEASURES:
            raise ValueError(f"measure = {measure!r}: {there_are(MEASURES, str(measure))}")
        names = METRICS.get(measure, ())
        follow = _follow(data.get("follow", {}), grid)
        variants = _variants(data.get(VARIANT, [{"name": "plain"}]), grid)
        for settings in (base, *variants.values()):
            if "map" in settings:
                settings["map"] = beside(path, settings["map"])
        if "map" in grid:
            grid["map"] = [_found(path, value) for value in grid["map"]]
        table = _table(data.get("table", {}), grid, variants, names)
        plots = read_plots(data.get("plot", []), {*grid, VARIANT}, names)
        claim = read_claim(data["claim"], grid, variants, names) if "claim" in data else None
        quick = data.get("quick", {})
        if "map" in quick:
            found = quick["map"] if isinstance(quick["map"], list) else [quick["map"]]
            quick["map"] = [_found(path, value) for value in found]
    except ValueError as error:
        raise ScenarioError(f"{where}: {error}") from None
    name = str(data.get("name", path.stem))
    return Experiment(where, name, base, grid, follow, variants, table, plots, claim, quick, measure)


def _under(path: Path, scenario: Any, base: dict[str, Any]) -> dict[str, Any]:
    """The base over the settings of a scenario's file, if it names one."""
    if scenario is None:
        return base
    if not isinstance(scenario, str):
        raise ValueError(f"scenario = {scenario!r}: must be the name of a scenario's file")
    beside_it = path.parent / scenario
    named, data = read_toml(beside_it if beside_it.exists() else Path(scenario), "scenario", SCENARIOS)
    if "map" in data:
        data["map"] = beside(named, data["map"])
    lay(data, base)
    return data


def lay(data: dict[str, Any], settings: dict[str, Any]) -> None:
    """Lay settings over others; of tables only the keys that a dotted name names (``options.beta``).

    ValueError if what a dotted name names a key of is no table.
    """
    for key, value in settings.items():
        table, dot, inner = key.partition(".")
        if dot:
            keys = data.get(table, {})
            if not isinstance(keys, dict):
                raise ValueError(f"{table} = {keys!r}: must be a table, for {key!r} sets a key of it")
            data[table] = {**keys, inner: value}
        else:
            data[key] = value


def seeds(count: Any) -> list[int]:
    """The seeds 0 to `count` - 1; ValueError if it is no number of seeds."""
    if type(count) is not int or count < 1:
        raise ValueError(f"seeds = {count!r}: must be a whole number of seeds, 1 or more")
    return list(range(count))


def quickened(experiment: Experiment) -> Experiment:
    """The experiment for a first look: as its ``[quick]`` says, of three seeds if it says nothing of seeds."""
    settings = dict(experiment.quick)
    names = settings.pop("variants", list(experiment.variants))
    if "seeds" in settings or "seed" not in settings:
        settings["seed"] = seeds(settings.pop("seeds", QUICK_SEEDS))
    return override(choose(experiment, names), settings)


def settings_of(key: str, value: Any) -> dict[str, Any]:
    """The keys that one value of the grid sets: its own, or all of a table that names its own among others."""
    return value if isinstance(value, dict) and key in value else {key: value}


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
        A list is empty or has duplicates, or the value would have no effect.
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


def _check_values(key: str, values: Any) -> None:
    """Raise ValueError unless `values` is a list that a grid can run through."""
    if not isinstance(values, list) or not values:
        raise ValueError(f"{key} = {values!r}: must be a list of values, as [3, 5]")
    name = key.rpartition(".")[2].rpartition(" ")[2]
    labels = [settings_of(name, value)[name] for value in values]
    for label in labels:
        if labels.count(label) > 1:
            raise ValueError(f"{key} = {values!r}: says {label!r} twice")


def _found(path: Path, value: Any) -> Any:
    """A map of the grid, looked for as for scenarios."""
    return (
        value | {"map": beside(path, value["map"])}
        if isinstance(value, dict) and "map" in value
        else beside(path, value)
    )


def _follow(pairs: dict[str, Any], grid: dict[str, Any]) -> dict[str, str]:
    """Which key takes whose value; ValueError if the grid has not the one, or has the other."""
    for key, leader in pairs.items():
        if leader not in grid:
            raise ValueError(
                f"follow.{key} = {leader!r}: is no key of the grid; there are: {', '.join(grid)}"
            )
        if key in grid:
            raise ValueError(f"follow.{key}: the grid sets {key} itself; leave it to one of them")
    return dict(pairs)


def _variants(entries: Any, grid: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The keys of each variant, by its name; ValueError if one is unnamed, named twice, or sets the grid's."""
    if not isinstance(entries, list) or not entries:
        raise ValueError(f"{VARIANT} = {entries!r}: must be tables, [[{VARIANT}]]")
    set_by_grid = {
        each for key, values in grid.items() for value in values for each in settings_of(key, value)
    }
    variants: dict[str, dict[str, Any]] = {}
    for entry in entries:
        if not isinstance(entry, dict) or "name" not in entry:
            raise ValueError(f"each [[{VARIANT}]] needs a name")
        keys = {key: value for key, value in entry.items() if key != "name"}
        name = str(entry["name"])
        if name in variants:
            raise ValueError(f"two variants are called {name!r}; each needs a name of its own")
        for key in keys:
            if key in set_by_grid:
                raise ValueError(f"variant {name!r} sets {key}, which the grid sets; leave it to one of them")
        variants[name] = keys
    return variants


def _table(
    data: dict[str, Any], grid: dict[str, Any], variants: dict[str, Any], names: Iterable[str]
) -> Table:
    """What to print; ValueError if it is unknown."""
    usual = {"rows": list(grid), "columns": [VARIANT], "values": ["steps", "coverage", "map_accuracy"]}
    flags = {"interval": False, "finished_only": False}
    whole: dict[str, Any] = usual | flags | data
    for key, said in whole.items():
        if key not in usual and key not in flags:
            raise ValueError(f"table.{key} is no part of a table; there are: {', '.join([*usual, *flags])}")
        if key in flags:
            if not isinstance(said, bool):
                raise ValueError(f"table.{key} = {said!r}: must be true or false")
        elif not isinstance(said, list) or not all(isinstance(name, str) for name in said):
            raise ValueError(f"table.{key} = {said!r}: must be a list of names, as {usual[key]}")
    table = Table(**whole)
    for key in [*table.rows, *table.columns]:
        if key != VARIANT and key not in grid:
            there_are = ", ".join([*grid, VARIANT])
            raise ValueError(f"table speaks of {key!r}, which is not in the grid; there are: {there_are}")
    if not table.values:
        raise ValueError("table.values = []: must name a figure at least, as ['steps']")
    for value in table.values:
        check(value, variants, names)
    return table
