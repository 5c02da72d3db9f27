"""A ROS 2 robot of the tests: it publishes scans, transforms, and its map, and drives to the goals that it gets."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np

from agent.bodies.team_map import occupancy_grid
from protocol.grid import FREE, Grid
from protocol.range_scans import UNIT
from protocol.ros2 import messages as names
from protocol.ros2.actions import ServerGoal, Status
from protocol.ros2.attachments import Attachment
from protocol.ros2.interfaces import NAVIGATE_TO_POSE
from protocol.ros2.node import Ros2Node
from protocol.ros2.qos import DEFAULT, LATCHED, SENSOR, TF, TF_STATIC
from protocol.transforms import Pose
from tests.agent.bodies.ros_house import WHERE, RosRobot

REFUSED_CELLS = 5
PERIOD_S = 0.05
"""Seconds between two scans; the robot drives `cells` cells in each."""


class RosHouseNode:
    """A robot in a house, on a thread of its own; `start` is its pose in the common frame.

    `refuses` are cells of the team's grid, (x, y), near which it aborts goals of the action. Without `drives`, it is
    stuck where it is.
    """

    def __init__(
        self,
        router: str,
        truth: Grid,
        start: Pose,
        namespace: str = "/",
        *,
        has_action: bool = False,
        drives: bool = True,
        has_map: bool = True,
        refuses: tuple[tuple[int, int], ...] = (),
    ) -> None:
        self.node = Ros2Node("house_robot", namespace, router=router)
        self.goals: list[tuple[float, float]] = []
        """Positions of all goals, in its map frame."""
        self.cancels = 0
        self.ended: list[Status] = []
        self.sends_scans = True
        self.team_map: Any = None
        self.statuses: list[str] = []
        self.markers: Any = None
        self._robot = RosRobot(self.node.messages, truth, start, cells_per_step=2)
        self._truth, self._start, self._refuses, self._drives = truth, start, refuses, drives
        self._goal: Any = None
        self._task: ServerGoal | None = None
        self._is_aborting = self._is_canceling = False
        self._transforms = self.node.publisher("tf", names.TRANSFORMS, TF)
        self._scan = self.node.publisher("scan", names.LASER_SCAN, SENSOR)
        static = self.node.publisher("tf_static", names.TRANSFORMS, TF_STATIC)
        static.publish(self._robot.static_transforms(), time.time_ns())
        own_map = self.node.publisher("map", names.OCCUPANCY_GRID, LATCHED)
        if has_map:
            own_map.publish(self._own_map(), time.time_ns())
        if has_action:
            self.node.action_server("navigate_to_pose", NAVIGATE_TO_POSE, self._accept, self._cancel)
        self.node.subscription("goal_pose", names.POSE_STAMPED, DEFAULT, self._take)
        self.node.subscription("team_map", names.OCCUPANCY_GRID, LATCHED, self._see_map)
        self.node.subscription("murmur/status", names.STRING, DEFAULT, self._see_status)
        self.node.subscription("murmur/markers", names.MARKERS, DEFAULT, self._see_markers)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    @property
    def cell(self) -> tuple[int, int]:
        """Its cell in the team's grid."""
        return self._robot.cell

    def close(self) -> None:
        """End the thread, and the node."""
        self._over.set()
        self._thread.join(10)
        self.node.close()

    def _live(self) -> None:
        while not self._over.wait(PERIOD_S):
            now = time.time_ns()
            self.node.spin(now)
            for flag, status in (("_is_aborting", Status.ABORTED), ("_is_canceling", Status.CANCELED)):
                if getattr(self, flag):
                    setattr(self, flag, False)
                    self._end(status)
            if self._goal is not None and self._drives:
                self._drive()
            self._transforms.publish(self._robot.transforms(now), now)
            if self.sends_scans:
                self._scan.publish(self._robot.scan(now), now)

    def _drive(self) -> None:
        before = self.cell
        self._robot.drive(self._goal)
        if self.cell == before:
            self._goal = None
            self._end(Status.SUCCEEDED)

    def _take(self, message: Any, _: Attachment | None = None) -> None:
        self.goals.append((message.pose.position.x, message.pose.position.y))
        self._goal = message

    def _accept(self, goal: ServerGoal) -> bool:
        self._end(Status.ABORTED)  # a new goal replaces the last one, as in nav2
        self._task = goal
        position = goal.message.pose.pose.position
        x, y = WHERE.place(self._start.then(Pose(position.x, position.y, 0.0)))
        self._take(goal.message.pose)
        for column, row in self._refuses:
            if np.hypot(x / UNIT - column, y / UNIT - row) < REFUSED_CELLS:
                self._goal, self._is_aborting = None, True
        return True

    def _cancel(self, goal: ServerGoal) -> bool:
        self.cancels += 1
        self._goal, self._is_canceling = None, True
        return True

    def _end(self, status: Status) -> None:
        if self._task is not None and not self._task.status.is_end:
            result = self.node.messages.new(f"{NAVIGATE_TO_POSE}_Result")
            self._task.end(status, result, time.time_ns())
            self.ended.append(status)
        self._task = None

    def _own_map(self) -> Any:
        """Return the map of its SLAM: it knows the whole house."""
        return occupancy_grid(self.node.messages, self._truth, WHERE, self._start, "map", time.time_ns())

    def _see_map(self, message: Any, _: Attachment) -> None:
        self.team_map = message

    def _see_status(self, message: Any, _: Attachment) -> None:
        self.statuses.append(message.data)

    def _see_markers(self, message: Any, _: Attachment) -> None:
        self.markers = message


def known_share(team_map: Any, truth: Grid) -> float:
    """Return the share of the free cells of the house that a team map shows as free."""
    shown = np.asarray(team_map.data).reshape(truth.shape)[::-1]
    free = truth == FREE
    return float(np.count_nonzero(shown[free] == 0) / np.count_nonzero(free))
