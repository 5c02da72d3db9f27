"""Tables of means: what a sweep prints of its runs' summaries.

A figure is a name in a summary (``steps``), dotted for what stands in a table (``bytes.total``), a sum of names
(``bytes.ins + bytes.del``), or a quotient of two of these (``bytes.conn / bytes.total``). Behind it may stand
``relative to`` and a variant, by whose figure of the same run it is divided.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from netshaper.ledger import CAUSES
from protocol.packets import ALL_KINDS

VARIANT = "variant"

RELATIVE = " relative to "
"""Between a figure and the variant whose figure of the same run it is divided by."""

FIGURES = (
    "steps", "coverage", "map_agreement", "t50", "t90", "t99", "overlap", "finished", "first_robot",
    "approximation_error", "robots", "seed", "range_m", "raw_scan_bytes", "wire_bytes", "over_budget_steps", "faults",
    "wall_s", "steps_per_s", "work_us_median",
)  # fmt: skip
"""Numbers of a summary (`deploy.record.summary.summarise`)."""

TABLES = {
    "bytes": (*ALL_KINDS, "total"),
    "packets": (*ALL_KINDS, "total"),
    "undelivered": tuple(cause for cause in CAUSES if cause),
}
"""Tables of a summary with the numbers in them; those that are left out are 0."""


@dataclass(frozen=True)
class Table:
    """What a table shows.

    Attributes
    ----------
    rows, columns : list of str
        Parts of a run's place that head the table's rows and columns; the rest is averaged over. Without
        columns each figure has one of its own.
    values : list of str
        Figures.
    """

    rows: list[str]
    columns: list[str]
    values: list[str]


def check(text: str, variants: Iterable[str]) -> None:
    """Raise ValueError if `text` is no figure, or is relative to none of the variants."""
    name, relative, against = text.partition(RELATIVE)
    if relative and against not in variants:
        raise ValueError(f"{text!r}: no variant is called {against!r}; there are: {', '.join(variants)}")
    parts = name.split(" / ")
    if len(parts) > 2:
        raise ValueError(f"{text!r}: must be sums of figures with at most one ' / ' between")
    for one in (one for part in parts for one in part.split(" + ")):
        table, _, number = one.rpartition(".")
        if number not in (TABLES.get(table, ()) if table else FIGURES):
            tables = (f"{table}.{'|'.join(numbers)}" for table, numbers in TABLES.items())
            raise ValueError(f"{one!r} is no figure; there are: {', '.join([*FIGURES, *tables])}")


def figure(summary: dict[str, Any], text: str) -> float | None:
    """Read a figure, not a relative one, from a summary; None where it has none, or a quotient is by 0."""
    sums = []
    for part in text.split(" / "):
        found = [_look_up(summary, name) for name in part.split(" + ")]
        if None in found:
            return None
        sums.append(float(sum(found)))
    if len(sums) == 1:
        return sums[0]
    return sums[0] / sums[1] if sums[1] else None


def tabulate(table: Table, summaries: Sequence[dict[str, Any]]) -> list[list[str]]:
    """The lines of a table: one of heads, then one a row, means over all else, and one over all rows."""
    twins = {_key(summary["place"]): summary for summary in summaries}
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
            means = [_mean([_value(s, value, twins) for s in chosen]) for value in table.values]
            cells += means if split else [" ".join(means)]
        lines.append(cells)
    return lines


def _value(summary: dict[str, Any], text: str, twins: dict[Any, dict[str, Any]]) -> float | None:
    """A figure, in relation to that of another variant's run if the text says so and that run is there."""
    name, _, against = text.partition(RELATIVE)
    value = figure(summary, name)
    if not against or value is None:
        return value
    twin = twins.get(_key(summary["place"] | {VARIANT: against}))
    other = figure(twin, name) if twin is not None else None
    return value / other if other else None


def _key(place: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    return tuple(sorted((name, repr(value)) for name, value in place.items()))


def _combinations(summaries: Sequence[dict[str, Any]], keys: list[str]) -> list[tuple[Any, ...]]:
    """All combinations of some keys' values, in the order of the grid."""
    found = (tuple(summary["place"][key] for key in keys) for summary in summaries)
    return list({repr(values): values for values in found}.values())


def _short(value: object) -> str:
    return Path(value).stem if isinstance(value, str) and value.endswith(".yaml") else str(value)


def _mean(values: Sequence[float | None]) -> str:
    found = [value for value in values if value is not None]
    if not found:
        return "-"
    mean = float(np.mean(found))
    return f"{mean:.0f}" if abs(mean) >= 10 else f"{mean:.3f}"


def _look_up(summary: dict[str, Any], name: str) -> Any:
    table, _, number = name.rpartition(".")
    return summary[table].get(number, 0) if table else summary[number]
