"""Goals of a ROS 2 robot: over the action `navigate_to_pose` while it has a server, else over the topic `goal_pose`."""

from __future__ import annotations

from deploy.field.robot_file import Ros2Table
from protocol.ros2.actions import ActionClient, ClientGoal, Status
from protocol.ros2.interfaces import NAVIGATE_TO_POSE
from protocol.ros2.messages import POSE_STAMPED
from protocol.ros2.node import Ros2Node
from protocol.ros2.topics import Publisher
from protocol.transforms import Pose


class GoalSender:
    """Sends goals in the robot's map frame, and stops the robot."""

    def __init__(self, node: Ros2Node, names: Ros2Table) -> None:
        self.aborted = False
        """Whether the robot has given the last goal up."""
        self._messages = node.messages
        self._frame = names.map_frame
        self._topic: Publisher | None = None
        self._action: ActionClient | None = None
        if names.goal_pose:
            self._topic = node.publisher(names.goal_pose, POSE_STAMPED)
        if names.navigate_to_pose:
            self._action = node.action_client(names.navigate_to_pose, NAVIGATE_TO_POSE)
        self._goal: ClientGoal | None = None
        """The last goal of the action, until it has ended."""
        self._drives_by_topic = False

    @property
    def is_idle(self) -> bool:
        """Whether no goal of the action is under way."""
        return self._goal is None

    def send(self, goal: Pose, stamp_ns: int, now_ns: int) -> bool:
        """Send a goal, with the time stamp of the robot's clock; return whether it could be sent.

        The action's server replaces a goal that is under way.
        """
        self.aborted = False
        pose = self._messages.stamped(self._frame, goal, stamp_ns)
        if self._action is not None and self._action.is_available:
            message = self._messages.new(f"{NAVIGATE_TO_POSE}_Goal", pose=pose)
            self._goal = self._action.send(message, now_ns, self._end)
            self._drives_by_topic = False
            return True
        if self._topic is None:
            return False
        self._topic.publish(pose, now_ns)
        self._drives_by_topic = True
        return True

    def stop(self, here: Pose | None, stamp_ns: int, now_ns: int) -> None:
        """Cancel the goal; one that was sent over the topic is replaced by the robot's own pose."""
        if self._goal is not None and self._action is not None:
            self._action.cancel(self._goal, now_ns)
        if self._drives_by_topic and here is not None and self._topic is not None:
            self._topic.publish(self._messages.stamped(self._frame, here, stamp_ns), now_ns)
        self._drives_by_topic = False

    def _end(self, goal: ClientGoal) -> None:
        """Take the end of a goal; a result shows that the robot tried, an end without one that the server is gone."""
        if self._goal is None or goal.id == self._goal.id:
            self._goal = None
            self.aborted = goal.status is Status.ABORTED and goal.result is not None
