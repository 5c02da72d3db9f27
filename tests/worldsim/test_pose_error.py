"""Errors of poses: bounded, slow, different for each robot, and the same whenever they are computed."""

from __future__ import annotations

import numpy as np
import pytest

from protocol.range_scans import TURN, UNIT
from worldsim.pose_error import PoseError
from worldsim.sensor_options import PoseOptions

OPTIONS = PoseOptions(position_error_m=0.05, heading_error_deg=0.4)
CELL = 0.1


def errors(robot: int, steps: int = 3000) -> np.ndarray:
    """Return the errors of a robot, in meters, meters and degrees."""
    error = PoseError(OPTIONS, CELL, 7, robot)
    units = np.array([CELL / UNIT, CELL / UNIT, 360 / TURN])
    return np.array([error.at(step) for step in range(steps)]) * units


def test_errors_are_bounded_and_have_the_given_deviation() -> None:
    given = np.array([0.05, 0.05, 0.4])
    found = np.array([errors(robot) for robot in range(20)]).reshape(-1, 3)
    assert (np.abs(found).max(axis=0) <= 3 * given).all()
    assert found.std(axis=0) == pytest.approx(given, rel=0.1)


def test_errors_vary_slowly() -> None:
    assert (np.abs(np.diff(errors(3), axis=0)).max(axis=0) < [0.03, 0.03, 0.2]).all()


def test_robots_have_errors_of_their_own() -> None:
    assert abs(np.corrcoef(errors(0)[:, 0], errors(1)[:, 0])[0, 1]) < 0.5


def test_exact_poses_have_no_error() -> None:
    assert PoseError(PoseOptions(), CELL, 7, 0).at(100) == (0, 0, 0)


def test_impossible_errors_are_refused() -> None:
    with pytest.raises(ValueError, match="position_error_m = 5"):
        PoseOptions(position_error_m=5)
