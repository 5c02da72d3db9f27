"""Benches: figures as ratios against yardsticks of the same run, and yardsticks that find the same results."""

from __future__ import annotations

import json
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from agent.outline.contour import contours
from agent.planning.cost_field import costs
from agent.strategies.registry import strategies
from deploy.bench import cold_cache, hosts, kernels, ratios, relay, replanning, scale, swarm, yardsticks
from deploy.bench.ratios import Figure, compare, run_benches
from deploy.bench.recording_bus import recorded_for
from deploy.commands.main import app
from protocol.grid import FREE, OCCUPIED, Grid, ray_table
from protocol.scans import draw
from worldsim import generators
from worldsim.laser import cast


def test_a_ratio_is_the_median_of_paired_repeats_with_its_interval() -> None:
    figure = compare("work", "ms", [1.0, 2.0, 3.0, 40.0], "rest", [2.0, 4.0, 6.0, 2.0], "at most 1")
    assert (figure.value, figure.ratio) == (2.5, 0.5)
    assert figure.interval is not None
    low, high = figure.interval
    assert low == 0.5 <= high <= 20
    assert figure == compare("work", "ms", [1.0, 2.0, 3.0, 40.0], "rest", [2.0, 4.0, 6.0, 2.0], "at most 1")


def test_a_figure_for_people_names_its_yardstick_and_its_aim() -> None:
    line = compare("work", "ms", [1.0, 1.0], "rest", [2.0, 2.0], "at most 1").line()
    assert " ".join(line.split()) == "work 1.00 ms 0.50 x rest [0.50, 0.50] (aim: at most 1)"
    assert Figure("memory", "MB", 44).line().split() == ["memory", "44.00", "MB"]


def test_help_names_every_bench() -> None:
    said = CliRunner().invoke(app, ["bench", "--help"]).stdout
    assert all(name in said for name in ratios.benches())


def test_a_bench_that_is_not_there_is_refused_with_those_that_are() -> None:
    with pytest.raises(ValueError, match=r"no bench is called 'speed'; there are: kernels, bus, swarm"):
        run_benches(["bus", "speed"], lambda _: None)


def _one_figure() -> Iterator[Figure]:
    yield compare("work", "ms", [1.0], "rest", [2.0])


def test_figures_come_as_text_for_people_and_as_json_for_machines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ratios, "benches", lambda: {"small": _one_figure})
    said = CliRunner().invoke(app, ["bench"]).stdout.splitlines()
    assert said[0] == "small:"
    assert said[1].split()[:3] == ["work", "1.00", "ms"]
    (figure,) = json.loads(CliRunner().invoke(app, ["bench", "small", "--json"]).stdout)
    assert figure["bench"] == "small"
    assert (figure["yardstick"], figure["ratio"]) == ("rest", 0.5)


@pytest.mark.parametrize(
    ("module", "package"), [("cv2", "opencv-python-headless"), ("skimage.graph", "scikit-image")]
)
def test_a_yardstick_that_is_not_installed_is_named(
    monkeypatch: pytest.MonkeyPatch, module: str, package: str
) -> None:
    if module != "cv2":
        pytest.importorskip("cv2")
    monkeypatch.setitem(sys.modules, module, None)
    result = CliRunner().invoke(app, ["bench", "kernels"])
    assert result.exit_code == 2
    assert f"bench kernels compares with {package}, which is not installed" in result.stderr
    assert "extra bench" in result.stderr


def test_kernels_are_measured_against_yardsticks_that_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cv2", reason="OpenCV is in the extra bench")
    pytest.importorskip("skimage", reason="scikit-image is in the extra bench")
    monkeypatch.delenv("MURMUR_MAPS", raising=False)
    monkeypatch.setattr(kernels, "ROBOTS", 3)
    monkeypatch.setattr(kernels, "SIDE_M", 10.0)
    figures = list(kernels.kernels())
    assert [(figure.name, figure.yardstick) for figure in figures] == [
        ("scan, cast and drawn", "the same beams in numpy"),
        ("contours of a robot's map", "OpenCV's findContours"),
        ("contours, repair, refinement and edits", "the whole map approximated and told anew"),
        ("merging 2 teammates, all changed", "Algorithm 9 line by line"),
        ("merging 2 teammates, one changed", "all changed"),
        ("merging 2 teammates, none changed", "all changed"),
        ("costs to all cells", "skimage's MCP_Geometric"),
        ("session of 3 robots a step", "the relay's work in it"),
        ("looks of a step, written", "drawing its scan"),
        ("looks of a step, read", "drawing its scan"),
        *((f"looks, {way}", "") for way in ("written", "written", "read", "read")),
    ]
    assert [figure.unit for figure in figures] == 10 * ["ms"] + 2 * ["cells/s", "bytes/s"]
    for figure in figures:
        assert figure.value > 0
        if not figure.yardstick:
            continue
        assert figure.ratio is not None
        assert figure.interval is not None
        assert 0 < figure.interval[0] <= figure.ratio <= figure.interval[1]


def test_every_strategy_is_measured_when_it_replans_and_is_itself_again_afterwards(
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
    names = [f"{name}, {what}" for name in strategies() for what in ("mean", "95th percentile")]
    assert [figure.name for figure in figures] == names
    assert len(before) > 10
    assert {name: dict(vars(kind)) for name, kind in shipped.items()} == before
    for figure in figures:
        assert figure.unit == "ms"
        assert figure.value > 0
        assert figure.ratio is not None
        assert figure.ratio > 0
    without_aim = {figure.name.split(",")[0] for figure in figures if not figure.aim}
    assert without_aim == {"burgard-optimal", "mtsp", "mtsp-depot"}


def test_the_relay_s_work_is_measured_a_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relay, "STEPS", 5)
    monkeypatch.setattr(relay, "SIDE_M", 10.0)
    monkeypatch.setattr(
        relay, "CASES", (relay.Case(3, "polygons", 1000), relay.Case(2, "scans", "unlimited"))
    )
    figures = list(relay.relay())
    assert [figure.name for figure in figures] == [
        "relay, 3 robots, polygon, 1000: work a frame",
        "relay, 2 robots, laser, unlimited: work a frame",
    ]
    assert all(figure.unit == "us" and figure.yardstick == "reading its packets" for figure in figures)
    assert all(figure.value > 0 and (figure.ratio or 0) > 0 for figure in figures)


def test_a_robot_hears_a_run_again_and_says_as_much_and_cold_memory_is_compared_with_warm(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(swarm, "STEPS", 12)
    monkeypatch.setattr(swarm, "SIDE_M", 10.0)
    monkeypatch.setattr(cold_cache, "REPEATS", 1)
    for case in cold_cache.CASES:
        recording_bus, steps = recorded_for(swarm.plan_of(case), "r0")
        seconds, said = cold_cache.hear_again(recording_bus.heard)
        assert (steps, said) == (12, recording_bus.said)
        assert seconds > 0
    figures = list(cold_cache.cold_cache())
    assert [figure.name for figure in figures][:2] == [
        "a robot's work a step, laser, warm",
        "a robot's work a step, laser, cold",
    ]
    assert all(figure.unit == "ms" and figure.value > 0 for figure in figures)
    assert all(figure.yardstick == "the same, warm" for figure in figures[1::2])


def test_teams_of_the_sizes_asked_for_are_measured_and_drawn(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(scale, "STEPS", 6)
    monkeypatch.setattr(scale, "SIDE_M", 15.0)
    monkeypatch.setattr(scale, "PROCESSES", 0)
    said: list[str] = []
    figures = run_benches(["scale"], said.append, [2, 66])
    names = [figure["name"] for figure in figures]
    for who in (
        "2 robots, polygons",
        "2 robots, looks by gossip",
        "66 robots, targets",
        "66 robots, looks by gossip",
    ):
        for what in ("speed", "processor time a robot and step", "on the air a step"):
            assert f"{who}, memory: {what}" in names
    work = {figure["name"]: figure for figure in figures if figure["unit"] == "ms"}
    assert work["2 robots, polygons, memory: processor time a robot and step"]["ratio"] == 1.0
    assert all(figure["value"] > 0 for figure in figures if figure["unit"] != "MB")
    scale.draw(figures, tmp_path / "scale.png")
    assert (tmp_path / "scale.png").read_bytes().startswith(b"\x89PNG")


# --- yardsticks ----------------------------------------------------------------------------------------


def some_floor(seed: int) -> tuple[Grid, tuple[int, int]]:
    """Free space in one piece, with walls and pillars, and a cell of it."""
    grid = generators.make("unstructured", seed=seed, width_m=8, height_m=8).cells
    y, x = np.argwhere(grid == FREE)[seed * 97].tolist()
    known = np.where(np.isfinite(costs(grid, x, y)), FREE, OCCUPIED).astype(np.uint8)
    return known, (x, y)


@pytest.mark.parametrize("seed", range(4))
def test_opencv_goes_along_the_same_cells(seed: int) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is in the extra bench")
    grid, cell = some_floor(seed)
    solid = np.ones((grid.shape[0] + 2, grid.shape[1] + 2), np.uint8)
    theirs = yardsticks.without_frame(yardsticks.trace_by_opencv(cv2, grid, solid))
    assert yardsticks.cells_along(contours(grid, cell)) == theirs
    assert len(theirs) > 3


@pytest.mark.parametrize("seed", range(3))
def test_skimage_finds_the_same_ways_if_it_may_not_cut_corners(seed: int) -> None:
    graph = pytest.importorskip("skimage.graph", reason="scikit-image is in the extra bench")
    grid, (x, y) = some_floor(seed)
    theirs = yardsticks.without_corners(graph, grid, (x, y))
    assert np.allclose(costs(grid, x, y), theirs, rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_numpy_sees_the_same_cells(seed: int) -> None:
    grid, cell = some_floor(seed)
    nobody, beams = np.zeros(grid.shape, np.bool_), ray_table(25.0)
    mine, theirs = np.zeros_like(grid), np.zeros_like(grid)
    draw(mine, beams, *cell, cast(grid, nobody, beams, *cell))
    yardsticks.look_in_numpy(grid, nobody, beams, cell, theirs)
    assert (mine == theirs).all()


def test_a_link_delays_counts_and_changes_nothing() -> None:
    def echo(server: socket.socket) -> None:
        connection, _ = server.accept()
        with connection:
            while heard := connection.recv(1000):
                connection.sendall(2 * heard)

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=echo, args=(server,), daemon=True).start()
        with (
            hosts.Link(server.getsockname()[1], 0.02) as link,
            socket.create_connection(("127.0.0.1", link.port), timeout=10) as end,
        ):
            for word in (b"a", b"bc", b"def"):
                began = time.monotonic()
                end.sendall(word)
                heard = b""
                while len(heard) < 2 * len(word):
                    heard += end.recv(100)
                assert heard == 2 * word
                assert time.monotonic() - began >= 0.04
            assert link.carried() == {"from the hub": 12, "to the hub": 6, "round trips": 3}


@pytest.mark.long
def test_links_are_measured_and_delay_costs_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"ROBOTS": 2, "LINK_STEPS": 160, "REPEATS": 1, "ROUND_TRIPS_MS": (0, 20)}.items():
        monkeypatch.setattr(hosts, name, value)
    by_name = {figure.name: figure for figure in hosts.link()}
    for map_encoding in ("polygons", "scans"):
        what = f"2 robots, {map_encoding}"
        assert by_name[f"{what}: from the hub, a robot and step"].value > 100
        assert by_name[f"{what}: to the hub, a robot and step"].value > 100
        assert by_name[f"{what}: round trips, a robot and step"].value >= 1
        slowed = by_name[f"{what}, 20 ms"]
        assert slowed.value < 50
        assert slowed.ratio is not None
        assert slowed.ratio < 1
