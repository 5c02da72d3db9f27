"""Figures of all claims, of made-up runs: all data is shown, no text is cut or overlaps, axes have units."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.study import experiment, labels, plots
from deploy.study.experiment import SHIPPED, Experiment
from deploy.study.figure_style import FigureStyle
from deploy.study.plots import Plot
from deploy.study.results import Results
from deploy.study.tables import METRICS, TABLES
from tests.deploy.figure_checks import assert_has_units, assert_shows_all, assert_text_fits

COLUMN = FigureStyle(figure_width=8.8, font="serif", font_size=8)
"""A column of a paper."""

PLOTS = [
    pytest.param(read, plot, id=f"{read.name}-{number}")
    for read in map(experiment.read, sorted(SHIPPED.glob("*.toml")))
    for number, plot in enumerate(read.plots, 1)
]


def made_up(read: Experiment, plot: Plot) -> list[dict[str, Any]]:
    """Three runs per setting, whose scales differ by up to 2000 between panels, in either order."""
    used = dict.fromkeys((plot.panels, plot.lines, plot.x, *plot.where))
    keys = [key for key in used if key and key != "variant"]
    values = [[value[key] if isinstance(value, dict) else value for value in read.grid[key]] for key in keys]
    rows: list[dict[str, Any]] = []
    for *place, variant in product(*values, read.variants):
        named = dict(zip(keys, place, strict=True)) | {"variant": variant}
        panel = str(named.get(plot.panels))
        scale = 2000.0 if sum(map(ord, panel)) % 2 else 1.0
        rows += [
            {"key": f"{len(rows)}-{seed}", "place": named | {"seed": seed}, "finished": True, "coverage": 1.0}
            | {name: scale * (0.9 + 0.1 * seed + 0.03 * (len(rows) % 7)) for name in names(plot)}
            for seed in range(3)
        ]
    return rows


def names(plot: Plot) -> list[str]:
    return plot.y.replace(" / ", " + ").split(" + ")


class MadeUp(Results):
    """Series of runs that end at different steps; the interval of their mean exceeds 1."""

    def __init__(self) -> None:
        super().__init__(None)

    def series(self, name: str, keys: Any) -> dict[str, list[float]]:
        lengths = {key: 30 + 17 * int(key[-1]) + 40 * (int(key[:-2]) % 2) for key in keys}
        return {
            key: np.linspace(0.1, 1 if name == "explored" else 900, n).tolist() for key, n in lengths.items()
        }


@pytest.mark.parametrize(("read", "plot"), PLOTS)
def test_a_figure_of_a_claim_shows_all_data_and_text(read: Experiment, plot: Plot) -> None:
    figure = plots.draw(plot, made_up(read, plot), MadeUp())
    assert_shows_all(figure)
    assert_text_fits(figure)
    assert_has_units(figure)


@pytest.mark.parametrize(
    ("read", "plot"),
    [each for each in PLOTS if each.id in ("claim-B4-1", "claim-F4-1", "claim-M4-1", "claim-M1-1", "rate-1")],
)
def test_a_figure_in_a_column_of_a_paper_shows_all_data_and_text(read: Experiment, plot: Plot) -> None:
    figure = plots.draw(plot, made_up(read, plot), MadeUp(), COLUMN)
    assert figure.get_figwidth() == pytest.approx(8.8 / 2.54)
    assert_shows_all(figure)
    assert_text_fits(figure)
    assert {text.get_fontsize() for axes in figure.axes for text in axes.get_xticklabels()} == {8}


def test_every_metric_has_a_unit_or_counts() -> None:
    counts = {"first_robot", "seed", "robots"}
    for name in (*METRICS, *(f"{table}.{name}" for table, many in TABLES.items() for name in many)):
        assert labels.unit(name) or name in counts, name


@pytest.mark.parametrize(
    ("metric", "label"),
    [
        ("steps", "exploration time (steps)"),
        ("bytes.total", "transmitted (bytes)"),
        ("bytes.conn / bytes.total", "conn bytes / transmitted (ratio)"),
        ("bytes.total / steps", "transmitted / exploration time (bytes per step)"),
        ("steps relative to scans", "exploration time, relative to scans (ratio)"),
        ("claimed_worst_wall_f1", "claimed worst wall f1 (share)"),
        ("robots", "number of robots"),
    ],
)
def test_labels_of_metrics_have_units(metric: str, label: str) -> None:
    assert labels.label(metric) == label


def test_negative_values_and_intervals_are_shown() -> None:
    rows = [
        {
            "key": str(n),
            "place": {"robots": 1 + n % 2, "variant": "a"},
            "finished": True,
            "coverage": 1.0,
            "steps": y,
        }
        for n, y in enumerate((-5.0, 3.0, 4.0, -1.0))
    ]
    figure = plots.draw(Plot("steps", "robots"), rows, Results(None))
    assert_shows_all(figure)
    assert figure.axes[0].get_ylim()[0] < 0


def test_figures_are_written_in_all_formats_with_equal_bytes(tmp_path: Path) -> None:
    style = FigureStyle(("pdf", "svg", "tex"))
    rows = [
        {"key": str(n), "place": {"robots": n, "variant": "a"}, "finished": True, "coverage": 1.0, "steps": n}
        for n in range(1, 4)
    ]
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        style.save(
            plots.draw(Plot("steps", "robots"), rows, Results(None), style), tmp_path / folder / "figure.png"
        )
    written = {file.name: file.read_bytes() for file in (tmp_path / "one").iterdir()}
    assert sorted(written) == ["figure.pdf", "figure.png", "figure.svg"]
    assert written == {file.name: file.read_bytes() for file in (tmp_path / "other").iterdir()}
    assert written["figure.pdf"].startswith(b"%PDF") and b"/Type3" not in written["figure.pdf"]
    assert b"<svg" in written["figure.svg"]
