"""The stages of merging, drawn for a step of a finished run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deploy.after.archive import read
from deploy.after.merging import merging
from deploy.run.exploration import explore
from deploy.scenario.scenario import ScenarioError, load
from deploy.scenario.thesis import thesis_settings
from tests.deploy.small_run import SETTINGS, small_directory


def test_the_last_stage_is_the_planning_map_of_the_thesis_rules(tmp_path: Path) -> None:
    explore(load(None, SETTINGS | thesis_settings({})), out=tmp_path / "run")
    archive = read(tmp_path / "run")
    planning = archive.maps.planning(1, 20)
    assert planning is not None
    ys, xs = np.nonzero(planning)
    expected = planning[max(0, ys.min() - 3) : ys.max() + 4, max(0, xs.min() - 3) : xs.max() + 4]
    for step in (20, 23):
        drawn = merging(archive, 1, step).axes[-1].images[0].get_array()
        np.testing.assert_array_equal(drawn, expected)


def test_unknown_robots_and_steps_are_refused() -> None:
    archive = read(small_directory())
    assert len(merging(archive, 0, 20).axes) == 6
    with pytest.raises(ScenarioError, match="robot 0 reports maps from step 5 to 40"):
        merging(archive, 0, 41)
    with pytest.raises(ScenarioError, match="robot = 7: must be at most 2"):
        merging(archive, 7, 5)
