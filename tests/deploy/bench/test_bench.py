"""Benchmarks: ratios to baselines of the same run, and baselines that compute the same results."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from agent.outline.contour import contours
from agent.outline.polygons import Polygons
from agent.planning.cost_field import costs
from agent.planning.frontier import Floor
from agent.strategies.registry import strategies
from deploy.bench import (
    baselines,
    explorations,
    field,
    kernels,
    registry,
    relay,
    replanning,
    scale,
)
from deploy.bench.measurement import Measurement, compare
from deploy.bench.registry import run_benchmarks
from deploy.commands.app import app
from protocol.grid import FREE, OCCUPIED, Cell, Grid, ray_table
from protocol.scans import draw
from worldsim import generators
from worldsim.laser import cast


def test_a_ratio_is_the_median_of_paired_repeats_with_its_interval() -> None:
    figure = compare("work", "ms", [1.0, 2.0, 3.0, 40.0], "rest", [2.0, 4.0, 6.0, 2.0])
    assert (figure.value, figure.ratio) == (2.5, 0.5)
    assert figure.interval is not None
    low, high = figure.interval
    assert low == 0.5 <= high <= 20
    assert figure == compare("work", "ms", [1.0, 2.0, 3.0, 40.0], "rest", [2.0, 4.0, 6.0, 2.0])


def test_a_line_names_the_baseline() -> None:
    line = compare("work", "ms", [1.0, 1.0], "rest", [2.0, 2.0]).line()
    assert " ".join(line.split()) == "work 1.00 ms 0.50 x rest [0.50, 0.50]"
    assert Measurement("memory", "MB", 44).line().split() == ["memory", "44.00", "MB"]


def test_help_names_every_benchmark() -> None:
    output = CliRunner().invoke(app, ["bench", "--help"]).stdout
    assert all(name in output for name in registry.BENCHMARKS)


def test_an_unknown_benchmark_is_rejected() -> None:
    with pytest.raises(
        ValueError, match=r"no benchmark is called 'speed'; there are: kernels, swarm, replanning"
    ):
        run_benchmarks(["swarm", "speed"], lambda _: None)


def _one_measurement() -> Iterator[Measurement]:
    yield compare("work", "ms", [1.0], "rest", [2.0])


def test_measurements_are_printed_as_text_or_as_json(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "BENCHMARKS", {"small": _one_measurement})
    output = CliRunner().invoke(app, ["bench", "small"]).stdout.splitlines()
    assert output[0] == "small:"
    assert output[1].split()[:3] == ["work", "1.00", "ms"]
    (figure,) = json.loads(CliRunner().invoke(app, ["bench", "small", "--json"]).stdout)
    assert figure["bench"] == "small"
    assert (figure["baseline"], figure["ratio"]) == ("rest", 0.5)


@pytest.mark.parametrize("package", ["cv2", "skimage"])
def test_a_missing_optional_package_is_named(monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    if package != "cv2":
        pytest.importorskip("cv2")
    monkeypatch.setitem(sys.modules, package, None)
    result = CliRunner().invoke(app, ["bench", "kernels"])
    assert result.exit_code == 2
    install = "pip install 'murmur-robots[bench]'"
    assert f"the benchmark needs the package {package}: {install}" in result.stderr


def test_kernels_are_compared_with_their_baselines(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cv2", reason="OpenCV is in the extra bench")
    pytest.importorskip("skimage", reason="scikit-image is in the extra bench")
    monkeypatch.delenv("MURMUR_MAPS", raising=False)
    monkeypatch.setattr(kernels, "ROBOTS", 3)
    monkeypatch.setattr(explorations, "SIDE_M", 10.0)
    figures = list(kernels.kernels())
    assert [(figure.name, figure.baseline) for figure in figures] == [
        ("scan, cast and drawn", "the same beams in numpy"),
        ("contours of a robot's map", "OpenCV's findContours"),
        ("contours, repair, refinement and edits", "encoding the whole map"),
        ("merging 2 teammates, all changed", "Algorithm 9 line by line"),
        ("merging 2 teammates, one changed", "all changed"),
        ("merging 2 teammates, none changed", "all changed"),
        ("costs to all cells", "skimage's MCP_Geometric"),
        ("predictive, encode a step", "drawing its scan"),
        ("predictive, decode a step", "drawing its scan"),
        ("estimating a scan of 1081 beams", "drawing an exact scan"),
        ("bound after a scan of 1081 beams", "bound on the whole map"),
        ("estimating a scan of 181 beams", "drawing an exact scan"),
        ("bound after a scan of 181 beams", "bound on the whole map"),
    ]
    for figure in figures:
        assert figure.value > 0 and figure.unit == "ms"
        assert figure.ratio is not None
        assert figure.interval is not None
        assert 0 < figure.interval[0] <= figure.ratio <= figure.interval[1]


def test_every_strategy_is_measured_and_restored_afterwards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("skimage", reason="scikit-image is in the extra bench")
    monkeypatch.setattr(replanning, "ROBOTS", 2)
    monkeypatch.setattr(replanning, "SIDE_M", 10.0)
    monkeypatch.setattr(replanning, "STEPS", 8)
    shipped = {
        name: kind for name, kind in strategies().items() if kind.__module__.startswith("agent.strategies.")
    }
    before = {name: dict(vars(kind)) for name, kind in shipped.items()}
    figures = list(replanning.replanning())
    names = [f"{name}, {statistic}" for name in strategies() for statistic in ("mean", "95th percentile")]
    assert [figure.name for figure in figures] == names
    assert len(before) > 10
    assert {name: dict(vars(kind)) for name, kind in shipped.items()} == before
    for figure in figures:
        assert figure.unit == "ms"
        assert figure.value > 0
        assert figure.ratio is not None
        assert figure.ratio > 0


def test_the_relay_is_measured_per_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relay, "STEPS", 5)
    monkeypatch.setattr(explorations, "SIDE_M", 10.0)
    monkeypatch.setattr(relay, "CASES", tuple(relay.CASES[n] | {"robots": 3 - n} for n in range(2)))
    figures = list(relay.relay())
    assert [figure.name for figure in figures] == [
        "relay, 3 robots, polygons, 1000: time per frame",
        "relay, 2 robots, scans, unlimited: time per frame",
    ]
    assert all(figure.unit == "us" and figure.baseline == "parsing its packets" for figure in figures)
    assert all(figure.value > 0 and (figure.ratio or 0) > 0 for figure in figures)


def test_the_requested_team_sizes_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(scale.SETTINGS, "steps", 6)
    monkeypatch.setattr(explorations, "SIDE_M", 15.0)
    monkeypatch.setattr(scale, "MAX_PROCESSES", 0)
    lines: list[str] = []
    figures = run_benchmarks(["scale"], lines.append, [2, 66])
    names = [figure["name"] for figure in figures]
    for team in (
        "2 robots, meier, polygons",
        "2 robots, meier, predictive",
        "66 robots, meier, targets",
        "66 robots, meier, predictive",
    ):
        for quantity in ("speed", "processor time per robot and step", "transmitted per step"):
            assert f"{team}, memory: {quantity}" in names
    work = {figure["name"]: figure for figure in figures if figure["unit"] == "ms"}
    assert work["2 robots, meier, polygons, memory: processor time per robot and step"]["ratio"] == 1.0
    assert all(figure["value"] > 0 for figure in figures)


def test_the_requested_strategies_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(scale.SETTINGS, "steps", 6)
    monkeypatch.setattr(explorations, "SIDE_M", 15.0)
    monkeypatch.setattr(scale, "MAX_PROCESSES", 0)
    figures = run_benchmarks(["scale"], lambda _: None, [2], ["burgard", "repairmen"])
    teams = {figure["name"].partition(" robots, ")[2].partition(",")[0] for figure in figures}
    assert teams == {"burgard", "repairmen"}


def test_an_unknown_strategy_is_refused_before_anything_runs() -> None:
    with pytest.raises(ValueError, match="greddy"):
        next(scale.scale([2], ["meier", "greddy"]))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["kernels", "--robots", "3"], "--robots has no effect on kernels"),
        (["relay", "swarm", "--strategy", "meier"], "--strategy has no effect on relay, swarm"),
        (["scale", "--map", "em"], "--map has no effect on scale"),
        (["--picture", "table.png"], "--picture has no effect on these benchmarks"),
    ],
)
def test_options_without_effect_are_refused(words: list[str], message: str) -> None:
    result = CliRunner().invoke(app, ["bench", *words])
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == f"murmur: {message}\n"


# --- baselines ----------------------------------------------------------------------------------------


def some_floor(seed: int) -> tuple[Grid, tuple[int, int]]:
    """Free space in one piece, with walls and pillars, and a cell of it."""
    grid = generators.make("unstructured", seed=seed, width_m=8, height_m=8).cells
    y, x = np.argwhere(grid == FREE)[seed * 97].tolist()
    known = np.where(np.isfinite(costs(Floor(grid), x, y)), FREE, OCCUPIED).astype(np.uint8)
    return known, (x, y)


def rotated(cycle: list[Cell]) -> list[Cell]:
    """The same cycle, rotated to its lexicographically smallest form."""
    first = min(cycle)
    return min(cycle[i:] + cycle[:i] for i, cell in enumerate(cycle) if cell == first)


def cells_along(polygons: Polygons) -> list[list[Cell]]:
    """The cells along each contour, in OpenCV's form."""
    cycles = []
    for first, end in zip(polygons.start[:-1].tolist(), polygons.start[1:].tolist(), strict=True):
        along = list(zip(polygons.x[first:end].tolist(), polygons.y[first:end].tolist(), strict=True))
        cycle = [cell for before, cell in zip([along[-1], *along], along, strict=False) if cell != before]
        cycles.append(rotated(cycle or along[:1]))
    return sorted(cycles)


@pytest.mark.parametrize("seed", range(4))
def test_opencv_finds_the_same_contours(seed: int) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is in the extra bench")
    grid, cell = some_floor(seed)
    solid = np.ones((grid.shape[0] + 2, grid.shape[1] + 2), np.uint8)
    traced = baselines.trace_by_opencv(cv2, grid, solid)
    cycles = [[(x - 1, y - 1) for x, y in contour[:, 0].tolist()] for contour in traced]
    theirs = sorted(rotated(cycle) for cycle in cycles if (-1, -1) not in cycle)
    assert cells_along(contours(grid, cell)) == theirs
    assert len(theirs) > 3


def costs_by_skimage(graph: Any, grid: Grid, cell: Cell) -> Any:
    """Lengths of shortest paths whose diagonal steps need both adjacent cells free, by skimage.

    Layer 0 has the cells at even positions and the midpoints between straight neighbors. Layer 1, at distance 0 above,
    has the corners whose four cells are all free. Diagonal steps change layers, straight steps do not.
    """
    free = grid == FREE
    open_ = np.zeros((2, 2 * grid.shape[0] - 1, 2 * grid.shape[1] - 1), np.bool_)
    open_[0, ::2, ::2] = free
    open_[0, 1::2, ::2] = free[1:] & free[:-1]
    open_[0, ::2, 1::2] = free[:, 1:] & free[:, :-1]
    open_[1, 1::2, 1::2] = free[1:, 1:] & free[:-1, 1:] & free[1:, :-1] & free[:-1, :-1]
    steps = [(0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    steps += [(up, dy, dx) for up in (-1, 1) for dy in (-1, 1) for dx in (-1, 1)]
    paths = graph.MCP_Geometric(np.where(open_, 1.0, -1.0), offsets=steps, sampling=(1e-12, 0.5, 0.5))
    return paths.find_costs([(0, 2 * cell[1], 2 * cell[0])])[0][0, ::2, ::2]


@pytest.mark.parametrize("seed", range(3))
def test_skimage_finds_the_same_costs_without_cutting_corners(seed: int) -> None:
    graph = pytest.importorskip("skimage.graph", reason="scikit-image is in the extra bench")
    grid, (x, y) = some_floor(seed)
    theirs = costs_by_skimage(graph, grid, (x, y))
    assert np.allclose(costs(Floor(grid), x, y), theirs, rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_numpy_draws_the_same_scan(seed: int) -> None:
    grid, cell = some_floor(seed)
    no_robots, beams = np.zeros(grid.shape, np.bool_), ray_table(25.0)
    mine, theirs = np.zeros_like(grid), np.zeros_like(grid)
    draw(mine, beams, *cell, cast(grid, no_robots, beams, *cell))
    baselines.scan_in_numpy(grid, beams, cell, theirs)
    assert (mine == theirs).all()


@pytest.mark.long
def test_a_robot_in_the_field_is_measured_beside_simulated_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rosbags", reason="rosbags is in the extra ros2")
    monkeypatch.setattr(field, "SIDES_M", (10,))
    monkeypatch.setattr(field, "WARM_UP_S", 0.2)
    monkeypatch.setattr(field, "MEASURED_S", 1.0)
    memory, anonymous, processor = field.field()
    assert [each.unit for each in (memory, anonymous, processor)] == ["MB", "MB", "% of a core"]
    assert memory.value > anonymous.value > 50
    assert 0 < processor.value < 200
