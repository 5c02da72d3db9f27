"""Plots of many runs: a metric over a key of the grid, box plots, and curves over time.

An experiment's file describes a plot::

    [[plot]]
    kind = "lines"          # means with 95 % intervals; "curves": a series over the steps; "boxes": the median,
                            # quartiles and extremes
    x = "robots"            # not for curves
    y = "steps"
    lines = "variant"       # one line, box or curve per value
    panels = "map"          # one panel per value
    where = { robots = [3, 5] }  # only these runs; all by default
    xlabel = "robots"       # by default the name of the key with its unit
    ylabel = "exploration time (steps)"

All panels have the same y axis, and show all data. The x axis is logarithmic if the values of `x` are spaced too
unevenly for another one.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from deploy.study import figure_layout, labels
from deploy.study.figure_style import DEFAULT, FigureStyle
from deploy.study.measures import SERIES
from deploy.study.results import PLACE, Results, Row
from deploy.study.statistics import interval
from deploy.study.tables import VARIANT, check, check_keys, has_finished, levels_of, metric_value, names_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

LINES: Final = "lines"
BOXES: Final = "boxes"
CURVES: Final = "curves"

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#555555", "#a07000")
"""The palette of Okabe and Ito, which color-blind readers can distinguish."""
MARKERS = "osD^vP*X"
DASHES = ("-", "--", "-.", ":")

SHARES = ("explored", "coverage", "finished")
"""Metrics whose axis ends at 1, or just above it."""

CURVE_POINTS = 200

Level = tuple[Any, str]
"""A value of a key, and its label."""


@dataclass(frozen=True)
class Plot:
    """The description of a plot; see the module's description."""

    y: str
    x: str = ""
    kind: Literal["lines", "boxes", "curves"] = LINES
    lines: str = VARIANT
    panels: str = ""
    where: dict[str, list[Any]] = field(default_factory=dict)
    xlabel: str = ""
    ylabel: str = ""
    log: bool = False
    finished_only: bool = True


def check_plot(plot: Plot, grid: Iterable[str], metrics: Iterable[str]) -> None:
    """Raise ValueError if a plot names a key, a metric or a series that its experiment does not have."""
    named = {"x": [plot.x], "lines": [plot.lines], "panels": [plot.panels], "where": plot.where}
    for name, keys in named.items():
        check_keys(f"plot.{name}", filter(None, keys), grid)
    if plot.kind == CURVES and plot.y not in SERIES:
        raise ValueError(f"plot.y = {plot.y!r}: is not a series; there are: {', '.join(SERIES)}")
    if plot.kind != CURVES:
        check(plot.y, (), metrics)
    if plot.kind == LINES and not plot.x:
        raise ValueError("plot.x is missing: lines are drawn over a key of the grid")


def draw(plot: Plot, rows: Sequence[Row], results: Results, style: FigureStyle = DEFAULT) -> Figure:
    """Draw the runs of an experiment; `results` holds their series."""
    from matplotlib.figure import Figure  # noqa: PLC0415  half a second to import

    rows = [row for row in rows if all(row[PLACE][key] in plot.where[key] for key in plot.where)]
    panels = list(_named(rows, plot.panels)) or [(None, "")]
    lines = list(_named(rows, plot.lines))
    columns, (width, height) = style.layout(len(panels))
    across = math.ceil(len(panels) / columns)
    with style.applied():
        canvas = Figure(figsize=(width * columns, height * across), layout="constrained")
        grid = canvas.subplots(across, columns, sharey=True, squeeze=False).ravel()
        axes, unused = list(grid[: len(panels)]), grid[len(panels) :]
        for panel, (shown, name) in zip(axes, panels, strict=True):
            painter = {LINES: _lines, BOXES: _boxes, CURVES: _curves}[plot.kind]
            if rows:
                painter(panel, plot, _of(rows, plot.panels, shown), lines, results)
            else:
                panel.set_title("no runs")
            if shown is not None:
                panel.set_title(labels.level(plot.panels, shown, name))
            panel.set_xlabel(_x_label(plot, rows))
            panel.grid(visible=True, color="#e5e5e5", linewidth=0.6)
            panel.set_axisbelow(True)
            panel.spines[["top", "right"]].set_visible(False)
        for panel in unused:
            panel.set_axis_off()
        for panel in axes[::columns]:
            panel.set_ylabel(plot.ylabel or labels.label(plot.y))
        _set_limits(plot, axes)
        entries = {
            name: handle
            for panel in axes
            for handle, name in zip(*panel.get_legend_handles_labels(), strict=True)
        }
        is_needed = len(entries) > 1 and plot.lines != plot.panels
        legend = partial(_legend, canvas, entries, plot.lines) if is_needed else None
        figure_layout.fit(canvas, axes, legend, len(entries))
    return canvas


def _set_limits(plot: Plot, axes: Sequence[Axes]) -> None:
    """Set the limits of the y axis, which all panels share, so that it has all their data and begins at 0."""
    if plot.log:
        axes[0].set_yscale("log")
        return
    bounds = [bound for panel in axes for bound in panel.dataLim.intervaly if math.isfinite(bound)]
    low, high = min([0.0, *bounds]), max([0.0, *bounds])
    if plot.y in SHARES or high == low:
        high = max(high, 1.0)
    margin = (0.02 if plot.y in SHARES else 0.05) * (high - low)
    axes[0].set_ylim(low - margin * (low < 0), high + margin)


def _x_label(plot: Plot, rows: Sequence[Row]) -> str:
    if plot.xlabel or not (plot.x or plot.kind == CURVES):
        return plot.xlabel
    if plot.kind == CURVES:
        return "time (steps)"
    if all(str(value).endswith("%") for value in levels_of(rows, plot.x)):
        return "communication range (% of the diagonal)"
    return labels.label(plot.x)


def _legend(canvas: Figure, entries: dict[str, Any], key: str, columns: int) -> Legend:
    """Draw the legend below all panels."""
    return canvas.legend(
        entries.values(), entries.keys(), loc="outside lower center", ncols=columns, frameon=False,
        title=None if key == VARIANT else labels.label(key),
    )  # fmt: skip


def as_html(canvas: Figure) -> str:
    """A picture as HTML for a notebook."""
    file = io.BytesIO()
    DEFAULT.write(canvas, "png", file)
    return f'<img src="data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}">'


def _lines(panel: Axes, plot: Plot, rows: Sequence[Row], lines: Sequence[Level], _: Results) -> None:
    levels = levels_of(rows, plot.x)
    numbers = [number for level in levels if (number := _number(level)) is not None]
    is_axis = len(numbers) == len(levels) and numbers == sorted(numbers)
    places = np.array(numbers if is_axis else range(len(levels)), float)
    is_log = is_axis and figure_layout.spread(numbers)
    shown = np.log(places) if is_log else places
    nudge = 0.02 * (np.ptp(shown) if len(shown) > 1 else 1.0)
    for n, (line, name) in enumerate(lines):
        of_line = _of(rows, plot.lines, line)
        means = [interval(_metrics(plot, _of(of_line, plot.x, level))) for level in levels]
        there = np.array([bool(mean.n) for mean in means], np.bool_)
        if there.any():
            middle, low, high = np.array([(m.mean, m.low, m.high) for m in means if m.n]).T
            low = np.where(middle < 0, low, np.maximum(low, 0.0))
            high = np.minimum(high, 1.0) if plot.y in SHARES else high
            at = shown + nudge * (n - (len(lines) - 1) / 2)
            panel.errorbar(
                (np.exp(at) if is_log else at)[there],
                middle,
                np.nan_to_num([middle - low, high - middle]),
                label=name, color=COLORS[n % len(COLORS)],
                marker=MARKERS[n % len(MARKERS)], markersize=4, linewidth=1.3, capsize=2,
            )  # fmt: skip
    if is_log:
        panel.set_xscale("log")
        panel.minorticks_off()
    panel.set_xticks(places, [name for _, name in _named(rows, plot.x)])
    if len(places) == 1:
        panel.set_xlim(places[0] - 0.5, places[0] + 0.5)


def _boxes(panel: Axes, plot: Plot, rows: Sequence[Row], lines: Sequence[Level], _: Results) -> None:
    """A group of boxes for each value of `plot.x`; without it, one box for each line."""
    levels = levels_of(rows, plot.x) if plot.x else [None]
    step, width = (0.8 / len(lines), 0.64 / len(lines)) if plot.x else (1.0, 0.6)
    for n, (line, name) in enumerate(lines):
        color = COLORS[n % len(COLORS)]
        boxes = panel.boxplot(
            [_metrics(plot, _of(_of(rows, plot.x, level), plot.lines, line)) for level in levels],
            positions=[k + (n - (len(lines) - 1) / 2) * step for k in range(len(levels))], widths=width,
            whis=(0, 100), patch_artist=True, medianprops={"color": "black"}, manage_ticks=False,
        )  # fmt: skip
        for box in boxes["boxes"]:
            box.set_facecolor(color + "80")
        if plot.x:
            panel.plot([], [], color=color, linewidth=6, label=name)
    places = range(len(levels)) if plot.x else [n - (len(lines) - 1) / 2 for n in range(len(lines))]
    panel.set_xticks(places, [name for _, name in (_named(rows, plot.x) if plot.x else lines)])


def _curves(panel: Axes, plot: Plot, rows: Sequence[Row], lines: Sequence[Level], results: Results) -> None:
    """Means with 95 % intervals over the steps, within the possible values; a finished run keeps its last value."""
    most = 1.0 if plot.y in SHARES else math.inf
    for n, (line, name) in enumerate(lines):
        found = results.series(plot.y, {row["key"] for row in _of(rows, plot.lines, line)})
        series = [np.asarray(found[key]) for key in sorted(found) if len(found[key])]
        if not series:
            continue
        at = np.unique(np.linspace(0, max(map(len, series)) - 1, CURVE_POINTS).astype(int))
        means = [interval([values[min(step, len(values) - 1)] for values in series]) for step in at]
        color = COLORS[n % len(COLORS)]
        dashes = DASHES[n % len(DASHES)]
        panel.plot(at + 1, [m.mean for m in means], dashes, color=color, label=name, linewidth=1.4)
        low, high = np.clip([(m.low, m.high) for m in means], 0.0, most).T
        panel.fill_between(at + 1, low, high, color=color, alpha=0.2, linewidth=0)
    panel.set_xlim(left=0)


def _metrics(plot: Plot, rows: Sequence[Row]) -> list[float]:
    counted = [row for row in rows if has_finished(row)] if plot.finished_only else rows
    return [value for row in counted if (value := metric_value(row, plot.y)) is not None]


def _named(rows: Sequence[Row], key: str) -> Iterator[Level]:
    """Yield the values of a key, each with its label; without a key, a single value without a label."""
    if not key:
        yield None, ""
        return
    names = names_of(rows, key)
    for value in levels_of(rows, key):
        yield value, names[repr(value)]


def _of(rows: Sequence[Row], key: str, value: Any) -> list[Row]:
    """The rows with a value of a key; all rows if the value is None."""
    return [row for row in rows if value is None or row[PLACE][key] == value]


def _number(value: object) -> float | None:
    """A level as a number: 3, "2.5%"."""
    try:
        return None if isinstance(value, bool) else float(str(value).removesuffix("%"))
    except ValueError:
        return None
