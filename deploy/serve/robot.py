"""One simulated robot as its ROS stack sees it: its poses, its last scan, its own map, and where it is to drive.

It obeys velocity commands while they are fresh, else it drives to its goal. A new goal replaces the last one. Goals
and poses are in the robot's map frame, which begins at its start pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from agent.mapping.estimator import Estimator
from deploy.serve.giving_way import Others
from deploy.serve.navigator import TURN_SPEED, Navigator, Outcome
from protocol.arrays import Uint16s
from protocol.boxes import NO_BOX, box_of
from protocol.grid import UNKNOWN, Grid
from protocol.map_frame import MapFrame
from protocol.range_scans import UNIT, Laser, RangeScan, beam_ends
from protocol.transforms import Pose
from worldsim.localization import Localization
from worldsim.velocity_world import STOP, Velocity

COMMAND_NS = 500_000_000
"""Time for which a velocity command holds."""
SAME_M = 0.3
"""Distance between two goals up to which the second one repeats the first: a robot that is stuck remains so."""
MARGIN_M = 1.0
"""Width of the strip around the true map that a robot's own map has, since its poses have errors."""


@dataclass(eq=False)
class Task:
    """A goal in the robot's map frame, and how it ended; None while the robot drives."""

    goal: Pose
    began_ns: int
    outcome: Outcome | None = None


class SimulatedRobot:
    """One robot.

    `start` is its first pose in the common frame (meters, and radians counterclockwise), in which the true map lies in
    `area`. `laser_pose` is the pose of the scanner on the robot, `speed` the largest speed in meters per second.
    """

    def __init__(
        self,
        start: Pose,
        area: MapFrame,
        laser: Laser,
        laser_pose: Pose,
        navigator: Navigator,
        localization: Localization,
        speed: float,
    ) -> None:
        self.start, self.laser, self.laser_pose = start, laser, laser_pose
        self.navigator = navigator
        self.task: Task | None = None
        """The last goal."""
        self.velocity = STOP
        """Velocity of this step."""
        self.blocked = ""
        """What stopped the robot in this step; empty if nothing did."""
        self.pose = localization.believed(0.0)
        """Pose in the map frame, as SLAM estimates it."""
        self.ranges: Uint16s = np.zeros(laser.beams, np.uint16)
        """The last scan (`protocol.range_scans`), beams clockwise."""
        self.true = start
        """True pose in the common frame."""
        self.localization, self._speed = localization, speed
        self._map_area = _around(area, start)
        self._estimator = Estimator(self._map_area.height, self._map_area.width)
        self._command, self._command_until = STOP, 0

    def command(self, velocity: Velocity, now_ns: int) -> None:
        """Obey a velocity for a while, within the robot's limits; ValueError if it is not a number."""
        if not (math.isfinite(velocity.ahead) and math.isfinite(velocity.turn)):
            raise ValueError("the velocity is not a number")
        ahead = max(-self._speed, min(self._speed, velocity.ahead))
        turn = max(-TURN_SPEED, min(TURN_SPEED, velocity.turn))
        self._command, self._command_until = Velocity(ahead, turn), now_ns + COMMAND_NS

    def go(self, goal: Pose, now_ns: int) -> Task:
        """Drive to a goal from the next step on; it may turn out to be unreachable at once."""
        before, self.task = self.task, Task(goal, now_ns)
        is_new = True
        if before is not None and before.outcome is None:
            before.outcome = Outcome.REPLACED
            is_new = math.dist(before.goal[:2], goal[:2]) > SAME_M
        if not self.navigator.plan(self.true, self._to_true(goal), is_new=is_new):
            self.task.outcome = Outcome.UNREACHABLE
        return self.task

    def cancel(self, task: Task) -> None:
        """Stop driving to a goal."""
        if task.outcome is None:
            task.outcome = Outcome.CANCELED

    @property
    def is_driving(self) -> bool:
        """Whether it drives to a goal."""
        return self.task is not None and self.task.outcome is None

    def decide(self, now_ns: int, others: Others) -> Velocity:
        """Return the velocity of the next step."""
        task = self.task
        if now_ns < self._command_until:
            self.velocity = self._command
        elif task is None or task.outcome is not None:
            self.velocity = STOP
        else:
            goal = self._to_true(task.goal)
            self.velocity, task.outcome = self.navigator.steer(self.true, goal, self.blocked, others)
        return self.velocity

    def moved(self, true: Pose, blocked: str, time_s: float) -> None:
        """Take the true pose after a step, and what blocked the robot."""
        self.true, self.blocked = true, blocked
        self.localization.move(true)
        self.pose = self.localization.believed(time_s)

    def look(self, ranges: Uint16s) -> None:
        """Take a scan at this pose, and add it to the robot's own map."""
        self.ranges = ranges
        pose, area = self.pose.then(self.laser_pose), self._map_area
        scan = RangeScan(area.place(pose), area.heading(pose), ranges)
        if area.has(scan.place):
            self._estimator.add(*scan.place, *beam_ends(scan, self.laser, area.resolution))
            x, y = area.place(self.pose)
            self._estimator.stand(x // UNIT, y // UNIT)

    def own_map(self) -> tuple[Grid, MapFrame]:
        """Return the part of its map frame that the robot knows, and where it lies."""
        states, area = self._estimator.states, self._map_area
        box = box_of(states != UNKNOWN)
        if box == NO_BOX:
            return states[:1, :1], MapFrame(1, 1, area.resolution, area.x, area.y)
        left, top, right, bottom = box
        x, y = area.position(float(left), float(bottom))
        part = np.ascontiguousarray(states[top:bottom, left:right])
        return part, MapFrame(right - left, bottom - top, area.resolution, x, y)

    def _to_true(self, goal: Pose) -> Pose:
        """Return the true pose at which the robot would believe to be at `goal`, a pose in its map frame."""
        return self.true.then(self.pose.inverse().then(goal))


def _around(area: MapFrame, start: Pose) -> MapFrame:
    """Return a grid in the map frame of a robot that started at `start`, which contains the true map."""
    corners = [
        start.inverse().then(Pose(*area.position(column, row), 0.0))
        for column in (0, area.width)
        for row in (0, area.height)
    ]
    left, bottom = (min(corner[axis] for corner in corners) - MARGIN_M for axis in (0, 1))
    right, top = (max(corner[axis] for corner in corners) + MARGIN_M for axis in (0, 1))
    # The start pose is the center of a cell, so that walls of the true map fill whole cells.
    cell = area.resolution
    left, bottom = (-(math.ceil(-side / cell) + 0.5) * cell for side in (left, bottom))
    width, height = math.ceil((right - left) / cell), math.ceil((top - bottom) / cell)
    return MapFrame(width, height, cell, left, bottom)
