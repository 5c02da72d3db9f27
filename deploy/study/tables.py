"""Metrics of runs, and the tables of metrics that a sweep prints and writes.

A metric is a column of the table of runs (``steps``), dotted for a nested value (``bytes.total``); a sum of columns
(``bytes.ins + bytes.del``); or a quotient of two of these (``bytes.conn / bytes.total``). ``relative to`` and a variant
divide it by the metric of that variant's run with otherwise equal settings. The prefix ``min`` means the minimum over
all runs instead of their mean.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import polars as pl
from pydantic import Field

from deploy.study.results import Row
from deploy.study.statistics import five_numbers, interval, share
from netshaper.ledger import CAUSES
from protocol.packets import ALL_KINDS

VARIANT = "variant"

DEFAULT_METRICS = ("steps", "coverage", "map_accuracy")

RELATIVE = " relative to "
"""Separates a metric from the variant by whose metric it is divided."""

MIN = "min "
"""Prefix for the minimum of a metric over all runs."""

MIN_COVERAGE = 0.99
"""Minimum coverage of a finished run."""

METRICS = (
    "steps", "coverage", "map_accuracy", "mean_map_accuracy", "worst_map_accuracy",
    "t50", "t90", "t99", "overlap", "finished", "first_robot",
    "claimed_map_accuracy", "claimed_mean_map_accuracy", "claimed_worst_map_accuracy",
    "claimed_wall_precision", "claimed_wall_recall", "claimed_wall_f1",
    "claimed_mean_wall_precision", "claimed_mean_wall_recall", "claimed_mean_wall_f1",
    "claimed_worst_wall_precision", "claimed_worst_wall_recall", "claimed_worst_wall_f1",
    "walls_within_tolerance", "worst_walls_within_tolerance", "tolerance",
    "approximation_error", "approximation_error_net", "explored_at", "robots", "seed", "range_m", "raw_scan_bytes",
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
    """The layout of a table.

    Attributes
    ----------
    rows, columns : list of str
        Keys of the grid, or ``variant``, that label rows and columns; the metrics are averaged over the other keys.
        Without columns each metric has a column of its own. In an experiment's file, the rows are by default all keys.
    values : list of str
        Metrics.
    interval : bool
        Whether means are printed with half their 95 % interval (Student's t).
    finished_only : bool
        Whether means include only finished runs; the table then shows their number if it differs.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    rows: list[str] | None = None
    columns: list[str] = field(default_factory=lambda: [VARIANT])
    values: Annotated[list[str], Field(min_length=1)] = field(default_factory=lambda: [*DEFAULT_METRICS])
    interval: Annotated[bool, Field(strict=True)] = False
    finished_only: Annotated[bool, Field(strict=True)] = False

    @property
    def keys(self) -> list[str]:
        """The keys of rows and columns."""
        return [*(self.rows or []), *self.columns]


def check_table(table: Table, grid: Iterable[str], variants: Iterable[str], metrics: Iterable[str]) -> None:
    """Raise ValueError if a table names a key, a variant or a metric that its experiment does not have."""
    known = [*grid, VARIANT]
    for key in table.keys:
        if key not in known:
            raise ValueError(f"table names {key!r}, which is not in the grid; there are: {', '.join(known)}")
    for value in table.values:
        check(value, variants, metrics)


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
    """The lines of a table: a header, a line per row with means over all other keys, and a line for all rows."""
    cells = _cells(table, runs, table.keys)
    labels = table.rows or []
    rows = list(dict.fromkeys(tuple(cell[key] for key in labels) for cell, _ in cells))
    heads = list(dict.fromkeys(tuple(cell[key] for key in table.columns) for cell, _ in cells))
    found = {tuple(cell.values()): statistics for cell, statistics in cells}
    over_all = {tuple(cell.values()): statistics for cell, statistics in _cells(table, runs, table.columns)}
    split = not table.columns
    lines = [[*labels, *(table.values if split else map("/".join, heads))]]
    for row in [*rows, None] if labels else rows:
        texts = list(row) if row is not None else ["all", *[""] * (len(labels) - 1)]
        for head in heads:
            statistics = over_all[head] if row is None else found.get((*row, *head), [])
            shown = [_text(table, each) for each in statistics] or ["-"] * len(table.values)
            texts += shown if split else [" ".join(shown)]
        lines.append(texts)
    return lines


def described(table: Table, runs: Sequence[Row]) -> pl.DataFrame:
    """Statistics of each cell and metric of a table: number of runs, share finished, mean with interval, quartiles.

    Cells are the combinations of the table's rows and columns.
    """
    cells = _cells(table, runs, table.keys)
    return pl.DataFrame(
        [cell | statistics for cell, each in cells for statistics in each], infer_schema_length=None
    )


def _cells(
    table: Table, runs: Sequence[Row], keys: Sequence[str]
) -> list[tuple[dict[str, str], list[dict[str, Any]]]]:
    """For each combination of the keys' values, in the order of the grid, the statistics of all metrics."""
    twins = {key_of(run["place"]): run for run in runs}
    members: dict[tuple[str, ...], list[Row]] = {}
    for run in runs:
        members.setdefault(tuple(short(run["place"][key]) for key in keys), []).append(run)
    return [
        (dict(zip(keys, cell, strict=True)), [_statistics(table, name, some, twins) for name in table.values])
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


def _text(table: Table, statistics: dict[str, Any]) -> str:
    """The mean or minimum of a metric over some runs, as text."""
    n, mean, runs = statistics["n"], statistics["mean"], statistics["runs"]
    if statistics["metric"].startswith(MIN):
        return f"{statistics['min']:.4f}" if n else "-"
    finished = round(statistics["finished"] * runs)
    part = f" ({finished} of {runs})" if table.finished_only and finished < runs else ""
    if not n:
        return ("none" if part and not finished else "-") + part
    digits = 0 if abs(mean) >= 10 else 3
    half = f" ± {(statistics['high'] - mean):.{digits}f}" if table.interval and n > 1 else ""
    return f"{mean:.{digits}f}{half}{part}"


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
    twin = twins.get(key_of(summary["place"] | {VARIANT: against}))
    other = metric_value(twin, name) if twin is not None else None
    return value / other if other else None


def short(value: object) -> str:
    """A value of the grid as a label; for files the name."""
    return Path(value).stem if isinstance(value, str) and value.endswith((".yaml", ".png")) else str(value)


def _look_up(row: Row, name: str) -> Any:
    """A column of a row; 0 for a missing value of a nested table, which holds only nonzero values."""
    value = row.get(name)
    return 0 if value is None and name.rpartition(".")[0] in TABLES else value
