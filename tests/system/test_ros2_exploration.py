"""Control logic on three served ROS 2 robots explores an office, by the wall clock and through messages only."""

from __future__ import annotations

import json
import math
import time
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'murmur-robots[ros2]'")
pytest.importorskip("xxhash", reason="xxhash is not installed: pip install 'murmur-robots[ros2]'")

from agent.bodies.ros2 import BodySettings, Ros2Body
from agent.robot import Robot
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.grid import FREE
from protocol.map_frame import MapFrame
from protocol.ros2 import messages as names
from protocol.ros2.node import Ros2Node
from protocol.ros2.qos import DEFAULT, SENSOR, TF, TF_STATIC
from protocol.transforms import Pose
from tests.system.served_robots import serving
from worldsim import generators

SIDES = {"width_m": 14.0, "height_m": 14.0}
SPEED, RADIUS_M, REACH_M, CELL = 2.0, 0.2, 5.0, 0.1
LIMIT_S = 300.0
STEP_S = 0.5


class RosAgent:
    """One agent without a radio: it explores the whole building alone."""

    def __init__(self, node: Ros2Node, grid: MapFrame, start: Pose) -> None:
        self.robot: Robot | None = None
        self.explored = False
        self._node, self._grid = node, grid
        self._body = body = Ros2Body(grid, BodySettings(start, REACH_M, SPEED))
        node.subscription(
            "tf_static", names.TRANSFORMS, TF_STATIC, lambda m, _: body.add_transforms(m, is_static=True)
        )
        node.subscription("tf", names.TRANSFORMS, TF, lambda m, _: body.add_transforms(m, is_static=False))
        node.subscription("scan", names.LASER_SCAN, SENSOR, lambda m, _: body.add_scan(m))
        self._goals = node.publisher("goal_pose", names.POSE_STAMPED, DEFAULT)

    def play(self, step: int) -> None:
        """Take what has arrived, decide, and send a goal."""
        self._node.spin(time.time_ns())
        sense = self._body.sense(step)
        if sense is None or self.explored:
            return
        if self.robot is None:
            body = Body(REACH_M / CELL, 360.0, SPEED * STEP_S / CELL, radius_cells=RADIUS_M / CELL)
            self.robot = Robot(
                Settings(
                    robot=0, bodies=(body,), width=self._grid.width, height=self._grid.height, beams=360, seed=0,
                    strategy="meier", encoding=EncodingSettings("none"), resolution=CELL,
                    replication=ReplicationSettings("gossip"), laser=self._body.laser,
                )
            )  # fmt: skip
        self.robot.perceive(sense)
        move = self.robot.decide()
        self.explored = move.explored
        goal = self._body.goal(move, self.robot.target)
        if goal is not None:
            messages, now_ns = self._node.messages, time.time_ns()
            header = messages.header("map", now_ns)
            message: Any = messages.new(names.POSE_STAMPED, header=header, pose=messages.pose(*goal))
            self._goals.publish(message, now_ns)


@pytest.mark.long
def test_agents_explore_an_office_through_the_messages_of_three_served_robots() -> None:
    size = [word for name, meters in SIDES.items() for word in ("--set", f"map_options.{name}={meters}")]
    with serving("--map", "office", *size, "--robots", "3", "--speed", str(SPEED), "--json") as served:
        told = served.told
        grid = MapFrame(*(round(SIDES[side] / CELL) for side in SIDES), CELL)
        agents = []
        for namespace, (x, y, degrees) in told["robots"].items():
            node = served.node("agent", namespace)
            agents.append(RosAgent(node, grid, Pose(x, y, math.radians(degrees))))
        until, step = time.monotonic() + LIMIT_S, 0
        while not all(agent.explored for agent in agents) and time.monotonic() < until:
            step += 1
            begin = time.monotonic()
            for agent in agents:
                agent.play(step)
            time.sleep(max(0.0, STEP_S - (time.monotonic() - begin)))
    assert [agent.explored for agent in agents] == [True] * 3
    assert json.loads(served.output)["coverage"] > 0.97
    free = generators.make("office", seed=0, **SIDES).cells == FREE
    for agent in agents:
        assert agent.robot is not None
        assert np.mean(agent.robot.own[free] == FREE) > 0.95
