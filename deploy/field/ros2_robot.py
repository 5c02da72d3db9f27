"""A ROS 2 robot: the node that talks to it, as the body of a robot's control logic (`agent.field.Body`)."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from agent.bodies.goals import GoalTracker
from agent.bodies.markers import layers, marker_array
from agent.bodies.team_map import occupancy_grid
from agent.robot import Robot
from deploy.field.connection import make_body, map_pose, open_node, sources
from deploy.field.goals import GoalSender
from deploy.field.robot_file import RobotSettings
from deploy.field.robot_plan import map_frame
from protocol.grid import Cell, Grid
from protocol.messages import Move, Sense
from protocol.nanoseconds import SECOND
from protocol.range_scans import Laser
from protocol.ros2.messages import MARKERS, OCCUPANCY_GRID, STRING
from protocol.ros2.qos import LATCHED

REPEAT_S = 10.0
"""Seconds after which a goal is sent again if the robot, which may have missed it, has not moved."""
CANCEL_S = 1.0
"""Seconds for which the end of the program waits for the answer to a canceled goal."""


class Ros2Robot:
    """The node of one robot, and its body; ValueError if no router answers, or a name in the settings is wrong."""

    def __init__(self, settings: RobotSettings) -> None:
        names = settings.ros2
        self._settings, self._names = settings, names
        self._grid = map_frame(settings)
        self._map_pose = map_pose(names)
        self._body = make_body(settings)
        self._tracker = GoalTracker(round(settings.patience_s * SECOND))
        self._scanned: tuple[int | None, int] = (None, time.monotonic_ns())
        """Time stamp of the last known pose, and when it arrived."""
        self._sent = 0
        """When the goal was sent."""
        self.measures = True
        """Whether what the robot measures changes its map."""
        self._shown: Grid | None = None
        """The team's map that was published last."""
        try:
            self._node = open_node(names)
        except ConnectionError as error:
            raise ValueError(f"ros2.router = {names.router!r}: {error}") from None
        try:
            self._connect()
        except ValueError:
            self._node.close()
            raise

    def _connect(self) -> None:
        """Declare the endpoints."""
        node, names = self._node, self._names
        for name, type_name, qos, take in sources(names, self._body):

            def on_message(message: Any, _: object, take: Callable[[Any], None] = take) -> None:
                take(message)

            node.subscription(getattr(names, name), type_name, qos, on_message)
        self._goals = GoalSender(node, names)
        self._team_map = node.publisher(names.team_map, OCCUPANCY_GRID, LATCHED)
        self._status = node.publisher(names.status, STRING)
        self._markers = node.publisher(names.markers, MARKERS)

    @property
    def laser(self) -> Laser | None:
        """The beams of the robot's laser; None before the first scan, or without scans, before map and pose."""
        return self._body.laser

    @property
    def problem(self) -> str:
        """Why the robot stands still; empty if it does not have to."""
        if not self._node.is_connected:
            return f"the Zenoh router at {self._names.router} does not answer any more"
        if self._is_silent():
            return self._body.problem or self._body.silence
        if self._lacks_map():
            advice = '; set ros2.map = "" if the robot has none' if self._names.scan else ""
            return f"no map has arrived on {self._names.map}{advice}"
        rejected = "; ".join(f"{name}: {error}" for name, error in self._node.rejected.items())
        return self._body.problem or (f"malformed messages: {rejected}" if rejected else "")

    def spin(self, timeout_s: float = 0.0) -> None:
        """Take what has arrived; without readings for too long, stop the robot."""
        self._node.spin(time.time_ns(), timeout_s)
        self._body.take_newest()
        if (stamp := self._body.stamp_ns) != self._scanned[0]:
            self._scanned = stamp, time.monotonic_ns()
        elif self._is_silent():
            self.stop()

    # --- the body

    def sense(self, step: int) -> Sense | None:
        """Return the readings of a step; None without a pose, after a jump, or if no reading arrives any more."""
        self.spin()
        sense = self._body.sense(step, measures=self.measures)
        return None if self._is_silent() or self._body.has_jumped else sense

    def move(self, move: Move, target: Cell | None) -> None:
        """Send the goal of a move if it has changed, or cancel it."""
        goal = None if self._is_silent() or self._lacks_map() else self._body.goal(move, target)
        changed = self._tracker.change(goal)
        now = time.monotonic_ns()
        if goal is None:
            if changed:
                self._halt()
        elif changed or (
            self._goals.is_idle and not self._goals.aborted and now - self._sent > REPEAT_S * SECOND
        ):
            assert self._tracker.goal is not None
            if self._goals.send(self._tracker.goal, self._stamp(), time.time_ns()):
                self._sent = now

    def stop(self) -> None:
        """Cancel the goal."""
        if self._tracker.change(None):
            self._halt()

    def is_stuck(self) -> bool:
        """Return whether the robot does not reach its goal: it has given up, or makes no progress."""
        here = self._body.base(self._names.base_frame)
        if self._goals.aborted:
            self._goals.aborted = False
            self._tracker.fail()
        return here is not None and self._tracker.is_stuck(here, time.monotonic_ns())

    # --- what it publishes

    def publish_map(self, robot: Robot) -> None:
        """Publish the team's map if it has changed."""
        if self._shown is not None and np.array_equal(self._shown, robot.planning):
            return
        self._shown = robot.planning.copy()
        now = time.time_ns()
        message = occupancy_grid(
            self._node.messages, self._shown, self._grid, self._map_pose, self._names.map_frame, self._stamp()
        )
        self._team_map.publish(message, now)

    def publish_markers(self, robot: Robot) -> None:
        """Publish the robot's target, its teammates, and the frontiers that it may explore."""
        shown = layers(robot.explorable, robot.target, [pose[:2] for pose in robot.teammates.values()])
        message = marker_array(
            self._node.messages, shown, self._grid, self._map_pose, self._names.map_frame, self._stamp()
        )
        self._markers.publish(message, time.time_ns())

    def publish_status(self, status: Mapping[str, Any]) -> None:
        """Publish a status as JSON."""
        message = self._node.messages.new(STRING, data=json.dumps(status))
        self._status.publish(message, time.time_ns())

    def close(self) -> None:
        """Let the robot stand still, and close the node."""
        self.stop()
        end = time.monotonic_ns() + round(CANCEL_S * SECOND)
        while not self._goals.is_idle and time.monotonic_ns() < end:
            self.spin(0.05)
        self._node.close()

    def _halt(self) -> None:
        self._goals.stop(self._body.base(self._names.base_frame), self._stamp(), time.time_ns())

    def _stamp(self) -> int:
        """Return the time of the last pose: so all stamps are of the robot's clock, which may be a simulator's."""
        return self._body.stamp_ns or time.time_ns()

    def _is_silent(self) -> bool:
        return time.monotonic_ns() - self._scanned[1] > self._settings.dead_man_s * SECOND

    def _lacks_map(self) -> bool:
        return bool(self._names.map) and not self._body.has_map
