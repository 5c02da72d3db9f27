"""Whole runs of teams whose robots have different sensors: they explore everything, and repeat on both buses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from deploy.run.exploration import explore
from deploy.run.result import Result
from protocol.grid import UNKNOWN
from tests.system.team import Team, decoded, small_plan

SMALL: dict[str, Any] = {
    "map": "office", "map_options": {"width_m": 12.0, "height_m": 10.0}, "robots": 3, "seed": 5, "steps": 600,
    "bandwidth": "unlimited", "sensor_range": 4.0,
}  # fmt: skip

EXACT: dict[str, Any] = {
    "robot": [
        {"robot": 0, "sensor_range": 2.0},
        {"robot": 1, "field_of_view": 180.0, "radius": 0.15, "sensor_range": 6.0},
    ],
}  # fmt: skip
"""Exact lasers with different ranges and fields of view."""

NOISY: dict[str, Any] = {
    "pose": {"preset": "graph-slam"},
    "robot": [
        {"robot": 0, "laser": "rplidar-a1", "pose": "exact", "sensor_range": 6.0},
        {"robot": 1, "laser": {"preset": "sick-lms", "rate": 0.5}, "pose": "particle-filter", "radius": 0.15},
    ],
}  # fmt: skip
"""One laser without errors, and two with different errors, beams, fields of view, ranges, rates, and poses."""

KINDS = {"exact": EXACT, "noisy": NOISY}


def run(**settings: Any) -> Result:
    result = explore(**({"bus": "memory", "keep": False} | SMALL | settings))
    assert not result.records.protocol_errors.texts
    return result


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("map_encoding", ["predictive", "polygons", "cells", "scans"])
def test_a_team_with_different_sensors_explores_everything(kind: str, map_encoding: str) -> None:
    summary = run(map_encoding=map_encoding, finish="all", **KINDS[kind]).summary
    assert summary["finished"]
    assert summary["coverage"] >= 0.98
    assert summary["claimed_worst_wall_f1"] >= 0.95
    assert summary["refuted_maps"] == []


@pytest.mark.parametrize("map_encoding", ["slam-toolbox", "zstd-maps"])
def test_baselines_share_the_maps_of_different_lasers(map_encoding: str) -> None:
    summary = run(map_encoding=map_encoding, **NOISY).summary
    assert summary["finished"]
    assert summary["claimed_worst_wall_f1"] >= 0.95


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("map_encoding", ["predictive", "polygons", "cells", "scans"])
def test_a_run_with_different_sensors_is_the_same_on_both_buses(kind: str, map_encoding: str) -> None:
    settings = KINDS[kind] | {"map_encoding": map_encoding, "steps": 25, "bandwidth": 2000}
    digests = {run(bus=bus, **settings).summary["digest"] for bus in ("memory", "zenoh")}
    assert len(digests) == 1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("map_encoding", ["predictive", "cells", "scans"])
def test_whoever_holds_the_logs_decodes_the_maps_of_all_sensors(kind: str, map_encoding: str) -> None:
    settings = KINDS[kind] | {"map_encoding": map_encoding, "dissemination": "gossip", "robots": 3, "seed": 3}
    team = Team(small_plan("office", **settings))
    received = 0
    for _ in range(2):
        team.explore(team.step + 20)
        for robot in team.robots:
            planning, _ = decoded(robot, team.step)
            unseen = robot.own == UNKNOWN
            received += int((planning[unseen] != UNKNOWN).sum())
            assert np.array_equal(robot.planning[unseen], planning[unseen])
    assert not [error for robot in team.robots for error in robot.peer_errors]
    assert received


def test_each_robot_maps_and_scans_as_its_own_laser_can() -> None:
    settings: dict[str, Any] = {
        "range": 0, "steps": 12, "robots_collide": False,
        "robot": [
            {"robot": 0, "laser": {"max_range_m": 1.0}},
            {"robot": 1, "laser": "utm-30lx", "sensor_range": 8.0},
            {"robot": 2, "laser": {"rate": 0.1}},
        ],
    }  # fmt: skip
    own = run(**settings).records.own
    near, far, slow = (int(np.count_nonzero(own[robot])) for robot in range(3))
    assert near < far
    assert slow < far
    alone = run(**(settings | {"robot": settings["robot"][:2]})).records.own
    assert np.array_equal(alone[0], own[0]), "the sensors of others do not change what a robot measures"
    assert np.count_nonzero(alone[2]) > slow


def test_a_scanner_that_measures_seldom_must_not_turn() -> None:
    turning = {"robot": 1, "laser": {"rate": 0.5}, "scanner_turn": 90.0}
    with pytest.raises(
        ValueError, match=r"laser.rate = 0.5: a turning scanner \(scanner_turn\) measures in every"
    ):
        run(robot=[turning])
