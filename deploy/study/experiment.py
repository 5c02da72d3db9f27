"""An experiment: a scenario over factors and seeds, with the tables, plots and claims of its runs.

An experiment is a TOML file:

- ``[base]``: scenario settings of all runs; ``scenario = "burgard.toml"`` names a scenario file below them
- ``[grid]``: lists of values, of which all combinations are run; a table that contains the key itself sets several keys
- ``seeds = 20``: the seeds 0 to 19
- ``[follow]``: keys that copy the value of a key of the grid
- ``[[variant]]``: named sets of keys to compare
- ``thesis = true``, wherever a setting may stand: the rules of the thesis as defaults (`deploy.scenario.thesis`)
- ``[table]``: the table to print (`deploy.study.tables`)
- ``[[plot]]``: a plot to draw (`deploy.study.plots`)
- ``[claim]``: a claim of a paper with its rules (`deploy.study.claims`)
- ``[quick]``: values of a reduced experiment
- ``measure``: the measure, by default an exploration (`deploy.study.measures`)
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
"""Installed experiments, which commands accept by name instead of a path."""

TABLES = ("base", "grid", "follow", VARIANT, "table", "plot", "claim", "quick")
KEYS = ("name", "scenario", "seeds", "measure")

QUICK_SEEDS = 3


@dataclass(frozen=True)
class Experiment:
    """The content of an experiment's file.

    Attributes
    ----------
    where : str
        The experiment's name in error messages.
    name : str
    base : dict
        Scenario settings of all runs.
    grid : dict of key to list
        Lists of values, of which all combinations are run.
    follow : dict of key to key
        The first key copies the value of the second.
    variants : dict of name to keys
        Named sets of keys, each run on the whole grid.
    table : Table
        The table to print; rows and columns are keys of the grid, or ``variant``.
    plots : tuple of Plot
        The plots to draw.
    claim : Claim, optional
        The claim of a paper.
    quick : dict
        Values of the reduced experiment, as for `override`, and ``variants``, the names of its variants.
    measure : str
        Name of the measure of each case.
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
    """Read an experiment's file; the search for files and maps is that of scenarios.

    Raises
    ------
    ScenarioError
        It cannot be read, or a key is missing, unknown or of the wrong kind.
    """
    path, data = read_toml(path, "experiment", SHIPPED)
    where = f"experiment {path}"
    try:
        unknown = sorted(set(data) - {*KEYS, *TABLES})
        if unknown:
            raise ValueError(
                f"{unknown[0]} is not a key of an experiment; there are: {', '.join((*TABLES, *KEYS))}"
            )
        if not (set(data) & {"base", "grid", "scenario", VARIANT}):
            raise ValueError("nothing to run; an experiment has [base], [grid], [[variant]] or a scenario")
        for key in ("base", "grid", "follow", "table", "quick"):
            if not isinstance(data.get(key, {}), dict):
                raise ValueError(f"{key} = {data[key]!r}: must be a table, [{key}]")
        base, grid = _with_scenario(path, data.get("scenario"), data.get("base", {})), data.get("grid", {})
        if "seeds" in data:
            if "seed" in grid:
                raise ValueError("seeds and grid.seed: set only one of them")
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


def _with_scenario(path: Path, scenario: Any, base: dict[str, Any]) -> dict[str, Any]:
    """Lay the base over the settings of the named scenario file, if any."""
    if scenario is None:
        return base
    if not isinstance(scenario, str):
        raise ValueError(f"scenario = {scenario!r}: must be the name of a scenario file")
    beside_it = path.parent / scenario
    named, data = read_toml(beside_it if beside_it.exists() else Path(scenario), "scenario", SCENARIOS)
    if "map" in data:
        data["map"] = beside(named, data["map"])
    lay(data, base)
    return data


def lay(data: dict[str, Any], settings: dict[str, Any]) -> None:
    """Lay settings over others; a dotted name (``options.beta``) sets one key of a table.

    ValueError if a dotted name refers to a key of something else than a table.
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
    """The seeds 0 to `count` - 1; ValueError for an invalid count."""
    if type(count) is not int or count < 1:
        raise ValueError(f"seeds = {count!r}: must be a whole number, 1 or more")
    return list(range(count))


def quickened(experiment: Experiment) -> Experiment:
    """The reduced experiment by its ``[quick]``; three seeds by default."""
    settings = dict(experiment.quick)
    names = settings.pop("variants", list(experiment.variants))
    if "seeds" in settings or "seed" not in settings:
        settings["seed"] = seeds(settings.pop("seeds", QUICK_SEEDS))
    return override(choose(experiment, names), settings)


def settings_of(key: str, value: Any) -> dict[str, Any]:
    """The settings of one value of the grid: its own key, or all keys of a table that contains its key."""
    return value if isinstance(value, dict) and key in value else {key: value}


def choose(experiment: Experiment, names: Sequence[str]) -> Experiment:
    """The experiment with only the named variants (default: all); ScenarioError for an unknown name."""
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
            raise ScenarioError(
                f"{experiment.where}: the table needs {against!r} for {value!r}: choose it as well"
            )
    return replace(experiment, variants=chosen)


def override(experiment: Experiment, settings: dict[str, Any]) -> Experiment:
    """The experiment with other values of some keys.

    The values replace lists of the grid by the same name, or else keys of the base. A single value is a list of one.

    Raises
    ------
    ScenarioError
        A list is empty or has duplicates, or a value has no effect.
    """
    base, grid = dict(experiment.base), dict(experiment.grid)
    for key, value in settings.items():
        if key == VARIANT:
            raise ScenarioError("--set variant: is not a setting; --variant NAME chooses variants")
        if key in grid:
            grid[key] = value if isinstance(value, list) else [value]
            try:
                _check_values(f"--set {key}", grid[key])
            except ValueError as error:
                raise ScenarioError(str(error)) from None
        elif all(key in keys for keys in experiment.variants.values()):
            raise ScenarioError(
                f"--set {key}: has no effect, because each variant of {experiment.where} sets {key}"
            )
        else:
            base[key] = value
    return replace(experiment, base=base, grid=grid)


def _check_values(key: str, values: Any) -> None:
    """Raise ValueError unless `values` is a valid list of a grid."""
    if not isinstance(values, list) or not values:
        raise ValueError(f"{key} = {values!r}: must be a list of values, as [3, 5]")
    name = key.rpartition(".")[2].rpartition(" ")[2]
    labels = [settings_of(name, value)[name] for value in values]
    for label in labels:
        if labels.count(label) > 1:
            raise ValueError(f"{key} = {values!r}: contains {label!r} twice")


def _found(path: Path, value: Any) -> Any:
    """A map of the grid, with its path."""
    return (
        value | {"map": beside(path, value["map"])}
        if isinstance(value, dict) and "map" in value
        else beside(path, value)
    )


def _follow(pairs: dict[str, Any], grid: dict[str, Any]) -> dict[str, str]:
    """Check pairs of a key and the key that it follows; ValueError unless only the second is in the grid."""
    for key, leader in pairs.items():
        if leader not in grid:
            raise ValueError(f"follow.{key} = {leader!r}: is not in the grid; there are: {', '.join(grid)}")
        if key in grid:
            raise ValueError(f"follow.{key}: the grid sets {key} as well; remove one of them")
    return dict(pairs)


def _variants(entries: Any, grid: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The settings of each variant by its name; ValueError for missing or equal names, or keys of the grid."""
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
            raise ValueError(f"two variants are called {name!r}; names must differ")
        for key in keys:
            if key in set_by_grid:
                raise ValueError(
                    f"variant {name!r} sets {key}, which the grid sets as well; remove one of them"
                )
        variants[name] = keys
    return variants


def _table(
    data: dict[str, Any], grid: dict[str, Any], variants: dict[str, Any], names: Iterable[str]
) -> Table:
    """Check a table; ValueError if it is invalid."""
    usual = {"rows": list(grid), "columns": [VARIANT], "values": ["steps", "coverage", "map_accuracy"]}
    flags = {"interval": False, "finished_only": False}
    whole: dict[str, Any] = usual | flags | data
    for key, value in whole.items():
        if key not in usual and key not in flags:
            raise ValueError(f"table.{key} is not a key of a table; there are: {', '.join([*usual, *flags])}")
        if key in flags:
            if not isinstance(value, bool):
                raise ValueError(f"table.{key} = {value!r}: must be true or false")
        elif not isinstance(value, list) or not all(isinstance(name, str) for name in value):
            raise ValueError(f"table.{key} = {value!r}: must be a list of names, as {usual[key]}")
    table = Table(**whole)
    for key in [*table.rows, *table.columns]:
        if key != VARIANT and key not in grid:
            known = ", ".join([*grid, VARIANT])
            raise ValueError(f"table names {key!r}, which is not in the grid; there are: {known}")
    if not table.values:
        raise ValueError("table.values = []: must name at least one metric, as ['steps']")
    for value in table.values:
        check(value, variants, names)
    return table
