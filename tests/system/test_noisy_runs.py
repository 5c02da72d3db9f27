"""Whole runs with real lasers and poses: they finish, their maps are good, and they repeat to the byte."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from deploy.run.exploration import explore
from deploy.run.result import Result
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import load
from protocol.grid import FREE, UNKNOWN
from tests.system.team import Team, small_plan

SMALL: dict[str, Any] = {
    "map": "office", "map_options": {"width_m": 12.0, "height_m": 10.0}, "robots": 3, "seed": 5, "steps": 600,
    "bandwidth": "unlimited", "sensor_range": 4.0,
}  # fmt: skip


def run(**settings: Any) -> Result:
    """Run a team; only a run with an `out` writes a directory."""
    return explore(**({"bus": "memory", "keep": "out" in settings} | SMALL | settings))


@pytest.mark.parametrize("laser", ["sick-lms", "utm-30lx", "rplidar-a1"])
@pytest.mark.parametrize("pose", ["exact", "graph-slam", "particle-filter"])
def test_a_team_with_real_sensors_explores_everything(laser: str, pose: str) -> None:
    summary = run(laser={"preset": laser}, pose={"preset": pose}).summary
    assert summary["finished"]
    assert summary["coverage"] >= 0.98
    assert summary["claimed_worst_wall_f1"] >= 0.95
    assert summary["refuted_maps"] == []


BASELINES = ["slam-toolbox", "zstd-maps"]


@pytest.mark.parametrize("map_encoding", ["polygons", "scans", "cells", *BASELINES])
def test_every_encoding_shares_noisy_maps(map_encoding: str, tmp_path: Path) -> None:
    noisy: dict[str, Any] = {"laser": {"preset": "utm-30lx"}, "pose": {"preset": "graph-slam"}}
    summary = run(map_encoding=map_encoding, out=tmp_path / "run", **noisy).summary
    assert summary["finished"]
    assert summary["coverage"] >= 0.98
    assert summary["claimed_worst_wall_f1"] >= 0.95


@pytest.mark.parametrize("strategy", ["meier", "leaders", "burgard", "stop-scan-replan"])
def test_strategies_finish_with_real_sensors(strategy: str) -> None:
    assert run(strategy=strategy, laser={"preset": "utm-30lx"}).summary["finished"]


@pytest.mark.parametrize("seed", [0, 1, 3, 5, 10])
def test_a_robot_reports_the_end_once_its_teammate_holds_the_areas_that_it_has_found(seed: int) -> None:
    noisy: dict[str, Any] = {"laser": {"preset": "utm-30lx"}, "pose": {"preset": "graph-slam"}}
    team = Team(
        small_plan(
            map_seed=seed, seed=seed, robots=2, sensor_range=6.0, bandwidth=12, map_encoding="predictive",
            dissemination="gossip", strategy="repairmen", **noisy,
        )
    )  # fmt: skip
    team.explore(200)
    first = next(robot for robot, move in team.moves.items() if move.explored)
    robot, teammate = team.robots[first], team.robots[1 - first]
    found = (robot.own == FREE) & robot.settled
    assert 0.995 * found.sum() < (found & (teammate.planning != UNKNOWN)).sum()


def test_the_summary_tells_how_well_walls_fit_the_true_ones_and_each_other() -> None:
    result = run(laser={"preset": "utm-30lx"}, pose={"preset": "graph-slam"})
    summary, maps = result.summary, result.summary["robot_maps"]
    assert summary["tolerance"] == 1
    assert list(maps) == ["0", "1", "2"]
    for name in ("wall_precision", "wall_recall", "wall_f1"):
        values = [figures[name] for figures in maps.values()]
        assert summary[f"claimed_{name}"] == maps[str(summary["first_robot"])][name]
        assert summary[f"claimed_mean_{name}"] == pytest.approx(sum(values) / 3)
        assert summary[f"claimed_worst_{name}"] == min(values) >= 0.9
    held = [figures["worst_walls_within_tolerance"] for figures in maps.values()]
    assert 0.9 <= summary["worst_walls_within_tolerance"] == min(held)
    assert min(held) <= summary["walls_within_tolerance"] <= 1


def test_robots_hand_in_the_cells_of_which_they_are_certain() -> None:
    exact, noisy = run(steps=20).records, run(steps=20, laser={"preset": "rplidar-a1"}).records
    for robot in range(3):
        assert (exact.settled[robot] == (exact.own[robot] != UNKNOWN)).all()
        known = noisy.own[robot] != UNKNOWN
        assert 0 < noisy.settled[robot].sum() < known.sum()
        assert known[noisy.settled[robot]].all()


def test_walls_of_exact_maps_agree_exactly() -> None:
    summary = run().summary
    assert summary["finished"]
    assert summary["tolerance"] == 0
    assert summary["claimed_worst_wall_precision"] == 1
    assert summary["walls_within_tolerance"] > 0.99


def test_a_noisy_run_is_the_same_on_both_buses() -> None:
    noisy: dict[str, Any] = {"laser": {"preset": "rplidar-a1"}, "pose": {"preset": "graph-slam"}, "steps": 40}
    digests = {run(bus=bus, **noisy).summary["digest"] for bus in ("memory", "zenoh")}
    assert len(digests) == 1


@pytest.mark.parametrize("seed", [0, 1])
def test_a_noisy_run_on_a_narrow_medium_is_the_same_on_both_buses(seed: int) -> None:
    """Processes start with other contents of memory, on which results must not depend."""
    narrow: dict[str, Any] = {
        "laser": {"preset": "rplidar-a1"}, "robots": 2, "bandwidth": 12, "sensor_range": 5.0, "seed": seed,
    }  # fmt: skip
    digests = {run(bus=bus, **narrow).summary["digest"] for bus in ("memory", "zenoh")}
    assert len(digests) == 1


@pytest.mark.parametrize("map_encoding", BASELINES)
@pytest.mark.parametrize("dissemination", ["backoff", "gossip"])
def test_baselines_reach_late_robots_over_a_lossy_radio(map_encoding: str, dissemination: str) -> None:
    """A robot that restarts receives the maps of the others again, from robots that forward them, too."""
    late: dict[str, Any] = {
        "map_encoding": map_encoding, "dissemination": dissemination, "steps": 50, "range": "40%",
        "laser": {"preset": "rplidar-a1"}, "radio": {"loss": 0.1},
        "fault": [{"step": 20, "robot": 1, "kind": "restart"}],
    }  # fmt: skip
    result = run(**late)
    assert not result.records.protocol_errors.texts
    before = result.records.own[0] != UNKNOWN
    lacking = before & (result.records.own[1] == UNKNOWN)
    assert lacking.any()
    assert (result.records.planning[1] != UNKNOWN)[lacking].mean() > 0.8
    assert run(**late).summary["digest"] == result.summary["digest"]


@pytest.mark.parametrize("map_encoding", BASELINES)
def test_baselines_give_equal_digests_on_both_buses(map_encoding: str) -> None:
    noisy: dict[str, Any] = {"laser": {"preset": "rplidar-a1"}, "map_encoding": map_encoding, "steps": 30}
    digests = {run(bus=bus, **noisy).summary["digest"] for bus in ("memory", "zenoh")}
    assert len(digests) == 1


def test_baselines_send_more_than_the_predictive_encoding_and_less_than_all_raw_scans() -> None:
    noisy: dict[str, Any] = {"laser": {"preset": "rplidar-a1"}, "dissemination": "gossip", "steps": 40}
    sent = {
        name: run(map_encoding=name, **noisy).summary["bytes"]["total"]
        for name in ("predictive", "zstd-maps", "scans", "slam-toolbox")
    }
    assert list(sent) == sorted(sent, key=sent.__getitem__)


def test_a_turning_scanner_measures_a_sector_at_a_time() -> None:
    noisy: dict[str, Any] = {"laser": {"preset": "rplidar-a1"}, "scanner_turn": 72.0}
    assert run(strategy="stop-scan-replan", **noisy).summary["finished"]


def test_robots_map_no_farther_than_their_laser_measures() -> None:
    """Beams that meet nothing show free cells, which must not lie behind walls out of the laser's range."""
    far: dict[str, Any] = {"sensor_range": 11.0, "laser": {"max_range_m": 2.0, "range_error_m": 0.01}}
    result = run(**far)
    assert result.summary["claimed_worst_wall_f1"] >= 0.95
    assert result.summary["refuted_maps"] == []


def test_a_noisy_run_is_replayed_with_the_same_digest(tmp_path: Path) -> None:
    noisy: dict[str, Any] = {"laser": {"preset": "utm-30lx"}, "pose": {"preset": "graph-slam"}, "steps": 20}
    first = run(out=tmp_path / "run", **noisy)
    scenario = load(tmp_path / "run" / "scenario.toml", {"bus": "memory"})
    assert explore(scenario, keep=False).summary["digest"] == first.summary["digest"]


def test_a_preset_of_the_command_line_replaces_the_figures_of_a_scenario_file(tmp_path: Path) -> None:
    file = tmp_path / "scenario.toml"
    file.write_text(load(None, {"laser.preset": "utm-30lx", "pose.preset": "graph-slam"}).to_toml())
    changed = load(file, {"laser.preset": "rplidar-a1", "pose.preset": "exact"})
    wanted = load(None, {"laser.preset": "rplidar-a1"})
    assert changed.laser == wanted.laser
    assert changed.field_of_view == wanted.field_of_view
    assert changed.pose.is_exact


def test_an_unknown_laser_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"laser.preset = 'utm': there are|did you mean utm-30lx"):
        load(None, {"laser.preset": "utm"})


def test_values_of_the_scenario_take_precedence_over_a_preset() -> None:
    scenario = load(None, {"laser.preset": "utm-30lx", "laser.missing": 0.5, "field_of_view": 180.0})
    assert scenario.laser.missing == 0.5
    assert scenario.laser.range_error_m == 0.03
    assert scenario.field_of_view == 180
