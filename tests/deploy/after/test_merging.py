"""The stages of merging, drawn for a step of a finished run."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.after.archive import read
from deploy.after.merging import merging, stages_figure
from deploy.run.repeat import robots_at
from deploy.scenario import plan as plans
from deploy.scenario.scenario import ScenarioError, load
from deploy.scenario.thesis import thesis_settings
from tests.deploy.small_run import SETTINGS, small_directory, small_plan, told

STEP = 20


def test_a_run_is_repeated_up_to_a_step_with_all_that_its_robots_hold_then() -> None:
    robots = robots_at(small_plan(), STEP)
    known = {
        sender: said.known
        for sender, said in told()
        if type(said).__name__ == "MindReport" and getattr(said, "step", 0) == STEP
    }
    assert {f"r{robot.settings.robot}": robot.known_cells for robot in robots} == known


def test_the_last_stage_is_what_the_robot_plans_on_by_the_rules_of_the_thesis() -> None:
    plan = plans.make(load(None, SETTINGS | thesis_settings("meier")))
    robot = robots_at(plan, STEP)[1]
    figure = stages_figure(robot, STEP)
    last = figure.axes[-1].images[0].get_array()
    ys, xs = np.nonzero(robot.planning)
    shown = robot.planning[max(0, ys.min() - 3) : ys.max() + 4, max(0, xs.min() - 3) : xs.max() + 4]
    np.testing.assert_array_equal(last, shown)


def test_what_cannot_be_drawn_is_refused() -> None:
    archive = read(small_directory())
    assert len(merging(archive, 0, STEP).axes) == 6
    with pytest.raises(ScenarioError, match="the run has the steps 1 to 40"):
        merging(archive, 0, 41)
    with pytest.raises(ScenarioError, match="at step 5 there are 0, 1, 2"):
        merging(archive, 7, 5)
