"""Whole runs that share tiles: every receiver decodes what the author sent."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from deploy.run.exploration import explore
from protocol.grid import UNKNOWN
from tests.system.team import Team, decoded, small_plan

NOISY: dict[str, Any] = {"laser": {"preset": "rplidar-a1"}, "pose": {"preset": "graph-slam"}}


def tile_team(**settings: Any) -> Team:
    common: dict[str, Any] = {
        "robots": 3,
        "map_encoding": "predictive",
        "dissemination": "gossip",
        "strategy": "repairmen",
        "seed": 3,
    }
    return Team(small_plan("office", **(common | NOISY | settings)))


@pytest.mark.parametrize(
    "settings",
    [
        {"bandwidth": "unlimited"},
        {"bandwidth": 5},
        {"bandwidth": 15},
        {"bandwidth": 25, "predictive": {"base": "own"}},
        {"bandwidth": 25, "range": "40%"},
        {"bandwidth": 50, "predictive": {"base": "own"}},
        {"bandwidth": 50, "radio": {"frame_bytes": 20}},
        {"bandwidth": 50, "tolerance": 0},
        {"bandwidth": 50, "laser": {}, "pose": {}, "tolerance": 1},
        {"bandwidth": 100, "robot": [{"robot": 1, "sensor_range": 1.5}]},
        {"bandwidth": 100, "radio": {"loss": 0.2}, "digests": True},
    ],
    ids=[
        "unlimited", "5 B", "15 B", "25 B, base own", "25 B, range 40 %", "base own", "short frames", "tolerance 0",
        "exact lasers", "a short range", "loss and digests",
    ],
)  # fmt: skip
def test_whoever_holds_the_logs_of_a_robot_decodes_its_map(settings: dict[str, Any]) -> None:
    team = tile_team(**settings)
    received = 0
    for _ in range(3):
        team.explore(team.step + 20)
        for robot in team.robots:
            planning, shared = decoded(robot, team.step)
            unseen = robot.own == UNKNOWN
            received += int((planning[unseen] != UNKNOWN).sum())
            assert np.array_equal(robot.planning[unseen], planning[unseen])
            assert np.array_equal(robot.shared, shared)
    assert not [error for robot in team.robots for error in robot.peer_errors]
    assert received or settings["bandwidth"] == 5


@pytest.mark.parametrize("dissemination", ["backoff", "gossip"])
def test_a_robot_that_restarts_continues_from_its_journal_over_a_lossy_radio(dissemination: str) -> None:
    late: dict[str, Any] = {
        "map": "office", "map_options": {"width_m": 12.0, "height_m": 10.0}, "robots": 3, "seed": 5, "steps": 60,
        "sensor_range": 4.0, "bus": "memory", "bandwidth": 200, "dissemination": dissemination, "digests": True,
        "radio": {"loss": 0.1}, "fault": [{"step": 15, "robot": 1, "kind": "restart"}],
    }  # fmt: skip
    result = explore(keep=False, **late, **NOISY)
    assert not result.records.protocol_errors.texts
    lacking = (result.records.own[0] != UNKNOWN) & (result.records.own[1] == UNKNOWN)
    assert lacking.any()
    assert (result.records.planning[1] != UNKNOWN)[lacking].mean() > 0.5
    assert explore(keep=False, **late, **NOISY).summary["digest"] == result.summary["digest"]
