"""`murmur play`: its output, its files, and its errors."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from tests.deploy.commands.office_floor import murmur
from tests.worldsim.recorded.made_logs import write_carmen

MEMORY = ("--bus", "memory")


@pytest.fixture
def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A log in the folder where the test works."""
    monkeypatch.chdir(tmp_path)
    return write_carmen(tmp_path / "room.log.gz", scans=12).name


def test_a_run_prints_its_results_and_its_directory(room: str) -> None:
    result = murmur("play", room, "--robots", "2", *MEMORY)
    assert result.exit_code == 0, result.stderr
    lines = result.stdout.splitlines()
    assert lines[0].startswith("Replayed 12 scans in ")
    assert "B per scan" in lines[0]
    assert "100.00 % of the map of all scans" in lines[1]
    assert lines[2].startswith("Map accuracy, relative to that map: ")
    assert "within one cell of those of that map" in lines[3]
    assert lines[-1].startswith("Results: runs/room-predictive-2robots-seed0 (pictures: ")


def test_json_output_has_the_figures_of_the_log(room: str) -> None:
    result = murmur("play", room, "--robots", "3", "--every", "2", "--bandwidth", "50", *MEMORY, "--json")
    summary = json.loads(result.stdout)
    assert (summary["scans"], summary["robots"], summary["logs"]) == (6, 3, [room])
    assert summary["bytes_per_scan"] == round(summary["bytes"]["total"] / 6, 2)
    assert {"steps_after_scans", "backlog_after_scans", "backlog"} <= summary.keys()
    assert summary["over_budget_steps"] == 0


def test_steps_of_a_run_by_the_wall_clock_have_a_duration(room: str) -> None:
    result = murmur("play", room, "--step", "200ms", *MEMORY)
    assert (result.exit_code, result.stdout) == (2, "")
    assert "step_s = 0.2: steps have a duration only with clock = 'wall'" in result.stderr
    result = murmur("play", room, "--step", "200ms", "--clock", "wall", *MEMORY)
    assert "with this clock, bus must be 'zenoh'" in result.stderr


def test_a_run_is_replayed_and_reported_without_the_log(room: str) -> None:
    murmur("play", room, "--robots", "2", *MEMORY, "--out", "run")
    Path(room).unlink()
    written = tomllib.loads(Path("run/scenario.toml").read_text())
    assert written["recording"]["files"] == ["scans-0.npz"]
    assert "# Replayed: room.log.gz; all scans." in Path("run/scenario.toml").read_text()
    result = murmur("replay", "run")
    assert result.stdout.startswith("Replay matches"), result.stderr
    assert murmur("report", "run").exit_code == 0
    page = Path("run/report.html").read_text()
    assert "Replayed 12 scans in " in page
    assert "Explored in" not in page
    assert "12 scans of room.log.gz" in page


def test_scans_that_are_gone_or_have_changed_are_reported(room: str) -> None:
    murmur("play", room, "--robots", "2", *MEMORY, "--out", "run")
    murmur("play", room, "--robots", "2", "--every", "2", *MEMORY, "--out", "other")
    Path("run/scans-0.npz").write_bytes(Path("other/scans-0.npz").read_bytes())
    result = murmur("replay", "run")
    assert result.exit_code == 2
    assert "run/scans-0.npz: has changed since the run" in result.stderr
    for content, error in (
        (None, "no such log; was it moved or renamed?"),
        (b"PK", "not the scans of a run"),
    ):
        Path("run/scans-0.npz").unlink()
        if content is not None:
            Path("run/scans-0.npz").write_bytes(content)
            (Path("run/summary.json")).write_text(
                Path("run/summary.json").read_text().replace("scans-0.npz", "-")
            )
        result = murmur("replay", "run")
        assert result.exit_code == 2
        assert f"run/scans-0.npz: {error}" in result.stderr
        Path("run/scans-0.npz").touch()


def test_the_scans_of_a_run_directory_are_a_log(room: str) -> None:
    murmur("play", room, "--robots", "2", *MEMORY, "--out", "run")
    result = murmur("play", "run/scans-0.npz", "--robots", "4", *MEMORY, "--json")
    summary = json.loads(result.stdout)
    assert (summary["scans"], summary["map"]) == (12, "room")


def test_flags_set_pace_cells_range_and_listeners(room: str) -> None:
    flags = ("--pace", "recorded", "--resolution", "0.2", "--sensor-range", "4", "--set", "radio.loss=0.1")
    murmur("play", room, *flags, "--listeners", "1", *MEMORY, "--out", "run")
    written = tomllib.loads(Path("run/scenario.toml").read_text())
    assert written["recording"]["listeners"] == 1
    assert written["recording"]["pace"] == "recorded"
    assert written["recording"]["resolution"] == 0.2
    assert written["sensor_range"] == 4
    assert written["radio"]["loss"] == 0.1
    assert "resolution: 0.2" in Path("run/map.yaml").read_text()


@pytest.mark.parametrize(
    ("flags", "error"),
    [
        (("--robots", "13"), "12 scans for 13 robots"),
        (("--pace", "fast"), "pace = 'fast': must be scan or recorded"),
        (("--set", "strategy=meier"), "set = 'strategy=...': has no meaning for robots that replay a log"),
        (("--set", "map=office"), "set = 'map=...': has no meaning for robots that replay a log"),
        (("--set", "laser.preset=utm-30lx"), "set = 'laser.preset=...': has no meaning"),
        (("--set", "recording.every=2", "--every", "3"), "set = 'recording.every=...': --every is given, too"),
        (("--robots", "2", "--listeners", "2"), "recording.listeners = 2: one robot must replay the log"),
        (("--listeners", "-1"), "listeners = -1: must not be negative"),
        (("room.log.gz", "--robots", "2", "--listeners", "1"), "has one robot, and 1 have none"),
        (("--topic", "/scan"), "only bags have topics"),
        (("--strategy", "meier"), "No such option: --strategy"),
        (("other.log",), "other.log: no such log"),
    ],
)  # fmt: skip
def test_bad_input_names_what_is_wrong_and_writes_nothing(
    room: str, flags: tuple[str, ...], error: str
) -> None:
    result = murmur("play", room, *flags, *MEMORY)
    assert result.exit_code == 2
    assert error in " ".join(result.stderr.split())
    assert not Path("runs").exists()


def test_a_damaged_line_is_named_with_its_number(room: str) -> None:
    Path("damaged.log").write_text("ODOM\nFLASER 3 1.0 2.0\n")
    result = murmur("play", "damaged.log", *MEMORY)
    assert result.exit_code == 2
    assert "damaged.log, line 2: damaged FLASER line" in result.stderr
