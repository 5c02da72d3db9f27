"""Whole runs with the predictive encoding and gossip: no entry is lost, little is sent, and the ledger is correct."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from netshaper.ledger import KIND_NUMBER, NEWS, balance
from protocol.grid import UNKNOWN
from tests.system.team import Team, small_plan


def explored(**settings: Any) -> Team:
    team = Team(
        small_plan(
            "office", **({"map_encoding": "predictive", "dissemination": "gossip", "seed": 3} | settings)
        )
    )
    team.explore(600)
    assert any(move.explored for move in team.moves.values())
    assert not [error for robot in team.robots for error in robot.peer_errors]
    return team


def bytes_of(team: Team, kind: str) -> int:
    rows = team.ledger()
    return int(rows["bytes"][(rows["kind"] == KIND_NUMBER[kind]) & (rows["carried"] == 1)].sum())


@pytest.mark.parametrize("bandwidth", [20, 50, "unlimited"])
@pytest.mark.parametrize("base", ["team", "own"])
def test_planning_maps_are_correct_at_any_bandwidth(bandwidth: int | str, base: str) -> None:
    team = explored(robots=4, bandwidth=bandwidth, predictive={"base": base})
    for robot in team.robots:
        known = robot.planning != UNKNOWN
        assert (robot.planning == team.truth)[known].all()
    assert bytes_of(team, "conn") == 0, (
        "all robots are in range of each other, so no robot has anything to report"
    )


def test_with_unlimited_bandwidth_every_robot_knows_all_but_the_last_step_s_cells() -> None:
    team = explored(robots=4, bandwidth="unlimited")
    seen = np.max([robot.own for robot in team.robots], axis=0)
    for robot in team.robots:
        assert ((robot.planning != seen) & (seen != UNKNOWN)).mean() < 0.01


@pytest.mark.parametrize("seed", range(4))
def test_with_unlimited_bandwidth_robots_know_and_do_the_same_as_with_raw_scans(seed: int) -> None:
    scans, predictive = (
        Team(
            small_plan(
                "office", 16.0, robots=4, map_encoding=map_encoding, dissemination="gossip",
                bandwidth="unlimited", seed=seed,
            )
        )
        for map_encoding in ("scans", "predictive")
    )  # fmt: skip
    while not any(move.explored for move in scans.moves.values()):
        for team in (scans, predictive):
            team.explore(team.step + 1)
        for other, robot in zip(scans.robots, predictive.robots, strict=True):
            assert (robot.planning == other.planning).all(), (
                f"robot {robot.settings.robot}, step {scans.step}"
            )
        assert predictive.moves == scans.moves


@pytest.mark.parametrize("map_encoding", ["predictive", "scans", "polygons", "cells", "zstd-maps"])
@pytest.mark.parametrize("reach", ["25%", "100%"])
def test_every_sent_byte_is_carried_or_cut_within_the_budget(map_encoding: str, reach: str) -> None:
    team = Team(
        small_plan(
            "office", robots=5, map_encoding=map_encoding, dissemination="gossip", bandwidth=150, range=reach
        )
    )
    team.explore(60)
    rows = team.ledger()
    for step, (sent, carried, cut, _) in balance(rows).items():
        assert sent == carried + cut == team.sent_bytes[step]
        assert carried <= 150
    assert (rows["frame"] == NEWS).any()
    assert not [error for robot in team.robots for error in robot.peer_errors]


@pytest.mark.parametrize("map_encoding", ["predictive", "scans", "cells", "zstd-maps"])
def test_robots_that_part_and_meet_hold_equal_maps_in_the_end(map_encoding: str) -> None:
    team = explored(robots=5, map_encoding=map_encoding, bandwidth="unlimited", range="30%")
    together = dict(enumerate(team.plan.world.starts))
    for _ in range(40):
        team.stand(together)
    seen = np.max([robot.own for robot in team.robots], axis=0)
    for robot in team.robots:
        assert (robot.planning == seen).all()


def test_gossip_forwards_more_maps_than_offers_can_name() -> None:
    team = Team(
        small_plan(
            "office",
            robots=66,
            map_encoding="predictive",
            dissemination="gossip",
            bandwidth="unlimited",
            seed=3,
        )
    )
    team.explore(2)
    assert all(len(robot.replication.logs[65]) for robot in team.robots)
    assert not [error for robot in team.robots for error in robot.peer_errors]


def test_predictive_updates_imply_poses_so_that_fewer_pose_packets_are_sent() -> None:
    plans = [
        small_plan(
            "office",
            robots=4,
            map_encoding=map_encoding,
            dissemination="gossip",
            strategy="repairmen",
            seed=3,
        )
        for map_encoding in ("predictive", "scans")
    ]
    predictive, laser = (Team(plan) for plan in plans)
    for team in (predictive, laser):
        team.explore(60)
    assert 0 < bytes_of(predictive, "pose") < 0.7 * bytes_of(laser, "pose")


def test_predictive_with_gossip_takes_a_hundredth_of_the_bytes_of_raw_scans() -> None:
    predictive = explored(robots=3, bandwidth="unlimited")
    laser = explored(robots=3, bandwidth="unlimited", map_encoding="scans", dissemination="backoff")
    assert 100 * bytes_of(predictive, "update") < bytes_of(laser, "scan")


def test_gossip_does_not_send_targets_that_hardly_moved() -> None:
    fewer, every = (
        explored(robots=3, bandwidth="unlimited", map_encoding="scans", dissemination=dissemination)
        for dissemination in ("gossip", "backoff")
    )
    assert bytes_of(fewer, "targ") / fewer.step < bytes_of(every, "targ") / every.step
