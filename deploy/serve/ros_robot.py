"""A simulated robot as a ROS 2 node: its state as messages, and messages as goals and velocities."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from agent.bodies.team_map import occupancy_grid
from deploy.serve.navigator import Outcome
from deploy.serve.robot import SimulatedRobot, Task
from protocol.nanoseconds import SECOND
from protocol.range_scans import NO_MEASUREMENT, NOTHING, TURN
from protocol.ros2 import messages as names
from protocol.ros2.actions import ServerGoal, Status
from protocol.ros2.attachments import Attachment
from protocol.ros2.interfaces import NAVIGATE_TO_POSE
from protocol.ros2.node import Ros2Node
from protocol.ros2.qos import DEFAULT, LATCHED, SENSOR, TF
from protocol.transforms import Pose, frame_name, pose_of
from worldsim.velocity_world import Velocity

MAP, ODOM, BASE, LASER = "map", "odom", "base_link", "laser"
"""Frames; each robot has its own, in the ``tf`` of its namespace."""
MAP_NS = 2 * SECOND
"""Least time between two messages of ``map``."""
FEEDBACK_NS = 500_000_000
NO_PLAN, NO_PROGRESS = 208, 105
"""Error codes of nav2: NO_VALID_PATH of ComputePathToPose, and FAILED_TO_MAKE_PROGRESS of FollowPath."""

_ENDS = {Outcome.REACHED: Status.SUCCEEDED, Outcome.CANCELED: Status.CANCELED}
_ERRORS = {Outcome.UNREACHABLE: NO_PLAN, Outcome.STUCK: NO_PROGRESS}
_DURATION = "builtin_interfaces/msg/Duration"


class Offers(NamedTuple):
    """What a robot offers besides its driver: without them, nodes of the user do."""

    slam: bool
    """The map, and the transform from the map to odometry."""
    navigation: bool
    """Goals over the topic and the action."""


ALL = Offers(slam=True, navigation=True)


class RosRobot:
    """The topics and the action of one robot, on a node of its own in the robot's namespace.

    `least_range_m` is the range below which its laser measures nothing. `warn` receives a line about each message that
    is ignored. `now_ns` is the time, in nanoseconds since 1970. `offers`: which services it has besides its driver.
    """

    def __init__(
        self,
        node: Ros2Node,
        robot: SimulatedRobot,
        least_range_m: float,
        warn: Callable[[str], object],
        now_ns: int,
        offers: Offers = ALL,
    ) -> None:
        self.node, self.robot, self._offers = node, robot, offers
        self._least_range_m, self._warn = least_range_m, warn
        self._now_ns = now_ns
        self._map: Any = None
        """The last message of ``map``."""
        self._map_ns = -MAP_NS
        self._goals: list[tuple[ServerGoal, Task]] = []
        """Goals of the action that have not ended."""
        self._feedback_ns = 0
        """Time of the last feedback."""
        fixed = node.publisher("tf_static", names.TRANSFORMS, LATCHED)
        fixed.publish(node.messages.transforms([(BASE, LASER, robot.laser_pose)], 0), now_ns)
        self._tf = node.publisher("tf", names.TRANSFORMS, TF)
        self._odom = node.publisher("odom", names.ODOMETRY)
        self._scan = node.publisher("scan", names.LASER_SCAN, SENSOR)
        node.subscription("cmd_vel", names.TWIST, DEFAULT, self._take_velocity)
        node.subscription(
            "cmd_vel",
            names.TWIST_STAMPED,
            DEFAULT,
            lambda message, source: self._take_velocity(message.twist, source),
        )
        if offers.slam:
            self._own_map = node.publisher("map", names.OCCUPANCY_GRID, LATCHED)
        if offers.navigation:
            node.subscription("goal_pose", names.POSE_STAMPED, DEFAULT, self._take_goal)
            node.action_server("navigate_to_pose", NAVIGATE_TO_POSE, self._take_task, self._cancel)

    def receive(self, now_ns: int) -> None:
        """Take all messages that have arrived, at `now_ns` since 1970."""
        self._now_ns = now_ns
        self.node.spin(now_ns)

    def publish(self, stamp_ns: int, now_ns: int) -> None:
        """Publish the robot's state at time `stamp_ns` of the robots' clock."""
        robot = self.robot
        odometry = robot.localization.odometry
        edges = [(ODOM, BASE, odometry)]
        if self._offers.slam:
            edges.insert(0, (MAP, ODOM, robot.pose.then(odometry.inverse())))
        self._tf.publish(self.node.messages.transforms(edges, stamp_ns), now_ns)
        self._odom.publish(self._odometry(stamp_ns), now_ns)
        self._scan.publish(self._laser_scan(stamp_ns), now_ns)
        if self._offers.slam and now_ns - self._map_ns >= MAP_NS:
            self._map_ns = now_ns
            self._publish_map(stamp_ns, now_ns)
        self._report(stamp_ns, now_ns)

    def _publish_map(self, stamp_ns: int, now_ns: int) -> None:
        grid, where = self.robot.own_map()
        message = occupancy_grid(self.node.messages, grid, where, Pose(0.0, 0.0, 0.0), MAP, stamp_ns)
        before = self._map
        if before is None or not np.array_equal(before.data, message.data):
            self._map = message
            self._own_map.publish(message, now_ns)

    def _odometry(self, stamp_ns: int) -> Any:
        messages = self.node.messages
        header = messages.header(ODOM, stamp_ns)
        message = messages.new(names.ODOMETRY, header=header, child_frame_id=BASE)
        message.pose.pose = messages.pose(*self.robot.localization.odometry)
        if not self.robot.blocked:
            message.twist.twist.linear.x = self.robot.velocity.ahead
        message.twist.twist.angular.z = self.robot.velocity.turn
        return message

    def _laser_scan(self, stamp_ns: int) -> Any:
        laser, ranges = self.robot.laser, self.robot.ranges[::-1]
        unit = math.tau / TURN
        most = laser.reach_mm / 1000
        meters = ranges.astype(np.float32) / 1000
        meters[(ranges == NOTHING) | (meters > most)] = np.inf
        meters[ranges == NO_MEASUREMENT] = np.nan
        return self.node.messages.new(
            names.LASER_SCAN,
            header=self.node.messages.header(LASER, stamp_ns),
            angle_min=-(laser.first + laser.span) * unit,
            angle_max=-laser.first * unit,
            angle_increment=laser.span / (laser.beams - 1) * unit,
            range_min=self._least_range_m,
            range_max=most,
            ranges=meters,
        )

    def _report(self, stamp_ns: int, now_ns: int) -> None:
        """Tell clients of the action about their goals."""
        is_due = now_ns - self._feedback_ns >= FEEDBACK_NS
        for goal, task in self._goals:
            if goal.status is Status.ACCEPTED:
                goal.execute(now_ns)
            if task.outcome is not None:
                goal.end(_ENDS.get(task.outcome, Status.ABORTED), self._result(task.outcome), now_ns)
            elif is_due:
                goal.feedback(self._feedback(task, stamp_ns, now_ns), now_ns)
        if is_due:
            self._feedback_ns = now_ns
        self._goals = [each for each in self._goals if each[1].outcome is None]

    def _feedback(self, task: Task, stamp_ns: int, now_ns: int) -> Any:
        messages, robot = self.node.messages, self.robot
        seconds, nanoseconds = divmod(max(0, now_ns - task.began_ns), SECOND)
        return messages.new(
            f"{NAVIGATE_TO_POSE}_Feedback",
            current_pose=messages.stamped(MAP, robot.pose, stamp_ns),
            navigation_time=messages[_DURATION](sec=seconds, nanosec=nanoseconds),
            number_of_recoveries=robot.navigator.recoveries,
            distance_remaining=robot.navigator.remaining_m(robot.true),
        )

    def _result(self, outcome: Outcome) -> Any:
        result = self.node.messages.new(f"{NAVIGATE_TO_POSE}_Result")
        if hasattr(result, "error_code"):
            result.error_code = _ERRORS.get(outcome, 0)
        if hasattr(result, "error_msg") and outcome is not Outcome.REACHED:
            result.error_msg = outcome.value
        return result

    def _take_velocity(self, message: Any, _: Attachment) -> None:
        with self._ignoring("cmd_vel"):
            self.robot.command(Velocity(float(message.linear.x), float(message.angular.z)), self._now_ns)

    def _take_goal(self, message: Any, _: Attachment) -> None:
        with self._ignoring("goal_pose"):
            task = self.robot.go(goal_of(message), self._now_ns)
            if task.outcome is not None:
                self._warn(f"{self.node.token.namespace}/goal_pose: {task.outcome.value}")

    def _take_task(self, goal: ServerGoal) -> bool:
        with self._ignoring("navigate_to_pose"):
            self._goals.append((goal, self.robot.go(goal_of(goal.message.pose), self._now_ns)))
            return True
        return False

    def _cancel(self, goal: ServerGoal) -> bool:
        for each, task in self._goals:
            if each is goal:
                self.robot.cancel(task)
        return True

    @contextmanager
    def _ignoring(self, name: str) -> Iterator[None]:
        """Warn of a message that raises ValueError, and ignore it."""
        try:
            yield
        except ValueError as error:
            self._warn(f"{self.node.token.namespace}/{name}: message ignored, as {error}")


def goal_of(message: Any) -> Pose:
    """Return the pose of a PoseStamped in the map frame; ValueError for another frame, or a tilted pose."""
    frame = frame_name(message.header.frame_id)
    if frame != MAP:
        raise ValueError(f"its frame is {frame!r}; goals must be in frame {MAP!r}")
    place, turn = message.pose.position, message.pose.orientation
    return pose_of(place.x, place.y, turn.x, turn.y, turn.z, turn.w)
