"""A robot's control logic explores a house through the messages of a ROS 2 robot."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import maximum_filter

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'murmur-robots[ros2]'")
pytest.importorskip("xxhash", reason="xxhash is not installed: pip install 'murmur-robots[ros2]'")

from agent.bodies.ros2 import BodySettings
from agent.bodies.scan_body import ScanBody
from agent.robot import Robot
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.grid import FREE, OCCUPIED
from protocol.range_scans import Laser
from protocol.ros2 import messages as names
from protocol.ros2.messages import Messages
from protocol.transforms import Pose
from tests.agent.bodies.ros_house import BEAMS, RADIUS_CELLS, REACH_M, WHERE, RosRobot, house

STEPS = 120
SECOND = 10**9


def settings(laser: Laser | None) -> Settings:
    """Return the settings of a robot that is alone."""
    body = Body(REACH_M / WHERE.resolution, 360.0, 5.0, radius_cells=RADIUS_CELLS, laser=laser)
    return Settings(
        robot=0, bodies=(body,), width=WHERE.width, height=WHERE.height, beams=BEAMS, seed=0, strategy="meier",
        encoding=EncodingSettings("none"), replication=ReplicationSettings("gossip"),
    )  # fmt: skip


@pytest.mark.parametrize("start", [Pose(0.0, 0.0, 0.0), Pose(4.0, 1.2, 2.2)])
def test_a_ros_2_robot_explores_a_house_whatever_its_start_pose(start: Pose) -> None:
    messages, truth = Messages("jazzy"), house()

    def sent(message: Any, name: str) -> Any:
        return messages.decode(messages.encode(message), name)

    ros = RosRobot(messages, truth, start, cells_per_step=5)
    body = ScanBody(WHERE, BodySettings(map_pose=start, reach_m=REACH_M, speed=1.0))
    body.add_transforms(sent(ros.static_transforms(), names.TRANSFORMS), is_static=True)
    robot, explored = None, False
    for step in range(1, STEPS):
        now_ns = step * SECOND
        body.add_transforms(sent(ros.transforms(now_ns), names.TRANSFORMS), is_static=False)
        body.add_scan(sent(ros.scan(now_ns), names.LASER_SCAN))
        sense = body.sense(step)
        assert sense is not None, body.problem
        if robot is None:
            robot = Robot(settings(body.laser))
        robot.perceive(sense)
        move = robot.decide()
        explored = move.explored
        if explored:
            break
        goal = body.goal(move, robot.target)
        if goal is not None:
            pose = messages.new(
                names.POSE_STAMPED, header=messages.header("map", now_ns), pose=messages.pose(*goal)
            )
            ros.drive(sent(pose, names.POSE_STAMPED))
    assert explored
    assert robot is not None
    free = truth == FREE
    assert np.count_nonzero(robot.own[free] == FREE) > 0.97 * np.count_nonzero(free)
    near_walls = maximum_filter(truth, 3) == OCCUPIED
    assert near_walls[robot.own == OCCUPIED].all(), "each wall is within one cell of a true one"
