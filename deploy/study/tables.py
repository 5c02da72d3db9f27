"""Metrics of runs, and the tables of metrics that a sweep prints and writes.

A metric is a column of the table of runs (``steps``), dotted for a nested value (``bytes.total``); a sum of columns
(``bytes.ins + bytes.del``); or a quotient of two of these (``bytes.conn / bytes.total``). ``relative to`` and a variant
divide it by the metric of that variant's run with otherwise equal settings. The prefix ``min`` means the minimum over
all runs instead of their mean.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import polars as pl
from pydantic import Field

from deploy.study.results import PLACE, Row
from deploy.study.statistics import five_numbers, interval, share
from netshaper.ledger import CAUSES
from protocol.packets import ALL_KINDS

VARIANT = "variant"

METHODS = (VARIANT, "strategy", "map_encoding", "dissemination")
"""Keys whose values a table never averages."""

DEFAULT_METRICS = ("steps", "coverage", "map_accuracy")

RELATIVE = " relative to "
"""Separates a metric from the variant by whose metric it is divided."""

MIN = "min "
"""Prefix for the minimum of a metric over all runs."""

MIN_COVERAGE = 0.99
"""Minimum coverage of a finished run."""

METRICS = (
    "steps", "coverage", "map_accuracy", "mean_map_accuracy", "worst_map_accuracy",
    "t50", "t90", "t95", "t99", "longest_path", "longest_path_95", "longest_path_99",
    "overlap", "overlap_sum", "seen_std", "finished", "first_robot",
    "claimed_map_accuracy", "claimed_mean_map_accuracy", "claimed_worst_map_accuracy",
    "claimed_wall_precision", "claimed_wall_recall", "claimed_wall_f1",
    "claimed_mean_wall_precision", "claimed_mean_wall_recall", "claimed_mean_wall_f1",
    "claimed_worst_wall_precision", "claimed_worst_wall_recall", "claimed_worst_wall_f1",
    "walls_within_tolerance", "worst_walls_within_tolerance", "tolerance",
    "approximation_error", "approximation_error_net", "explored_at", "known_at", "robots", "seed", "range_m",
    "raw_scan_bytes", "map_code_bytes", "map_code_multiple",
    "over_budget_steps", "duty_cycle", "protocol_errors", "wall_s", "steps_per_s", "work_us_median",
    "step_s", "missed_steps", "missed_phases",
)  # fmt: skip
"""Numeric values of a summary (`deploy.record.summary.summarize`)."""

TABLES = {
    "bytes": (*ALL_KINDS, "total"),
    "packets": (*ALL_KINDS, "total"),
    "undelivered": tuple(cause for cause in CAUSES if cause),
}
"""Nested tables of a summary with their numeric values; missing values are 0."""


@dataclass(frozen=True)
class Table:
    """The layout of a table."""

    rows: list[str] | None = None
    """Keys of the grid, or ``variant``, that label the lines; metrics are averaged over the others. None: all keys."""
    columns: list[str] = field(default_factory=lambda: [VARIANT])
    """More such keys, to the right of `rows`."""
    values: Annotated[list[str], Field(min_length=1)] = field(default_factory=lambda: [*DEFAULT_METRICS])
    """Metrics; each has a column."""
    interval: Annotated[bool, Field(strict=True)] = False
    """Whether means are printed with half their 95 % interval (Student's t)."""
    finished_only: Annotated[bool, Field(strict=True)] = False
    """Whether means include only finished runs."""

    @property
    def keys(self) -> list[str]:
        """The keys that label the lines."""
        return [*(self.rows or []), *self.columns]


def check_table(table: Table, grid: Iterable[str], variants: Iterable[str], metrics: Iterable[str]) -> None:
    """Raise ValueError if a table names a key, a variant or a metric that its experiment does not have."""
    check_keys("table", table.keys, grid)
    for value in table.values:
        check(value, variants, metrics)


def check_keys(where: str, keys: Iterable[str], grid: Iterable[str]) -> None:
    """Raise ValueError, whose text begins with `where`, unless all keys are in the grid, or the variant."""
    known = sorted({*grid, VARIANT})
    for key in keys:
        if key not in known:
            raise ValueError(
                f"{where} names {key!r}, which is not in the grid; there are: {', '.join(known)}"
            )


def check(text: str, variants: Iterable[str], names: Iterable[str] = ()) -> None:
    """Raise ValueError unless `text` is a metric or one of `names`, relative to none or one of the variants."""
    name, relative, against = text.removeprefix(MIN).partition(RELATIVE)
    if relative and against not in variants:
        raise ValueError(f"{text!r}: no variant is called {against!r}; there are: {', '.join(variants)}")
    parts = name.split(" / ")
    if len(parts) > 2:
        raise ValueError(f"{text!r}: must be sums of metrics with at most one ' / ' between them")
    for one in (one for part in parts for one in part.split(" + ")):
        table, _, number = one.rpartition(".")
        if one not in names and number not in (TABLES.get(table, ()) if table else METRICS):
            tables = (f"{table}.{'|'.join(numbers)}" for table, numbers in TABLES.items())
            raise ValueError(f"{one!r} is not a metric; there are: {', '.join([*METRICS, *names, *tables])}")


def metric_value(row: Row, text: str) -> float | None:
    """Read a metric, without ``relative to``, from a row; None if it is missing or divided by 0."""
    sums = []
    for part in text.split(" / "):
        found = [_look_up(row, name) for name in part.split(" + ")]
        if None in found:
            return None
        sums.append(float(sum(found)))
    if len(sums) == 1:
        return sums[0]
    return sums[0] / sums[1] if sums[1] else None


def tabulate(table: Table, runs: Sequence[Row]) -> list[list[str]]:
    """The table as text: a header, and a line per combination of the keys' values with means over all other keys.

    The columns are the keys, the number n of runs, and the metrics. A cell tells its n if it differs from the line's.
    """
    keys, cells = _cells(table, runs)
    return [[*keys, "n", *table.values], *([*cell.values(), *_texts(table, each)] for cell, each in cells)]


def means(table: Table, runs: Sequence[Row]) -> pl.DataFrame:
    """The same table as numbers; if it has intervals, half of each follows its mean in a column of its own (`±`)."""
    _, cells = _cells(table, runs)
    lines = []
    for cell, each in cells:
        line: dict[str, Any] = {**cell, "n": _counted(table, each[0])}
        for metric in each:
            is_min = metric["metric"].startswith(MIN)
            line[metric["metric"]] = metric["min" if is_min else "mean"] if metric["n"] else None
            if table.interval and not is_min:
                line[f"{metric['metric']} ±"] = metric["high"] - metric["mean"] if metric["n"] > 1 else None
        lines.append(line)
    return pl.DataFrame(lines, infer_schema_length=None)


def described(table: Table, runs: Sequence[Row]) -> pl.DataFrame:
    """Statistics of each cell and metric of a table: number of runs, share finished, mean with interval, quartiles.

    Cells are the combinations of the table's keys.
    """
    _, cells = _cells(table, runs)
    return pl.DataFrame(
        [cell | statistics for cell, each in cells for statistics in each], infer_schema_length=None
    )


def _cells(
    table: Table, runs: Sequence[Row]
) -> tuple[list[str], list[tuple[dict[str, str], list[dict[str, Any]]]]]:
    """The keys of the lines, and for each combination of their values, in the order of the grid, all statistics.

    Different methods are never averaged: their keys are added if the runs differ in them.
    """
    added = [key for key in METHODS if len({repr(run[PLACE].get(key)) for run in runs}) > 1]
    keys = list(dict.fromkeys([*table.keys, *added]))
    twins = {key_of(run[PLACE]): run for run in runs}
    names = {key: names_of(runs, key) for key in keys}
    members: dict[tuple[str, ...], list[Row]] = {}
    for run in runs:
        members.setdefault(tuple(repr(run[PLACE][key]) for key in keys), []).append(run)
    return keys, [
        (
            {key: names[key][value] for key, value in zip(keys, cell, strict=True)},
            [_statistics(table, name, some, twins) for name in table.values],
        )
        for cell, some in members.items()
    ]


def _statistics(table: Table, metric: str, runs: Sequence[Row], twins: dict[Any, Row]) -> dict[str, Any]:
    """Statistics of a metric over some runs; a minimum includes those that have not finished."""
    name = metric.removeprefix(MIN)
    counted = [run for run in runs if has_finished(run) or not table.finished_only or name != metric]
    values = [value for run in counted if (value := _value(run, name, twins)) is not None]
    finished, mean = share(sum(map(has_finished, runs)), len(runs)), interval(values)
    low, first, median, third, high = five_numbers(values)
    return {
        "metric": metric, "runs": len(runs), "finished": finished.mean, "finished_low": finished.low,
        "finished_high": finished.high, "n": mean.n, "mean": mean.mean, "low": mean.low, "high": mean.high,
        "min": low, "quartile_1": first, "median": median, "quartile_3": third, "max": high,
    }  # fmt: skip


def _counted(table: Table, statistics: dict[str, Any]) -> int:
    """The number of runs that count in a line: all, or the finished ones."""
    runs: int = statistics["runs"]
    return round(statistics["finished"] * runs) if table.finished_only else runs


def _texts(table: Table, each: Sequence[dict[str, Any]]) -> Iterator[str]:
    """The number of runs of a line, and its metrics, as text."""
    counted, runs = _counted(table, each[0]), each[0]["runs"]
    yield str(runs) if counted == runs else f"{counted} of {runs}"
    for metric in each:
        is_min = metric["metric"].startswith(MIN)
        expected = runs if is_min else counted
        yield _text(table, metric) + (f" (n = {metric['n']})" if 0 < metric["n"] != expected else "")


def _text(table: Table, statistics: dict[str, Any]) -> str:
    """The mean or minimum of a metric over some runs, as text."""
    n, mean = statistics["n"], statistics["mean"]
    if not n:
        return "-"
    if statistics["metric"].startswith(MIN):
        return f"{statistics['min']:.4f}"
    digits = 0 if abs(mean) >= 10 else 3
    half = f" ± {(statistics['high'] - mean):.{digits}f}" if table.interval and n > 1 else ""
    return f"{mean:.{digits}f}{half}"


def has_finished(row: Row) -> bool:
    """Return whether a run ended as explored with sufficient coverage; always true for other measures."""
    return row.get("finished") is None or (bool(row["finished"]) and row["coverage"] >= MIN_COVERAGE)


def key_of(place: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    """A position in a grid as a hashable key."""
    return tuple(sorted((name, repr(value)) for name, value in place.items()))


def _value(summary: Row, text: str, twins: dict[Any, Row]) -> float | None:
    """A metric, divided by that of another variant's run if the text requests it and that run exists."""
    name, _, against = text.partition(RELATIVE)
    value = metric_value(summary, name)
    if not against or value is None:
        return value
    twin = twins.get(key_of(summary[PLACE] | {VARIANT: against}))
    other = metric_value(twin, name) if twin is not None else None
    return value / other if other else None


def levels_of(runs: Sequence[Row], key: str) -> list[Any]:
    """The values of a key, in the order of the grid."""
    return list({repr(run[PLACE][key]): run[PLACE][key] for run in runs}.values())


def names_of(runs: Sequence[Row], key: str) -> dict[str, str]:
    """The labels of a key's values, by their `repr`; files of one name in several folders have their whole paths."""
    levels = levels_of(runs, key)
    counts = Counter(map(short, levels))
    return {repr(value): short(value) if counts[short(value)] == 1 else str(value) for value in levels}


def short(value: object) -> str:
    """A value of the grid as a label; for files the name."""
    return Path(value).stem if isinstance(value, str) and value.endswith((".yaml", ".png")) else str(value)


def _look_up(row: Row, name: str) -> Any:
    """A column of a row; 0 for a missing value of a nested table, which holds only nonzero values."""
    value = row.get(name)
    return 0 if value is None and name.rpartition(".")[0] in TABLES else value
