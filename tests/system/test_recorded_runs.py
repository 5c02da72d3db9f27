"""Whole runs that replay logs: all maps are delivered, only maps are sent, and runs repeat to the byte."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from deploy.after.archive import read
from deploy.run.exit_codes import EXPLORED, NOT_FINISHED
from deploy.run.exploration import explore
from deploy.run.result import Result
from deploy.scenario.scenario import load
from protocol.grid import FREE, UNKNOWN
from tests.worldsim.recorded.made_logs import FULL_CIRCLE, Bag, distances, drive, write_carmen
from worldsim.recorded.world import END_OF_LOG, UNDELIVERED

INTEL = Path(__file__).parents[2] / "../shared/logs/intel.log.gz"


@pytest.fixture
def room(tmp_path: Path) -> Path:
    return write_carmen(tmp_path / "room.log", scans=24)


def play(*logs: Path, recording: dict[str, Any] | None = None, **settings: Any) -> Result:
    table = {"files": [str(log) for log in logs]} | (recording or {})
    return explore(recording=table, **({"robots": 3, "bus": "memory"} | settings))


@pytest.mark.parametrize("map_encoding", ["predictive", "cells", "scans", "polygons"])
def test_teammates_hold_all_maps_at_the_end(room: Path, map_encoding: str) -> None:
    result = play(room, map_encoding=map_encoding, keep=False)
    summary = result.summary
    assert (summary["reason"], summary["finished"], result.exit_code) == (END_OF_LOG, True, EXPLORED)
    assert (summary["scans"], summary["coverage"], summary["backlog"]) == (24, 1.0, 0)
    truth = result.plan.map.cells
    known = [(grid[truth == FREE] != UNKNOWN).mean() for grid in result.records.planning.values()]
    assert min(known) > 0.99
    assert summary["claimed_worst_wall_f1"] > 0.98
    assert summary["worst_walls_within_tolerance"] > 0.99
    assert summary["protocol_errors"] == 0


def test_coverage_counts_the_cells_that_robots_have_mapped(room: Path) -> None:
    result = play(room, keep=False)
    recording, free = result.plan.recording, result.plan.map.cells == FREE
    assert recording is not None
    for robot, stretch in enumerate(recording.stretches):
        known = np.flatnonzero(free & (result.records.own[robot] != UNKNOWN))
        assert known.tolist() == np.sort(np.concatenate(list(stretch.found))).tolist()


def test_all_bytes_are_those_of_maps(room: Path) -> None:
    result = play(room, keep=False)
    assert set(result.summary["bytes"]) == {"update", "total"}
    total = result.summary["bytes"]["total"]
    assert total > 0
    assert result.summary["bytes_per_scan"] == round(total / 24, 2)


def test_a_recorded_run_is_the_same_on_both_buses(room: Path) -> None:
    digests = {play(room, bus=bus, keep=False).summary["digest"] for bus in ("memory", "zenoh")}
    assert len(digests) == 1


def test_a_run_directory_repeats_the_run_without_the_log(room: Path, tmp_path: Path) -> None:
    first = play(room, recording={"every": 2}, out=tmp_path / "run")
    room.unlink()
    again = explore(load(tmp_path / "run" / "scenario.toml", {}), keep=False)
    assert again.summary["digest"] == first.summary["digest"]
    assert again.summary["scans"] == first.summary["scans"] == 12
    archive = read(tmp_path / "run")
    assert archive.plan.map.name == "room"
    assert archive.last_step == first.summary["steps"]


def test_a_run_goes_on_after_the_last_scan_until_all_maps_are_delivered(room: Path) -> None:
    slow, fast = (play(room, bandwidth=bandwidth, keep=False) for bandwidth in (20, "unlimited"))
    late = slow.summary["steps_after_scans"]
    assert late > fast.summary["steps_after_scans"]
    assert slow.summary["backlog"] == 0
    assert slow.steps.filter(pl.col("step") > 8)["backlog"].max() > 0  # 24 scans of 3 robots
    assert slow.summary["finished"]
    carried = slow.ledger.filter(pl.col("carried"))["step"]
    assert carried.max() <= 8 + late


@pytest.mark.parametrize("settings", [{"range": 0}, {"bandwidth": 0, "map_encoding": "cells"}])
def test_a_team_that_cannot_deliver_its_maps_does_not_finish(room: Path, settings: dict[str, Any]) -> None:
    result = play(room, **settings, keep=False)
    assert (result.summary["reason"], result.summary["finished"]) == (UNDELIVERED, False)
    assert result.exit_code == NOT_FINISHED
    assert result.summary["coverage"] == 1.0
    assert result.summary["bytes"]["total"] == 0
    assert 100 < result.summary["steps"] < 150


def test_at_the_recorded_pace_a_step_is_a_second_of_the_log(tmp_path: Path) -> None:
    room = write_carmen(tmp_path / "room.log", scans=12, period_s=2.5)
    result = play(room, recording={"pace": "recorded"}, keep=False)
    assert result.summary["scans"] == 12
    steps = result.steps.filter(pl.col("robot") == 0).sort("step")
    moves = steps.with_columns(moved=pl.col("x") != pl.col("x").shift(1)).filter(pl.col("moved"))
    assert moves["step"].to_list() == [3, 6, 8]  # 2.5, 5.0, and 7.5 s after the first scan, in step 1


def test_a_robot_that_dies_takes_its_last_scans_with_it(room: Path) -> None:
    result = play(room, fault=[{"step": 4, "robot": 2, "kind": "kill"}], keep=False)
    assert result.summary["scans"] == 8 + 8 + 3
    assert result.summary["reason"] == UNDELIVERED  # to the robot that died


def test_a_single_robot_sends_nothing(room: Path) -> None:
    summary = play(room, robots=1, keep=False).summary
    assert (summary["finished"], summary["bytes"]["total"], summary["bytes_per_scan"]) == (True, 0, 0.0)


@pytest.mark.parametrize("pace", ["scan", "recorded"])
def test_a_listener_receives_the_map_and_has_nothing_to_report_but_its_place(room: Path, pace: str) -> None:
    result = play(room, robots=3, recording={"listeners": 1, "pace": pace}, keep=False)
    records, summary = result.records, result.summary
    assert (summary["scans"], summary["finished"], summary["first_robot"]) == (24, True, 0)
    assert np.count_nonzero(records.own[2]) == 1
    free = result.plan.map.cells == FREE
    assert (records.planning[2][free] != UNKNOWN).mean() > 0.99
    assert summary["robot_maps"]["2"]["worst_walls_within_tolerance"] > 0.99
    sent = result.ledger.filter(pl.col("carried")).group_by("sender").agg(pl.col("bytes").sum())
    of_robot = dict(sent.iter_rows())
    assert of_robot.get(2, 0) < 20 < min(of_robot[0], of_robot[1])


def test_each_of_several_logs_has_a_robot_beside_the_listeners(room: Path, tmp_path: Path) -> None:
    other = write_carmen(tmp_path / "other.log", scans=10)
    recording = {"files": [str(room), str(other)], "listeners": 1}
    summary = explore(recording=recording, bus="memory", keep=False).summary
    assert (summary["robots"], summary["scans"]) == (3, 34)


def test_a_bag_is_replayed_like_a_log(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="rosbags is in the extra mcap")
    with Bag(tmp_path / "room", "mcap") as bag:
        for second, pose in enumerate(drive(9), 1):
            bag.scan(second, distances(pose, FULL_CIRCLE))
            bag.transform(second, "map", "laser", pose)
    summary = play(tmp_path / "room", out=tmp_path / "run").summary
    assert (summary["map"], summary["scans"], summary["finished"]) == ("room", 9, True)
    assert summary["claimed_worst_wall_f1"] > 0.98
    again = explore(load(tmp_path / "run" / "scenario.toml", {}), keep=False)
    assert again.summary["digest"] == summary["digest"]


@pytest.mark.skipif(not INTEL.exists(), reason="the recorded log is not part of the repository")
def test_a_team_shares_the_map_of_a_real_building() -> None:
    result = play(INTEL, robots=4, recording={"every": 10}, bandwidth="unlimited", keep=False)
    summary = result.summary
    assert (summary["scans"], summary["finished"], summary["coverage"]) == (91, True, 1.0)
    assert summary["map_accuracy"] > 0.97
    assert summary["claimed_worst_wall_f1"] > 0.9
    assert np.ptp([len(each.steps) for each in result.plan.recording.stretches]) <= 1  # type: ignore[union-attr]
