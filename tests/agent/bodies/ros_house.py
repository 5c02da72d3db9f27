"""A robot with ROS 2 in a house of two rooms: it scans, sends transforms, and drives to goals as nav2 does."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter

from protocol.grid import FREE, OCCUPIED, Grid
from protocol.map_frame import MapFrame
from protocol.range_scans import UNIT
from protocol.ros2 import messages as names
from protocol.ros2.messages import Messages, nanoseconds
from protocol.transforms import Pose

WHERE = MapFrame(62, 42, 0.1, -1.0, -1.0)
BEAMS, REACH_M = 180, 4.0
MARCH_M = 0.01
TRANSFORM = "geometry_msgs/msg/TransformStamped"
RADIUS_CELLS = 2
LASER_AHEAD = Pose(0.1, 0.0, 0.0)
"""Where the laser is on the robot."""


def house() -> Grid:
    """Return two rooms with a door; around them is one row of cells that no laser sees."""
    truth = np.full((WHERE.height, WHERE.width), OCCUPIED, np.uint8)
    truth[2:-2, 2:-2] = FREE
    truth[:, 30] = OCCUPIED
    truth[18:26, 30] = FREE
    truth[8:12, 10:14] = OCCUPIED
    return truth


class RosRobot:
    """The robot; `start` is its start pose in the frame of the team, where the map frame of its SLAM begins."""

    def __init__(self, messages: Messages, truth: Grid, start: Pose, cells_per_step: int) -> None:
        self._messages, self._truth, self._start = messages, truth, start
        self._floor = maximum_filter(truth == OCCUPIED, 2 * RADIUS_CELLS + 1) == 0
        self._cells_per_step = cells_per_step
        self._pose = Pose(0.0, 0.0, 0.0)
        """In its map frame."""

    @property
    def cell(self) -> tuple[int, int]:
        """Its cell in the grid of the team."""
        return self._cell(self._pose)

    def transforms(self, now_ns: int) -> Any:
        """Return where it is, as a message of ``tf``."""
        return self._tf(
            ("map", "odom", Pose(0.0, 0.0, 0.0)), ("odom", "base_link", self._pose), now_ns=now_ns
        )

    def static_transforms(self) -> Any:
        """Return where its laser is, as a message of ``tf_static``."""
        return self._tf(("base_link", "laser", LASER_AHEAD), now_ns=0)

    def scan(self, now_ns: int) -> Any:
        """Return a laser scan, beams counterclockwise from straight ahead."""
        laser = self._start.then(self._pose).then(LASER_AHEAD)
        angles = laser.yaw + np.arange(BEAMS) * 2 * np.pi / BEAMS
        way = np.arange(0.0, REACH_M, MARCH_M)[:, None]
        columns = np.floor((laser.x + way * np.cos(angles) - WHERE.x) / WHERE.resolution).astype(int)
        rows = np.floor(WHERE.height - (laser.y + way * np.sin(angles) - WHERE.y) / WHERE.resolution).astype(
            int
        )
        hit = self._truth[rows.clip(0, WHERE.height - 1), columns.clip(0, WHERE.width - 1)] == OCCUPIED
        ranges = np.where(hit.any(axis=0), hit.argmax(axis=0) * MARCH_M, np.inf).astype(np.float32)
        return self._messages.new(
            names.LASER_SCAN,
            header=self._messages.header("laser", now_ns),
            angle_increment=2 * np.pi / BEAMS,
            range_min=0.02,
            range_max=REACH_M,
            ranges=ranges,
        )

    def drive(self, goal: Any) -> None:
        """Drive towards a goal, a message of ``goal_pose`` in the map frame, or near it, for one step."""
        assert goal.header.frame_id == "map"
        assert nanoseconds(goal.header.stamp) > 0
        position = goal.pose.position
        way = self._way(self._cell(Pose(position.x, position.y, 0.0)))[: self._cells_per_step]
        if way:
            x, y = WHERE.position(way[-1][0] + 0.5, way[-1][1] + 0.5)
            there = self._start.inverse().then(Pose(x, y, 0.0))
            ahead = np.arctan2(there.y - self._pose.y, there.x - self._pose.x)
            self._pose = Pose(there.x, there.y, float(ahead))

    def _cell(self, pose: Pose) -> tuple[int, int]:
        x, y = WHERE.place(self._start.then(pose))
        return x // UNIT, y // UNIT

    def _way(self, goal: tuple[int, int]) -> list[tuple[int, int]]:
        """Return the cells of a shortest path to the reachable cell nearest to a goal."""
        steps = {self.cell: self.cell}
        queue = deque([self.cell])
        while queue:
            x, y = queue.popleft()
            for there in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
                if there not in steps and self._floor[there[1], there[0]]:
                    steps[there] = x, y
                    queue.append(there)
        at = min(steps, key=lambda cell: (math.dist(cell, goal), cell))
        way = []
        while at != self.cell:
            way.append(at)
            at = steps[at]
        return way[::-1]

    def _tf(self, *edges: tuple[str, str, Pose], now_ns: int) -> Any:
        found = []
        for parent, child, pose in edges:
            each = self._messages.new(
                TRANSFORM, header=self._messages.header(parent, now_ns), child_frame_id=child
            )
            each.transform.translation.x, each.transform.translation.y = pose.x, pose.y
            each.transform.rotation = self._messages.pose(*pose).orientation
            found.append(each)
        return self._messages[names.TRANSFORMS](transforms=found)
