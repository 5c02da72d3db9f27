"""Sweeps: one scenario, many settings of it, run in a pool of processes on the memory bus.

An experiment is TOML: ``[base]`` holds a scenario's keys, ``[grid]`` lists of values of which every combination
is run, ``[[variant]]`` named sets of keys that are compared. ``[table]`` says what to print.
"""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deploy import mission
from deploy.scenario import Scenario, ScenarioError, parse

VARIANT = "variant"


@dataclass(frozen=True)
class Experiment:
    """What an experiment's file says.

    Attributes
    ----------
    name : str
    base : dict
        Keys of a scenario that all runs share.
    grid : dict of key to list
        Every combination of these values is run.
    variants : dict of name to keys
        Named sets of keys, each run on the whole grid.
    rows, columns : list of str
        Keys of the grid (or ``variant``) that head the table's rows and columns; the rest is averaged over.
    values : list of str
        Figures of the summary to print; dotted for those in tables, as ``bytes.total``.
    """

    name: str
    base: dict[str, Any]
    grid: dict[str, list[Any]]
    variants: dict[str, dict[str, Any]]
    rows: list[str]
    columns: list[str]
    values: list[str]


@dataclass(frozen=True)
class Case:
    """One run of an experiment: where it stands in the grid, and its scenario."""

    place: dict[str, Any]
    scenario: Scenario


def read(path: Path) -> Experiment:
    """Read an experiment's file.

    Raises
    ------
    ScenarioError
        It cannot be read, or a key is missing, unknown or of the wrong kind.
    """
    where = f"experiment {path}"
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ScenarioError(f"{where}: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{where}: not TOML: {error}") from None
    unknown = sorted(set(data) - {"name", "base", "grid", "variant", "table"})
    if unknown:
        raise ScenarioError(
            f"{where}: {unknown[0]} is no table of an experiment; there are: base, grid, variant, table"
        )
    grid, table = data.get("grid", {}), data.get("table", {})
    for key, values in grid.items():
        if not isinstance(values, list) or not values:
            raise ScenarioError(f"{where}: grid.{key} must be a list of values")
    variants = {}
    for entry in data.get("variant", [{"name": "plain"}]):
        if "name" not in entry:
            raise ScenarioError(f"{where}: each [[variant]] needs a name")
        variants[str(entry["name"])] = {key: value for key, value in entry.items() if key != "name"}
    rows, columns = table.get("rows", list(grid)), table.get("columns", [VARIANT])
    for key in [*rows, *columns]:
        if key != VARIANT and key not in grid:
            raise ScenarioError(
                f"{where}: table speaks of {key!r}, which is not in the grid: {', '.join(grid)}"
            )
    values = table.get("values", ["steps", "coverage", "map_agreement"])
    return Experiment(
        str(data.get("name", path.stem)), data.get("base", {}), grid, variants, rows, columns, values
    )


def cases(experiment: Experiment, overrides: dict[str, Any] | None = None) -> list[Case]:
    """All runs of an experiment, in the order of its grid; ScenarioError if one cannot be.

    `overrides` replaces lists of the grid by the same name, and keys of the base otherwise.
    """
    overrides = overrides or {}
    grid = {key: overrides.get(key, values) for key, values in experiment.grid.items()}
    base = experiment.base | {key: value for key, value in overrides.items() if key not in grid}
    result = []
    for combination in itertools.product(*grid.values()):
        chosen = dict(zip(grid, combination, strict=True))
        for name, keys in experiment.variants.items():
            place = {**chosen, VARIANT: name}
            where = ", ".join(f"{key} = {value}" for key, value in place.items())
            scenario = parse({**base, **chosen, **keys, "bus": "memory"}, f"{experiment.name} ({where})")
            result.append(Case(place, scenario))
    return result


def run(
    todo: Sequence[Case], jobs: int, tell: Callable[[int, int], object] = lambda _done, _all: None
) -> list[dict[str, Any]]:
    """Run cases in `jobs` processes; return their summaries, with their places, in the order of `todo`."""
    summaries: list[dict[str, Any]] = [{} for _ in todo]
    with ProcessPoolExecutor(jobs) as pool:
        futures = {pool.submit(_run_one, case.scenario): index for index, case in enumerate(todo)}
        for done, future in enumerate(as_completed(futures), 1):
            index = futures[future]
            summaries[index] = {**future.result(), "place": todo[index].place}
            tell(done, len(todo))
    return summaries


def tabulate(experiment: Experiment, summaries: Sequence[dict[str, Any]]) -> list[list[str]]:
    """The table that the experiment asks for: a line of heads, then a line a row, means over all else."""
    heads = _combinations(summaries, experiment.columns)
    rows = _combinations(summaries, experiment.rows)
    lines = [[*experiment.rows, *("/".join(map(str, head)) for head in heads)]]
    for row in (*rows, None):
        cells = list(map(_short, row)) if row is not None else ["all", *[""] * (len(experiment.rows) - 1)]
        for head in heads:
            chosen = [
                s
                for s in summaries
                if (row is None or tuple(s["place"][key] for key in experiment.rows) == row)
                and tuple(s["place"][key] for key in experiment.columns) == head
            ]
            cells.append(" ".join(_mean(chosen, value) for value in experiment.values))
        lines.append(cells)
    return lines


def _combinations(summaries: Sequence[dict[str, Any]], keys: list[str]) -> list[tuple[Any, ...]]:
    """All combinations of some keys' values, in the order of the grid."""
    return list(dict.fromkeys(tuple(summary["place"][key] for key in keys) for summary in summaries))


def _run_one(scenario: Scenario) -> dict[str, Any]:
    return mission.explore(scenario, keep=False).summary


def _short(value: object) -> str:
    return Path(value).stem if isinstance(value, str) and value.endswith(".yaml") else str(value)


def _mean(summaries: Sequence[dict[str, Any]], figure: str) -> str:
    found = [value for value in (_look_up(summary, figure) for summary in summaries) if value is not None]
    if not found:
        return "-"
    mean = float(np.mean(found))
    return f"{mean:.0f}" if abs(mean) >= 10 else f"{mean:.3f}"


def _look_up(summary: dict[str, Any], figure: str) -> Any:
    value: Any = summary
    for part in figure.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return value
