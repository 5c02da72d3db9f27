"""What a robot knows of its pose: exact, or with the bounded error of SLAM and odometry that drifts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from protocol.transforms import Pose
from worldsim.localization import Localization
from worldsim.sensor_options import PoseOptions

START = Pose(3.0, 1.0, 2.0)


def drive(options: PoseOptions, robot: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Drive 400 s on a circle; return the errors (x, y, yaw) of the believed pose and of odometry, shape (n, 3)."""
    localization = Localization(START, options, 0.1, 5, robot)
    believed, odometry = [], []
    true = START
    for step in range(1, 4001):
        true = true.then(Pose(0.05, 0.0, 0.03))
        localization.move(true)
        exact = START.inverse().then(true)
        for errors, pose in ((believed, localization.believed(step / 10)), (odometry, localization.odometry)):
            turn = math.remainder(pose.yaw - exact.yaw, math.tau)
            errors.append((pose.x - exact.x, pose.y - exact.y, turn))
    return np.array(believed), np.array(odometry)


def test_exact_poses_are_relative_to_the_start_pose() -> None:
    believed, odometry = drive(PoseOptions())
    assert np.abs(believed).max() < 1e-9
    assert np.abs(odometry).max() < 1e-9


def test_slam_bounds_the_error_and_odometry_drifts() -> None:
    believed, odometry = drive(PoseOptions(position_error_m=0.05, heading_error_deg=0.4))
    assert 0.02 < np.abs(believed[:, :2]).max() <= 0.15 + 1e-3
    assert np.degrees(np.abs(believed[:, 2]).max()) <= 1.2 + 0.01
    assert np.abs(np.diff(believed[:, :2], axis=0)).max() < 0.005, "it varies slowly"
    assert np.hypot(*odometry[:, :2].T).max() > 0.3


def test_robots_have_errors_of_their_own() -> None:
    options = PoseOptions(position_error_m=0.05)
    assert drive(options, 0)[0][-1].tolist() != pytest.approx(drive(options, 1)[0][-1].tolist())
