"""Metrics of runs, and the tables of metrics that a sweep prints and writes.

A metric is a column of the table of runs (``steps``), dotted for a nested value (``bytes.total``); a sum of columns
(``bytes.ins + bytes.del``); or a quotient of two of these (``bytes.conn / bytes.total``). ``relative to`` and a variant
divide it by the metric of that variant's run with otherwise equal settings. The prefix ``min`` means the minimum over
all runs instead of their mean.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from deploy.study.results import Row
from deploy.study.statistics import five_numbers, interval, share
from netshaper.ledger import CAUSES
from protocol.packets import ALL_KINDS

VARIANT = "variant"

RELATIVE = " relative to "
"""Separates a metric from the variant by whose metric it is divided."""

MIN = "min "
"""Prefix for the minimum of a metric over all runs."""

MIN_COVERAGE = 0.99
"""Minimum coverage of a finished run."""

METRICS = (
    "steps", "coverage", "map_accuracy", "t50", "t90", "t99", "overlap", "finished", "first_robot",
    "wall_precision", "wall_recall", "worst_wall_precision", "worst_wall_recall",
    "approximation_error", "approximation_error_net", "explored_at", "robots", "seed", "range_m", "raw_scan_bytes",
    "wire_bytes", "over_budget_steps", "protocol_errors", "wall_s", "steps_per_s", "work_us_median",
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
        Without columns each metric has a column of its own.
    values : list of str
        Metrics.
    interval : bool
        Whether means are printed with half their 95 % interval (Student's t).
    finished_only : bool
        Whether means include only finished runs; the table then shows their number if it differs.
    """

    rows: list[str]
    columns: list[str]
    values: list[str]
    interval: bool = False
    finished_only: bool = False


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


def tabulate(table: Table, summaries: Sequence[Row]) -> list[list[str]]:
    """The lines of a table: a header, a line per row with means over all other keys, and a line for all rows."""
    twins = {key_of(summary["place"]): summary for summary in summaries}
    heads = _combinations(summaries, table.columns)
    rows = _combinations(summaries, table.rows)
    split = not table.columns
    names = table.values if split else ["/".join(map(_short, head)) for head in heads]
    lines = [[*table.rows, *names]]
    for row in (*rows, None) if table.rows else rows:
        cells = list(map(_short, row)) if row is not None else ["all", *[""] * (len(table.rows) - 1)]
        for head in heads:
            chosen = [
                s
                for s in summaries
                if (row is None or tuple(s["place"][key] for key in table.rows) == row)
                and tuple(s["place"][key] for key in table.columns) == head
            ]
            shown = [_cell(table, chosen, value, twins) for value in table.values]
            cells += shown if split else [" ".join(shown)]
        lines.append(cells)
    return lines


def described(table: Table, rows: Sequence[Row], keys: Sequence[str] | None = None) -> pl.DataFrame:
    """Statistics of each cell and metric of a table: number of runs, share finished, mean with interval, quartiles.

    Cells are the combinations of the table's rows and columns, or of other `keys`.
    """
    twins = {key_of(row["place"]): row for row in rows}
    keys = [*table.rows, *table.columns] if keys is None else keys
    lines = []
    for cell in _combinations(rows, list(keys)):
        members = [row for row in rows if tuple(row["place"][key] for key in keys) == cell]
        counted = [row for row in members if has_finished(row)] if table.finished_only else members
        finished = share(sum(has_finished(row) for row in members), len(members))
        for name in table.values:
            values = [v for row in counted if (v := _value(row, name.removeprefix(MIN), twins)) is not None]
            mean = interval(values)
            low, first, median, third, high = five_numbers(values)
            lines.append(
                {key: _short(value) for key, value in zip(keys, cell, strict=True)}
                | {
                    "metric": name, "runs": len(members), "finished": finished.mean, "finished_low": finished.low,
                    "finished_high": finished.high, "n": mean.n, "mean": mean.mean, "low": mean.low, "high": mean.high,
                    "min": low, "quartile_1": first, "median": median, "quartile_3": third, "max": high,
                }
            )  # fmt: skip
    return pl.DataFrame(lines, infer_schema_length=None)


def has_finished(row: Row) -> bool:
    """Whether a run ended as explored with sufficient coverage; always true for other measures."""
    return row.get("finished") is None or (bool(row["finished"]) and row["coverage"] >= MIN_COVERAGE)


def key_of(place: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    """A position in a grid as a hashable key."""
    return tuple(sorted((name, repr(value)) for name, value in place.items()))


def _cell(table: Table, runs: Sequence[Row], value: str, twins: dict[Any, Row]) -> str:
    """The mean or minimum of a metric over some runs, as text."""
    name = value.removeprefix(MIN)
    if name != value:
        found = [one for run in runs if (one := _value(run, name, twins)) is not None]
        return f"{min(found):.4f}" if found else "-"
    chosen = [run for run in runs if has_finished(run)] if table.finished_only else runs
    share = "" if len(chosen) == len(runs) else f" ({len(chosen)} of {len(runs)})"
    values = [_value(run, name, twins) for run in chosen]
    return (_mean(values, interval_too=table.interval) if chosen or not share else "none") + share


def _value(summary: Row, text: str, twins: dict[Any, Row]) -> float | None:
    """A metric, divided by that of another variant's run if the text requests it and that run exists."""
    name, _, against = text.partition(RELATIVE)
    value = metric_value(summary, name)
    if not against or value is None:
        return value
    twin = twins.get(key_of(summary["place"] | {VARIANT: against}))
    other = metric_value(twin, name) if twin is not None else None
    return value / other if other else None


def _combinations(summaries: Sequence[Row], keys: list[str]) -> list[tuple[Any, ...]]:
    """All combinations of the keys' values, in the order of the grid."""
    found = (tuple(summary["place"][key] for key in keys) for summary in summaries)
    return list({repr(values): values for values in found}.values())


def _short(value: object) -> str:
    return Path(value).stem if isinstance(value, str) and value.endswith(".yaml") else str(value)


def _mean(values: Sequence[float | None], *, interval_too: bool) -> str:
    mean = interval([value for value in values if value is not None])
    if not mean.n:
        return "-"
    digits = 0 if abs(mean.mean) >= 10 else 3
    text = f"{mean.mean:.{digits}f}"
    return f"{text} ± {mean.half:.{digits}f}" if interval_too and mean.n > 1 else text


def _look_up(row: Row, name: str) -> Any:
    """A column of a row; 0 for a missing value of a nested table, which holds only nonzero values."""
    value = row.get(name)
    return 0 if value is None and name.rpartition(".")[0] in TABLES else value
