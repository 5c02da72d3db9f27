"""Stepwise runs: each step agrees with the records, and the result with that of `explore`."""

from __future__ import annotations

import doctest
import gc
import threading

import numpy as np
import polars
import pytest

from deploy.run import stepwise
from deploy.scenario.errors import ScenarioError
from murmur import Step, explore, steps
from protocol.grid import FREE, UNKNOWN

SMALL = {"map": "em", "robots": 2, "steps": 12, "fault": [{"robot": 1, "step": 8, "kind": "death"}]}


def test_stepwise_run_equals_the_run_of_explore_and_its_records() -> None:
    result = explore(keep=False, bus="memory", **SMALL)
    run = steps(**SMALL)
    carried, known = [], 0
    for number, step in enumerate(run, 1):
        assert step.number == number
        assert set(step.robots) == ({0, 1} if number < 8 else {0})
        rows = result.steps.filter(polars.col("step") == number)
        assert step.explored == rows["team_seen"][0]
        for robot, row in zip(step.robots.values(), rows.iter_rows(named=True), strict=True):
            assert (robot.number, robot.x, robot.y) == (row["robot"], row["x"], row["y"])
            assert (robot.heading, robot.driven, robot.status) == (
                row["heading"],
                row["driven"],
                row["status"],
            )
            assert np.count_nonzero(robot.own != UNKNOWN) == row["known_cells"]
            assert robot.own[robot.cell[1], robot.cell[0]] == FREE
            assert (robot.target is None) == (row["target_x"] is None)
        assert step.traffic.equals(result.ledger.filter(polars.col("step") == number))
        carried.append(step.carried)
        team = np.count_nonzero(step.maps["team"] != UNKNOWN)
        assert team >= known or number == 8, "the map of a dead robot is lost"
        known = team
    assert number == 12
    assert sum(carried) == result.summary["bytes"]["total"] > 0
    assert run.result.summary["digest"] == result.summary["digest"]
    assert (run.result.maps["team"] == result.maps["team"]).all()
    assert list(run) == []


def test_the_example_of_the_reference_prints_its_output() -> None:
    assert doctest.testmod(stepwise) == (0, 2)


def test_a_run_that_is_left_leaves_nothing() -> None:
    threads = threading.active_count()
    with steps(**SMALL) as run:
        for step in run:
            if step.number == 3:
                break
        with pytest.raises(RuntimeError, match="the run has not ended"):
            _ = run.result
    assert list(run) == []
    assert threading.active_count() == threads
    next(steps(**SMALL))
    gc.collect()
    assert repr(run) == "<Steps of 2 robots on em>"
    assert repr(step) == f"<step 3: {100 * step.explored:.1f} % explored, 2 robots, {step.carried} bytes>"
    assert repr(step.robots[0]).startswith("<robot 0 at (")


def test_a_robot_s_map_cannot_be_written_to_and_copies_stay() -> None:
    run = steps(**SMALL)
    first: Step = next(run)
    kept = first.maps[0].copy()
    with pytest.raises(ValueError, match="read-only"):
        first.robots[0].own[0, 0] = FREE
    maps = first.maps
    next(run)
    assert (maps[0] == kept).all()


def test_a_wrong_setting_is_named_before_the_first_step() -> None:
    with pytest.raises(ScenarioError, match=r"robts: unknown setting; did you mean robots"):
        steps(robts=3)
