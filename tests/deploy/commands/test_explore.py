"""`murmur explore`: its output, its files and its flags."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

from protocol.presets import PRESETS
from tests.deploy.commands.office_floor import explore, murmur


def test_a_run_prints_its_results_and_its_directory(floor: str) -> None:
    result = explore(floor)
    assert result.exit_code == 0, result.stderr
    lines = result.stdout.splitlines()
    assert lines[0].startswith("Explored in ")
    assert "100.00 % of the reachable area" in lines[1]
    directory = Path("runs/floor-predictive-2robots-seed0")
    assert f"Results: {directory} (pictures: {directory / 'maps.png'})" == lines[-1]
    assert (directory / "summary.json").exists()
    assert "runs/floor-predictive-2robots-seed0-2" in explore(floor, "--steps", "3").stdout


def test_a_size_of_frontiers_that_closes_passages_is_named_when_a_robot_stops_too_early(floor: str) -> None:
    result = explore(floor, "--min-frontier-size", "4")
    assert result.exit_code == 1
    assert "stopped too early" in result.stdout
    assert "min_frontier_size = 4 m may close passages: choose less" in result.stderr
    result = explore(floor, "--min-frontier-size", "0.2")
    assert (result.exit_code, result.stderr) == (0, "")


def test_a_run_with_sensor_errors_prints_how_well_the_walls_fit(floor: str) -> None:
    result = explore(floor, "--laser", "utm-30lx", "--steps", "20")
    (line,) = [line for line in result.stdout.splitlines() if line.startswith("Walls: ")]
    assert "within one cell of the true ones (worst robot " in line
    assert re.search(r"; agreement \d+\.\d\d % within 1 cell \(worst pair ", line)
    alone = explore(floor, "--laser", "utm-30lx", "--steps", "20", "--robots", "1").stdout
    assert "Walls: F1 " in alone
    assert "agreement" not in alone
    assert "Walls: " not in explore(floor, "--steps", "20").stdout


def test_edits_of_polygons_are_named_in_words(floor: str) -> None:
    printed = explore(floor, "--map-encoding", "polygons", "--steps", "3").stdout
    assert "B (inserted corners " in printed
    assert "choices of an object " in printed


def test_json_output_is_one_object_and_nothing_else(floor: str) -> None:
    result = explore(floor, "--json", "--out", "run")
    summary: dict[str, Any] = json.loads(result.stdout)
    assert summary == json.loads(Path("run/summary.json").read_text())
    assert result.stderr == ""


def test_a_run_that_does_not_finish_ends_with_1(floor: str) -> None:
    result = explore(floor, "--steps", "3")
    assert result.exit_code == 1
    assert "Not finished after 3 steps: out of steps." in result.stdout


def test_flags_override_the_scenario(floor: str) -> None:
    Path("s.toml").write_text(f'map = "{floor}"\nrobots = 2\nsteps = 3\nbus = "memory"\nseed = 5\n')
    result = murmur(
        "explore", "s.toml", "--seed", "6", "--option", "small_frontier=2", "--json", "--out", "run"
    )
    assert json.loads(result.stdout)["seed"] == 6
    written = Path("run/scenario.toml").read_text()
    assert "small_frontier = 2" in written
    assert "robots = 2" in written


def test_one_flag_selects_the_rules_of_the_thesis(floor: str) -> None:
    explore(floor, "--thesis", "--steps", "2", "--out", "run")
    written = Path("run/scenario.toml").read_text()
    for line in (
        'dissemination = "thesis"',
        "lazy = false",
        "mixed_first = false",
        "free_inside_edges = true",
    ):
        assert line in written
    assert "herding = false" in written


def test_flags_override_the_rules_of_the_thesis(floor: str) -> None:
    flags = ("--set", "polygons.lazy=true", "--option", "herding=true", "--steps", "2")
    explore(floor, "--thesis", *flags, "--out", "one")
    assert "lazy = true" in Path("one/scenario.toml").read_text()
    assert "herding = true" in Path("one/scenario.toml").read_text()
    explore(floor, "--thesis", "--strategy", "nearest", "--steps", "2", "--out", "other")
    assert "herding" not in Path("other/scenario.toml").read_text()


def test_a_run_prints_the_folder_of_its_pictures(floor: str) -> None:
    output = explore(floor, "--steps", "4", "--out", "run", "--pictures").stdout
    assert "Results: run (pictures: run/maps.png, run/pictures)" in output


def test_any_setting_can_be_set_and_tables_keep_their_other_keys(floor: str) -> None:
    Path("mine.toml").write_text(f'map = "{floor}"\nrobots = 2\nbus = "memory"\n[polygons]\nlazy = false\n')
    result = murmur(
        "explore",
        "mine.toml",
        "--steps",
        "2",
        "--out",
        "run",
        "--set",
        "polygons.medium_use=0.25",
        "--set",
        "radius=0.1",
    )
    assert result.exit_code == 1, result.stderr
    written = tomllib.loads(Path("run/scenario.toml").read_text())
    assert (written["radius"], written["polygons"]["medium_use"], written["polygons"]["lazy"]) == (
        0.1,
        0.25,
        False,
    )


def test_presets_can_be_set_like_any_other_key(floor: str) -> None:
    words = ["explore", "--map", floor, "--bus", "memory", "--steps", "1", "--out", "run"]
    result = murmur(*words, "--set", "radio.preset=zigbee", "--set", "laser.preset=sick-lms")
    assert result.exit_code == 1, result.stderr
    written = tomllib.loads(Path("run/scenario.toml").read_text())
    assert (written["radio"]["preset"], written["laser"]["preset"]) == ("zigbee", "sick-lms")
    assert written["radio"]["frame_bytes"] == PRESETS["zigbee"].frame_bytes
    assert written["laser"]["beams"] == 541


def test_a_picture_with_a_resolution_is_a_map(floor: str) -> None:
    result = murmur(
        "explore", "--map", "floor.png", "--resolution", "0.1", "--bus", "memory", "--out", "picture"
    )
    assert result.exit_code == 0, result.stderr
    explore(floor, "--robots", "3", "--out", "yaml")
    assert murmur("replay", "picture").exit_code == 0
    one, other = (json.loads(Path(name, "summary.json").read_text()) for name in ("picture", "yaml"))
    assert one["map"] == other["map"] == "floor"


def test_help_shows_flags_in_groups() -> None:
    output = murmur("explore", "--help").stdout
    order = [
        output.index(f"\n{group}:\n") for group in ("Options", "World", "Robots", "Radio", "Run", "View")
    ]
    assert order == sorted(order)
    assert order[2] < output.index("--strategy NAME") < order[3] < output.index("--bandwidth BYTES")
