"""A robot's information about its pose: odometry that drifts, and a map frame to which its SLAM corrects it.

The map frame is the robot's start pose. The error that SLAM leaves is that of `worldsim.pose_error`, which varies over
tens of seconds. Odometry measures each motion with a constant relative error, so it drifts without limit.
"""

from __future__ import annotations

import math

from protocol.keyed_random import keyed_random
from protocol.range_scans import TURN, UNIT
from protocol.transforms import Pose
from worldsim.pose_error import PoseError
from worldsim.sensor_options import PoseOptions

ODOMETRY_ERROR = 0.02
"""Standard deviation of the relative errors of measured distances and turns, unless poses are exact."""


class Localization:
    """The localization of one robot, which starts at pose `start`; `resolution` is the side of a cell in meters."""

    def __init__(self, start: Pose, options: PoseOptions, resolution: float, seed: int, robot: int) -> None:
        self.odometry = Pose(0.0, 0.0, 0.0)
        """Pose of the robot in the odometry's frame, which begins at the start pose."""
        self._start, self._true, self._resolution = start, start, resolution
        self._error = PoseError(options, resolution, seed, robot)
        errors = keyed_random(seed, "odometry", robot).standard_normal(2) * ODOMETRY_ERROR
        self._scales = (1.0, 1.0) if options.is_exact else (1.0 + float(errors[0]), 1.0 + float(errors[1]))

    def move(self, true: Pose) -> None:
        """Take the robot's next true pose, in the frame of the map."""
        motion = self._true.inverse().then(true)
        turn = math.remainder(motion.yaw, math.tau)
        distance, turning = self._scales
        measured = Pose(distance * motion.x, distance * motion.y, turning * turn)
        self.odometry = self.odometry.then(measured)
        self._true = true

    def believed(self, time_s: float) -> Pose:
        """Return the pose of the robot in its map frame, as SLAM estimates it at a time from the start."""
        second = math.floor(time_s)
        share = time_s - second
        before, after = self._error.at(second), self._error.at(second + 1)
        x, y, turn = (a + share * (b - a) for a, b in zip(before, after, strict=True))
        meters = self._resolution / UNIT
        error = Pose(0.0, 0.0, -self._start.yaw).then(Pose(x * meters, -y * meters, 0.0))
        exact = self._start.inverse().then(self._true)
        yaw = math.remainder(exact.yaw - turn / TURN * math.tau, math.tau)
        return Pose(exact.x + error.x, exact.y + error.y, yaw)
