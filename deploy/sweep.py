"""Sweeps: one scenario, many settings of it, run in a pool of processes on the memory bus.

An experiment is TOML: ``[base]`` holds a scenario's keys, ``[grid]`` lists of values of which every combination
is run, ``[[variant]]`` named sets of keys that are compared. ``[table]`` says what to print: figures of the
summary, their sums and quotients (`figure`), and how they relate to another variant's on the same run.
"""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from deploy import mission
from deploy.scenario import Scenario, ScenarioError, parse
from protocol.packets import ALL_KINDS

VARIANT = "variant"

RELATIVE = " relative to "
"""Between a figure and the variant whose figure of the same run it is divided by."""


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
        Without columns each figure has one of its own.
    values : list of str
        Figures to print, as `figure` reads them; behind one may stand ``relative to`` and a variant.
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
    if not (set(data) & {"base", "grid", "variant"}):
        raise ScenarioError(f"{where}: nothing to run; an experiment has [base], [grid] or [[variant]]")
    for key in ("base", "grid", "table"):
        if not isinstance(data.get(key, {}), dict):
            raise ScenarioError(f"{where}: {key} = {data[key]!r}: must be a table, [{key}]")
    grid, table = data.get("grid", {}), data.get("table", {})
    for key, values in grid.items():
        if not isinstance(values, list) or not values:
            raise ScenarioError(f"{where}: grid.{key} must be a list of values")
    variants = {}
    for entry in data.get("variant", [{"name": "plain"}]):
        if not isinstance(entry, dict) or "name" not in entry:
            raise ScenarioError(f"{where}: each [[variant]] needs a name")
        variants[str(entry["name"])] = {key: value for key, value in entry.items() if key != "name"}
    rows, columns = table.get("rows", list(grid)), table.get("columns", [VARIANT])
    for key in [*rows, *columns]:
        if key != VARIANT and key not in grid:
            raise ScenarioError(
                f"{where}: table speaks of {key!r}, which is not in the grid: {', '.join(grid)}"
            )
    values = table.get("values", ["steps", "coverage", "map_agreement"])
    for value in values:
        name, _, against = value.partition(RELATIVE)
        if against and against not in variants:
            raise ScenarioError(f"{where}: {value!r}: no variant is called {against}: {', '.join(variants)}")
        if name.count(" / ") > 1:
            raise ScenarioError(f"{where}: {name!r}: must be sums of figures with at most one ' / ' between")
    return Experiment(
        str(data.get("name", path.stem)), data.get("base", {}), grid, variants, rows, columns, values
    )


def choose(experiment: Experiment, names: Sequence[str]) -> Experiment:
    """The experiment with the variants called `names` only (none: all); ScenarioError if there is no such one."""
    for name in names:
        if name not in experiment.variants:
            known = ", ".join(experiment.variants)
            raise ScenarioError(f"{experiment.name}: no variant is called {name!r}; there are: {known}")
    chosen = {
        name: keys for name, keys in experiment.variants.items() if name in (names or experiment.variants)
    }
    for value in experiment.values:
        against = value.partition(RELATIVE)[2]
        if against and against not in chosen:
            raise ScenarioError(f"{experiment.name}: the table has {value!r}: choose {against!r} as well")
    return replace(experiment, variants=chosen)


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
    twins = {_key(summary["place"]): summary for summary in summaries}
    heads = _combinations(summaries, experiment.columns)
    rows = _combinations(summaries, experiment.rows)
    split = not experiment.columns
    names = experiment.values if split else ["/".join(map(str, head)) for head in heads]
    lines = [[*experiment.rows, *names]]
    for row in (*rows, None):
        cells = list(map(_short, row)) if row is not None else ["all", *[""] * (len(experiment.rows) - 1)]
        for head in heads:
            chosen = [
                s
                for s in summaries
                if (row is None or tuple(s["place"][key] for key in experiment.rows) == row)
                and tuple(s["place"][key] for key in experiment.columns) == head
            ]
            means = [_mean([_value(s, value, twins) for s in chosen]) for value in experiment.values]
            cells += means if split else [" ".join(means)]
        lines.append(cells)
    return lines


def figure(summary: dict[str, Any], text: str) -> float | None:
    """Read a figure from a summary.

    `text` is a name in it, dotted for what stands in a table (``bytes.total``), or a sum of names
    (``bytes.ins + bytes.del``), or a quotient of two of these (``bytes.conn / bytes.total``). A kind of packet
    that was not sent counts 0; None where there is no such figure.
    """
    above, _, below = text.partition(" / ")
    parts = [[_look_up(summary, name) for name in part.split(" + ")] for part in (above, below) if part]
    if any(value is None for part in parts for value in part):
        return None
    sums = [float(sum(part)) for part in parts]
    if len(sums) == 1:
        return sums[0]
    return sums[0] / sums[1] if sums[1] else None


def _value(summary: dict[str, Any], text: str, twins: dict[Any, dict[str, Any]]) -> float | None:
    """A figure, in relation to that of another variant's run if the text says so."""
    name, _, against = text.partition(RELATIVE)
    value = figure(summary, name)
    if not against or value is None:
        return value
    other = figure(twins[_key(summary["place"] | {VARIANT: against})], name)
    return value / other if other else None


def _key(place: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    return tuple(sorted((name, repr(value)) for name, value in place.items()))


def _combinations(summaries: Sequence[dict[str, Any]], keys: list[str]) -> list[tuple[Any, ...]]:
    """All combinations of some keys' values, in the order of the grid."""
    return list(dict.fromkeys(tuple(summary["place"][key] for key in keys) for summary in summaries))


def _run_one(scenario: Scenario) -> dict[str, Any]:
    return mission.explore(scenario, keep=False).summary


def _short(value: object) -> str:
    return Path(value).stem if isinstance(value, str) and value.endswith(".yaml") else str(value)


def _mean(values: Sequence[float | None]) -> str:
    found = [value for value in values if value is not None]
    if not found:
        return "-"
    mean = float(np.mean(found))
    return f"{mean:.0f}" if abs(mean) >= 10 else f"{mean:.3f}"


def _look_up(summary: dict[str, Any], name: str) -> Any:
    value: Any = summary
    *tables, last = name.split(".")
    for table in tables:
        value = value.get(table)
        if not isinstance(value, dict):
            return None
    return value.get(last, 0 if last in ALL_KINDS else None)
