"""Decisions of strategies for scanners that turn, worked out by hand on small maps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from agent.planning.path_planner import PathPlanner
from agent.strategies.base import TeammatePose
from agent.strategies.rotating import ShengBid
from tests.agent.planning.planning_references import drawn, settings_for
from tests.agent.strategies.deciding import CORRIDOR, make_strategy, robot_at


def test_stop_scan_replan_stays_for_a_full_turn_and_then_publishes() -> None:
    settings: dict[str, Any] = {"scanner_turn": 72.0, "speed_cells": 1.0}
    swarm = make_strategy("stop-scan-replan", **settings)
    decisions = [swarm.decide(robot_at(4)) for _ in range(5)]
    assert [decision.target for decision in decisions] == [None] * 4 + [(0, 1)]
    assert [decision.publish for decision in decisions] == [True] * 5
    assert not swarm.decide(robot_at(3)).publish
    assert settings_for(CORRIDOR, **settings).body.turn_steps == 5


def test_classical_does_not_scan_on_the_way() -> None:
    swarm = make_strategy("classical", scanner_turn=0.0)
    assert swarm.decide(robot_at(4)).target is not None
    assert not swarm.decide(robot_at(3)).look


def test_classical_scans_where_an_unknown_wall_stops_it() -> None:
    swarm = make_strategy("classical", scanner_turn=0.0)
    assert swarm.decide(robot_at(4)).target is not None
    assert swarm.decide(replace(robot_at(3), blocked="wall")).look


def test_a_robot_stopped_for_long_publishes_its_map() -> None:
    swarm = make_strategy("stop-scan-replan")
    assert swarm.decide(robot_at(4)).target == (0, 1)
    published = [
        swarm.decide(replace(robot_at(3), step=step, blocked="robot")).publish for step in range(2, 14)
    ]
    assert sum(published) == 1


def test_scan_replan_keeps_an_opened_target_and_continuous_replan_does_not() -> None:
    opened = CORRIDOR.copy()
    opened[0, 0] = 2
    for name, expected in (("scan-replan", (0, 1)), ("continuous-replan", (14, 1))):
        swarm = make_strategy(name)
        assert swarm.decide(robot_at(4)).target == (0, 1)
        after = swarm.decide(robot_at(3, grid=opened))
        assert after.target == expected
        assert after.publish == (name == "continuous-replan")


def test_a_bid_is_that_of_equation_1() -> None:
    grid = drawn("??????", "......", "######")
    bids = make_strategy(
        "sheng-bid", {"gain": 2.0, "distance": 0.5, "nearness": 0.25}, grid, ranges_cells=[2.0, 2.0]
    )
    assert isinstance(bids, ShengBid)
    goals = np.array([(0, 1), (3, 1)], np.int32)
    # In a disc of two cells around (0, 1) lie (0, 0) and (1, 0); around (3, 1) three cells.
    expected = [
        2.0 * 2 / (4 * np.pi) - 0.5 * 1 / 2,
        2.0 * 3 / (4 * np.pi) - 0.5 * 2 / 2,
    ]
    situation = robot_at(1, grid=grid)
    np.testing.assert_allclose(bids.bids(situation, goals, PathPlanner(grid)), expected)
    # A teammate at (5, 1) will see all that (3, 1) shows but (2, 0) and (3, 0).
    near = replace(situation, poses={1: TeammatePose(5, 1, False)})
    seen_by_it = 2.0 * (3 - 1) / (4 * np.pi)
    np.testing.assert_allclose(
        bids.bids(near, goals, PathPlanner(grid))[1], seen_by_it - 0.5 * 2 / 2 - 0.25 * 2 / 2
    )
    # So will a teammate that is headed there, at an unknown distance.
    headed = replace(situation, targets={1: (5, 1)})
    np.testing.assert_allclose(bids.bids(headed, goals, PathPlanner(grid))[1], seen_by_it - 0.5 * 2 / 2)
