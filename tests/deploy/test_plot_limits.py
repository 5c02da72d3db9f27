"""Figures show all their data: every point lies within the limits of its axes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.after import archive, figures
from deploy.after.archive import Archive
from deploy.run.exploration import explore
from deploy.scenario.scenario import parse
from deploy.study import plots
from deploy.study.plots import Plot
from deploy.study.results import Results
from tests.deploy.figure_checks import assert_shows_all, assert_text_fits
from tests.deploy.small_run import hall
from tests.worldsim.recorded.made_logs import write_carmen


def rows(metric: str, scales: dict[str, float]) -> list[dict[str, Any]]:
    """Five runs per panel, team size and strategy, whose metric has another scale in each panel."""
    return [
        {"key": f"{panel}{robots}{line}{run}", "place": {"map": panel, "robots": robots, "variant": line},
         "finished": True, "coverage": 1.0, metric: scale / robots * (1 + run / 10)}
        for panel, scale in scales.items() for robots in (1, 2, 4) for line in ("a", "b") for run in range(5)
    ]  # fmt: skip


@pytest.mark.parametrize(
    "scales", [{"small": 100.0, "large": 2000.0}, {"large": 2000.0, "small": 100.0}], ids=str
)
@pytest.mark.parametrize("log", [False, True])
@pytest.mark.parametrize("kind", ["lines", "boxes"])
def test_panels_of_different_scales_show_all_points(kind: Any, log: bool, scales: dict[str, float]) -> None:
    plot = Plot("steps", "robots", kind, panels="map", log=log)
    assert_shows_all(plots.draw(plot, rows("steps", scales), Results(None)))


def test_intervals_of_means_of_few_runs_end_where_no_run_can_be() -> None:
    steps = [
        {
            "key": f"{run}",
            "place": {"robots": 2, "variant": "a"},
            "finished": True,
            "coverage": 1.0,
            "steps": at,
        }
        for run, at in enumerate((10.0, 200.0))
    ]
    (panel,) = plots.draw(Plot("steps", "robots"), steps, Results(None)).axes
    assert panel.get_ylim()[0] == 0
    shares = [row | {"coverage": share} for row, share in zip(steps, (0.99, 1.0), strict=True)]
    (panel,) = plots.draw(Plot("coverage", "robots"), shares, Results(None)).axes
    assert panel.get_ylim()[1] < 1.1


def test_lines_of_one_value_lie_beside_each_other() -> None:
    runs = [row for row in rows("steps", {"one": 100.0}) if row["place"]["robots"] == 2]
    (panel,) = plots.draw(Plot("steps", "robots"), runs, Results(None)).axes
    places = {
        float(line.get_xdata()[0]) for line in panel.get_lines() if line.get_marker() in plots.MARKERS[:2]
    }
    assert len(places) == 2


def test_shares_up_to_the_whole_are_shown() -> None:
    assert_shows_all(plots.draw(Plot("coverage", "robots"), rows("other", {"one": 1.0}), Results(None)))


def test_curves_of_runs_of_different_lengths_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    results, runs = Results(None), rows("steps", {"small": 10.0, "large": 200.0})
    series = {row["key"]: np.linspace(0, 1, int(row["steps"])).tolist() for row in runs}
    monkeypatch.setattr(results, "series", lambda _, keys: {key: series[key] for key in keys})
    assert_shows_all(plots.draw(Plot("explored", kind="curves", panels="map"), runs, results))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Archive:
    out = tmp_path_factory.mktemp("run") / "one"
    settings = {"robots": 3, "bandwidth": 60, "steps": 40, "seed": 2, "bus": "memory", "map": "office"}
    explore(parse(settings), out=out)
    return archive.read(out)


def test_bars_are_seen_below_a_budget_that_is_far_above(tmp_path: Path) -> None:
    for bandwidth, is_drawn in ((60, True), (1_000_000, False)):
        settings = {"robots": 2, "bandwidth": bandwidth, "steps": 5, "bus": "memory", "map": "office"}
        explore(parse(settings), out=tmp_path / f"{bandwidth}")
        archives = {"one": archive.read(tmp_path / f"{bandwidth}")}
        (_, load, *_), (_, other) = (
            figure.axes for figure in (figures.channel_load(archives["one"]), figures.compared(archives))
        )
        for panel in (load, other):
            assert (panel.get_ylim()[1] >= bandwidth) == is_drawn
            labels = panel.get_legend_handles_labels()[1]
            assert any("1,000,000 bytes per step, far above" in label for label in labels) != is_drawn


def test_figures_of_a_run_show_all_points(run: Archive) -> None:
    drawn = (
        figures.channel_load(run),
        figures.compared({"one": run, "other": run}),
        figures.maps_over_time(run),
    )
    for figure in drawn:
        assert_shows_all(figure)
        assert_text_fits(figure)


def test_a_long_corridor_has_room_for_its_labels(tmp_path: Path) -> None:
    settings = hall(tmp_path / "corridor.png", 7, 400) | {"robots": 2, "steps": 30}
    explore(parse(settings), out=tmp_path / "run")
    figure = figures.maps_over_time(archive.read(tmp_path / "run"))
    assert_text_fits(figure)


def test_a_run_of_one_step_is_drawn(tmp_path: Path) -> None:
    explore(parse({"robots": 2, "steps": 1, "bus": "memory", "map": "leader-rooms"}), out=tmp_path / "run")
    figure = figures.channel_load(archive.read(tmp_path / "run"))
    assert_text_fits(figure)
    explored, transmitted, *_ = figure.axes
    assert explored.get_xlim() == (0.5, 1.5)
    assert [tick for tick in explored.get_xticks() if 0.5 <= tick <= 1.5] == [1.0]
    assert {line.get_marker() for line in explored.lines} == {"o"}
    assert all(np.ptp(patch.get_path().vertices[:, 0]) == 1 for patch in transmitted.patches)


def test_maps_over_time_of_a_tall_map_fit_a_picture_of_common_size(tmp_path: Path) -> None:
    settings = hall(tmp_path / "shaft.png", 400, 30) | {"robots": 9, "steps": 12}
    explore(parse(settings), out=tmp_path / "run")
    figure = figures.maps_over_time(archive.read(tmp_path / "run"))
    assert_text_fits(figure)
    assert figure.get_figheight() < 35
    assert figure.get_suptitle() == "Planning maps of robots 0 to 7 of 9"


def test_intervals_of_a_share_are_within_0_and_1(monkeypatch: pytest.MonkeyPatch) -> None:
    results, runs = Results(None), rows("steps", {"one": 10.0})
    series = {row["key"]: [0.1, 0.2 + 0.19 * (number % 5)] for number, row in enumerate(runs)}
    monkeypatch.setattr(results, "series", lambda _, keys: {key: series[key] for key in keys})
    figure = plots.draw(Plot("explored", kind="curves", panels="map"), runs, results)
    assert_shows_all(figure)
    low, high = figure.axes[0].get_ylim()
    assert low == 0.0 and 1.0 <= high < 1.05


def test_shares_of_a_replayed_log_refer_to_the_map_of_all_scans(tmp_path: Path, run: Archive) -> None:
    log = str(write_carmen(tmp_path / "room.log", scans=4))
    explore(parse({"recording": {"files": [log]}, "robots": 2, "bus": "memory"}), out=tmp_path / "played")
    played = archive.read(tmp_path / "played")
    assert figures.channel_load(played).axes[0].get_ylabel() == "% of the map of all scans"
    assert figures.channel_load(run).axes[0].get_ylabel() == "% of the reachable area"
    both = figures.compared({"played": played, "run": run}).axes[0].get_ylabel()
    assert both == "% of the map of all scans or the reachable area, seen by the team"
