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

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from deploy.scenario import plugins
from deploy.scenario.errors import ScenarioError, explained
from deploy.scenario.scenario import SHIPPED as SCENARIOS
from deploy.scenario.tables import MAX_RUNS, Whole
from deploy.scenario.tables import Table as Keys
from deploy.scenario.toml_files import beside, lay, read_toml
from deploy.study.claims import Claim, check_claim
from deploy.study.measures import EXPLORATION, MEASURES, METRICS
from deploy.study.plots import Plot, check_plot
from deploy.study.tables import RELATIVE, VARIANT, Table, check_table
from protocol.errors import shown, there_are

SHIPPED = Path(__file__).with_name("experiments")
"""Installed experiments, which commands accept by name instead of a path."""


class Quick(BaseModel):
    """The reduced experiment: names of its variants (default: all), number of seeds, and values as for `override`."""

    model_config = ConfigDict(extra="allow", frozen=True)

    seeds: Whole = Field(3, ge=1, le=MAX_RUNS)
    variants: list[str] = Field(default_factory=list)


class Variant(BaseModel):
    """A named set of settings."""

    model_config = ConfigDict(extra="allow", frozen=True)

    name: str


class ExperimentFile(Keys):
    """The keys of an experiment's file; see the module's description."""

    name: str | None = None
    scenario: str | None = None
    seeds: Whole | None = Field(None, ge=1, le=MAX_RUNS)
    measure: str = EXPLORATION
    base: dict[str, Any] = Field(default_factory=dict)
    grid: dict[str, list[Any]] = Field(default_factory=dict)
    follow: dict[str, str] = Field(default_factory=dict)
    variant: Annotated[list[Variant], Field(min_length=1)] = [Variant(name="plain")]  # noqa: RUF012
    table: Table | None = None
    plot: list[Plot] = Field(default_factory=list)
    claim: Claim | None = None
    quick: Quick = Field(default_factory=Quick)


@dataclass(frozen=True)
class Experiment:
    """The content of an experiment's file, which the module's description explains."""

    where: str
    """The experiment's name in error messages."""
    name: str
    base: dict[str, Any]
    grid: dict[str, list[Any]]
    follow: dict[str, str]
    """The first key copies the value of the second."""
    variants: dict[str, dict[str, Any]]
    """The keys of each variant, by its name."""
    table: Table
    plots: tuple[Plot, ...] = ()
    claim: Claim | None = None
    quick: Quick = field(default_factory=Quick)
    measure: str = EXPLORATION


def read(path: Path) -> Experiment:
    """Read an experiment's file; the search for files and maps is that of scenarios.

    Raises ScenarioError if it cannot be read, or a key is missing, unknown or of the wrong kind.
    """
    path, data = read_toml(path, "experiment", SHIPPED)
    where = f"experiment {path}"
    try:
        return _checked(path, ExperimentFile.model_validate(data))
    except ValidationError as error:
        raise explained(error, ExperimentFile).within(where) from None
    except ValueError as error:
        raise ScenarioError(f"{where}: {error}") from None


def _checked(path: Path, file: ExperimentFile) -> Experiment:
    """The experiment of a file; ValueError if its parts do not fit together."""
    if not file.model_fields_set & {"base", "grid", "scenario", VARIANT}:
        raise ValueError("nothing to run; an experiment has [base], [grid], [[variant]] or a scenario")
    if file.measure not in MEASURES:
        raise ValueError(f"measure = {file.measure!r}: {there_are(MEASURES, file.measure)}")
    grid, base = file.grid, _with_scenario(path, file.scenario, file.base)
    if file.seeds is not None:
        for where, given in (("grid", grid), ("base", file.base)):
            if "seed" in given:
                raise ValueError(f"seeds and {where}.seed: set only one of them")
        grid["seed"] = list(range(file.seeds))
    for key, values in grid.items():
        if key in file.base:
            raise ValueError(f"base.{key}: the grid sets {key} as well; remove one of them")
        _check_values(f"grid.{key}", values)
    for key, leader in file.follow.items():
        if leader not in grid:
            raise ValueError(f"follow.{key} = {leader!r}: is not in the grid; there are: {', '.join(grid)}")
        if key in grid:
            raise ValueError(f"follow.{key}: the grid sets {key} as well; remove one of them")
    variants = _variants(file.variant, grid)
    for settings in (base, *variants.values(), file.quick.model_extra or {}):
        if "map" in settings:
            settings["map"] = _found(path, settings["map"])
    if "map" in grid:
        grid["map"] = _found(path, grid["map"])
    table, names = file.table or Table(), METRICS.get(file.measure, ())
    table = table if table.rows is not None else replace(table, rows=list(grid))
    check_table(table, grid, variants, names)
    for plot in file.plot:
        check_plot(plot, grid, names)
    if file.claim is not None:
        check_claim(file.claim, grid, variants, names)
    return Experiment(
        f"experiment {path}", file.name or path.stem, base, grid, file.follow, variants, table, tuple(file.plot),
        file.claim, file.quick, file.measure,
    )  # fmt: skip


def _with_scenario(path: Path, scenario: str | None, base: dict[str, Any]) -> dict[str, Any]:
    """Lay the base over the settings of the named scenario file, if any."""
    if scenario is None:
        return base
    beside_it = path.parent / scenario
    named, data = read_toml(beside_it if beside_it.exists() else Path(scenario), "scenario", SCENARIOS)
    if "map" in data:
        data["map"] = beside(named, data["map"])
    lay(data, base, f"scenario {named}")
    return data


def quickened(experiment: Experiment) -> Experiment:
    """The reduced experiment by its ``[quick]``."""
    quick = experiment.quick
    settings = dict(quick.model_extra or {})
    if "seeds" in quick.model_fields_set or "seed" not in settings:
        settings["seed"] = list(range(quick.seeds))
    return override(choose(experiment, quick.variants), settings)


def settings_of(key: str, value: Any) -> dict[str, Any]:
    """The settings of one value of the grid: its own key, or all keys of a table that contains its key."""
    return value if isinstance(value, dict) and key in value else {key: value}


def choose(experiment: Experiment, names: Sequence[str]) -> Experiment:
    """The experiment with only the named variants (default: all); ScenarioError for an unknown name."""
    for name in names:
        if name not in experiment.variants:
            known = ", ".join(map(repr, experiment.variants))
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
    A list for a key that is not in the grid adds the key to it, and to the rows of the table.

    Raises ScenarioError if a list is empty or has duplicates, or a value has no effect.
    """
    base, grid, table = dict(experiment.base), dict(experiment.grid), experiment.table
    for key, value in settings.items():
        if key == VARIANT:
            raise ScenarioError("--set variant: is not a setting; --variant NAME chooses variants")
        names = key, key.partition(".")[0]
        set_by = [
            next((name for name in names if name in keys), None) for keys in experiment.variants.values()
        ]
        if all(set_by):
            raise ScenarioError(
                f"--set {key}: has no effect, because each variant of {experiment.where} sets {set_by[0]}"
            )
        if key not in grid and not _is_axis(key, value):
            base[key] = value
            continue
        if key not in grid and key != "seed":
            table = replace(table, rows=[*(table.rows or []), key])
        grid[key] = value if isinstance(value, list) else [value]
        try:
            _check_values(key, grid[key])
        except ValueError as error:
            raise ScenarioError(str(error)) from None
    return replace(experiment, base=base, grid=grid, table=table)


def _is_axis(key: str, value: Any) -> bool:
    """Whether a value is a list of values of the grid, not a setting that is a list itself."""
    if key in ("start", "starts", "robot") or not isinstance(value, list):
        return False
    return all(key in each for each in value if isinstance(each, dict))


def listed(key: str, values: Any) -> list[Any]:
    """The values of a key of a grid as a list; ScenarioError if they are none, or too many for a study."""
    (values,) = plugins.plain_settings({key: values}).values()
    if not isinstance(values, list | tuple | range):
        raise ScenarioError(f"{key} = {shown(values)}: must be a list of values, as [{shown(values)}]")
    if values[MAX_RUNS:]:
        raise ScenarioError(f"{key} = {shown(values)}: must be at most {MAX_RUNS} values")
    return list(values)


def first_seeds(number: Any, least: int = 1) -> list[int]:
    """The seeds from 0 up; ScenarioError unless their number is whole and from `least` to `MAX_RUNS`."""
    (number,) = plugins.plain_settings({"seeds": number}).values()
    if type(number) is not int or not least <= number <= MAX_RUNS:
        raise ScenarioError(f"seeds = {shown(number)}: must be a whole number from {least} to {MAX_RUNS}")
    return list(range(number))


def _check_values(key: str, values: Any) -> None:
    """Raise ValueError unless `values` is a list of different values, at least one."""
    if not values:
        raise ValueError(f"{key} = {shown(values)}: is an empty list; give at least one value")
    name = key.rpartition(".")[2].rpartition(" ")[2]
    seen: set[Any] = set()
    for value in values:
        label = settings_of(name, value)[name]
        same = repr(label) if isinstance(label, list | tuple | dict) else label
        if same in seen:
            raise ValueError(f"{key} = {shown(values)}: contains {shown(label)} twice")
        seen.add(same)


def _found(path: Path, value: Any) -> Any:
    """A map, a table with a map, or a list of these, with the paths of the maps."""
    if isinstance(value, list):
        return [_found(path, each) for each in value]
    if isinstance(value, dict) and "map" in value:
        return value | {"map": beside(path, value["map"])}
    return beside(path, value)


def _variants(entries: Sequence[Variant], grid: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The settings of each variant by its name; ValueError for equal names, or keys of the grid."""
    set_by_grid = {
        each for key, values in grid.items() for value in values for each in settings_of(key, value)
    }
    variants: dict[str, dict[str, Any]] = {}
    for entry in entries:
        if entry.name in variants:
            raise ValueError(f"two variants are called {entry.name!r}; names must differ")
        variants[entry.name] = entry.model_extra or {}
        if twice := sorted(variants[entry.name].keys() & set_by_grid):
            raise ValueError(
                f"variant {entry.name!r} sets {twice[0]}, which the grid sets as well; remove one of them"
            )
    return variants
