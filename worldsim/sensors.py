"""Real sensors of the robots: lasers with errors, and poses as localization knows them.

A robot plans in the frame in which it believes to be. The error of its pose shifts this frame against the true one.
This module shifts scans into the believed frame, and planned paths back into the true one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Bools, FloatRows
from protocol.grid import FINE, HEADINGS, Cell, Grid, Mask, Point
from protocol.keyed_random import keyed_random
from protocol.messages import Sense
from protocol.range_scans import NO_MEASUREMENT, TURN, UNIT, Laser, RangeScan, cell_offset, encode_range_scan
from worldsim.pose_error import PoseError
from worldsim.range_laser import NO_DISCS, RangeLaser
from worldsim.sensor_options import LaserOptions, PoseOptions


@dataclass(frozen=True)
class RobotSensors:
    """The sensors of one robot."""

    laser: LaserOptions
    pose: PoseOptions
    beams: Laser


@dataclass(frozen=True)
class SensorSettings:
    """Settings of real sensors."""

    robots: tuple[RobotSensors, ...]
    resolution: float
    """Side of a cell in meters."""


class Sensors:
    """The sensors of all robots; errors are drawn from the seed, by robot and step."""

    def __init__(self, settings: SensorSettings, seed: int) -> None:
        self._seed, self._settings = seed, settings
        resolution = settings.resolution
        self._lasers = [RangeLaser(each.laser, each.beams, resolution) for each in settings.robots]
        self._errors = [
            PoseError(each.pose, resolution, seed, robot) for robot, each in enumerate(settings.robots)
        ]

    def has_exact_pose(self, robot: int) -> bool:
        """Return whether the pose that a robot believes in is always the true one."""
        return self._settings.robots[robot].pose.is_exact

    def true_points(self, robot: int, step: int, path: list[Cell], points: list[Point]) -> list[Point]:
        """Return the true waypoints of a path or of waypoints that a robot has planned in a step."""
        x, y, _ = self._errors[robot].at(step)
        shift_x, shift_y = round(x * FINE / UNIT), round(y * FINE / UNIT)
        planned = points or [(column * FINE, row * FINE) for column, row in path]
        return [(column - shift_x, row - shift_y) for column, row in planned]

    def sense(
        self,
        robot: int,
        exact: Sense,
        truth: Grid,
        teammates: Mask,
        active: Bools,
        people: FloatRows = NO_DISCS,
    ) -> Sense:
        """Return a robot's readings, given its true pose and the readings of exact sensors.

        `truth` and `teammates` have shape (h, w). `active`, shape (beams,), marks the beams that the scanner sends.
        `people`, shape (n, 3), are discs (`worldsim.people.People.discs`).
        """
        step = exact.step
        place = _units(exact.x, exact.offset_x), _units(exact.y, exact.offset_y)
        turn = exact.heading * TURN // HEADINGS
        random = keyed_random(self._seed, "laser", robot, step)
        position = place[0] / UNIT, place[1] / UNIT
        ranges = self._lasers[robot].ranges(truth, teammates, position, turn, random, people)
        ranges[~active] = NO_MEASUREMENT
        error_x, error_y, error_turn = self._errors[robot].at(step)
        height, width = truth.shape
        x = min(max(place[0] + error_x, 0), width * UNIT - 1)
        y = min(max(place[1] + error_y, 0), height * UNIT - 1)
        scan = RangeScan((x, y), (turn + error_turn) % TURN, ranges)
        return Sense(
            step, scan.x, scan.y, exact.heading, b"", b"", exact.blocked,
            cell_offset(x), cell_offset(y), encode_range_scan(scan),
        )  # fmt: skip

    def beam_degrees(self, robot: int) -> NDArray[np.float64]:
        """Return the angle of each beam relative to the heading, in degrees."""
        return self._settings.robots[robot].beams.angles.astype(np.float64) * (360 / TURN)


def _units(cell: int, offset: int) -> int:
    """Return a position, given as a cell and thousandths of a cell from its center, in 1 / `UNIT` cell."""
    return (cell * FINE + FINE // 2 + offset) * UNIT // FINE
