"""murmur serve-ros2 as a process, with a node of ours as its client over loopback."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'murmur-robots[ros2]'")
pytest.importorskip("xxhash", reason="xxhash is not installed: pip install 'murmur-robots[ros2]'")

from agent.bodies.ros2 import BodySettings
from agent.bodies.scan_body import ScanBody
from protocol.grid import FREE
from protocol.map_frame import MapFrame
from protocol.range_scans import decode_range_scan
from protocol.ros2 import messages as names
from protocol.ros2.actions import ClientGoal, Status
from protocol.ros2.attachments import Attachment
from protocol.ros2.interfaces import NAVIGATE_TO_POSE
from protocol.ros2.messages import nanoseconds
from protocol.ros2.node import Ros2Node
from protocol.ros2.qos import DEFAULT, LATCHED, SENSOR, TF, TF_STATIC, Qos, Reliability
from protocol.transforms import Pose
from tests.deploy.commands.office_floor import murmur
from tests.protocol.ros2.waiting import spin_until
from tests.system.served_robots import Served, serving
from worldsim import generators

SIDES = {"width_m": 10.0, "height_m": 10.0}


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    size = [word for name, meters in SIDES.items() for word in ("--set", f"map_options.{name}={meters}")]
    with serving(
        "--map", "office", *size, "--robots", "2", "--speed", "2", "--sim-time", "--domain", "9",
        "--names", "ada,bob", "--json",
    ) as found:  # fmt: skip
        yield found
    assert json.loads(found.output)["coverage"] > 0.1
    assert "bob/goal_pose: message ignored, as its frame is 'base_link'" in found.errors


@dataclass
class Client:
    """A node that joins late, with what it has received of one robot."""

    node: Ros2Node
    body: ScanBody
    robot: str
    maps: list[Any] = field(default_factory=list)
    odometry: list[Any] = field(default_factory=list)
    clock: list[int] = field(default_factory=list)
    scans: int = 0

    def listen(self) -> None:
        node = self.node
        node.subscription("tf_static", names.TRANSFORMS, TF_STATIC, self._fixed)
        node.subscription("tf", names.TRANSFORMS, TF, self._moving)
        node.subscription("scan", names.LASER_SCAN, SENSOR, self._scan)
        node.subscription("map", names.OCCUPANCY_GRID, LATCHED, lambda found, _: self.maps.append(found))
        node.subscription("odom", names.ODOMETRY, DEFAULT, lambda found, _: self.odometry.append(found))
        best_effort = Qos(Reliability.BEST_EFFORT, depth=1)
        node.subscription("/clock", names.CLOCK, best_effort, self._time)

    def _fixed(self, message: Any, _: Attachment) -> None:
        self.body.add_transforms(message, is_static=True)

    def _moving(self, message: Any, _: Attachment) -> None:
        self.body.add_transforms(message, is_static=False)

    def _scan(self, message: Any, _: Attachment) -> None:
        self.scans += 1
        self.body.add_scan(message)

    def _time(self, message: Any, _: Attachment) -> None:
        self.clock.append(nanoseconds(message.clock))

    def pose(self, x: float, y: float, frame: str = "map") -> Any:
        messages = self.node.messages
        header = messages.header(frame, 0)
        return messages.new(names.POSE_STAMPED, header=header, pose=messages.pose(x, y, 0.0))

    def until(self, condition: Any) -> None:
        spin_until(condition, self.node)


@pytest.fixture(params=["ada", "bob"])
def client(served: Served, request: pytest.FixtureRequest) -> Client:
    robot = request.param
    printed = served.printed
    grid = printed["grid"]
    cells = [round(grid[side] / grid["resolution"]) for side in ("width_m", "height_m")]
    where = MapFrame(cells[0], cells[1], grid["resolution"], grid["x"], grid["y"])
    x, y, degrees = printed["robots"][robot]
    start = Pose(x, y, math.radians(degrees))
    found = Client(served.node("client", robot), ScanBody(where, BodySettings(start, speed=2.0)), robot)
    found.listen()
    return found


def test_a_late_node_receives_map_and_scans_of_the_building(client: Client, served: Served) -> None:
    client.until(lambda: client.maps and client.scans > 2 and len(client.clock) > 2)
    nodes = client.node.graph().nodes
    assert (f"/{client.robot}", "murmur_simulator") in [(node.namespace, node.name) for node in nodes]
    assert client.clock == sorted(client.clock)
    assert 0 < client.clock[0] < 10**12, "simulated time"
    sense = client.body.sense(1)
    assert sense is not None, client.body.problem
    assert client.body.laser is not None
    scan = decode_range_scan(sense.range_scan, client.body.laser)
    truth = generators.make("office", seed=0, **SIDES).cells
    assert truth[scan.y, scan.x] == FREE
    info = client.maps[-1].info
    assert info.width * info.height == len(client.maps[-1].data)
    assert set(np.unique(client.maps[-1].data)) == {-1, 0, 100}


def test_the_action_drives_a_robot_to_its_goal_and_tells_of_success(client: Client, served: Served) -> None:
    ended: list[ClientGoal] = []
    action = client.node.action_client("navigate_to_pose", NAVIGATE_TO_POSE)
    client.until(lambda: action.is_available and client.odometry)
    before = client.odometry[-1].pose.pose.position
    new = client.node.messages.new
    goal = new(f"{NAVIGATE_TO_POSE}_Goal", pose=client.pose(before.x + 0.5, before.y))
    sent = action.send(goal, 1, ended.append)
    client.until(lambda: ended)
    assert (sent.status, sent.result.error_code) == (Status.SUCCEEDED, 0)
    after = client.odometry[-1].pose.pose.position
    assert 0.2 < math.dist((after.x, after.y), (before.x, before.y)) < 1.2
    far = new(f"{NAVIGATE_TO_POSE}_Goal", pose=client.pose(500.0, 0.0))
    sent = action.send(far, 1, ended.append)
    client.until(lambda: len(ended) == 2)
    assert (sent.status, sent.result.error_code) == (Status.ABORTED, 208)


def test_goals_and_velocities_drive_a_robot(client: Client) -> None:
    client.until(lambda: client.odometry)
    start = client.odometry[-1].pose.pose.position
    goals = client.node.publisher("goal_pose", names.POSE_STAMPED)
    goals.publish(client.pose(9.0, 9.0, "base_link"), 1)
    goals.publish(client.pose(start.x - 0.4, start.y), 1)
    client.until(lambda: client.odometry[-1].pose.pose.position.x < start.x - 0.2)
    velocities = client.node.publisher("cmd_vel", names.TWIST)
    twist = client.node.messages.new(names.TWIST)
    twist.angular.z = 1.0
    velocities.publish(twist, 1)
    client.until(lambda: client.odometry[-1].twist.twist.angular.z == 1.0)
    client.until(lambda: client.odometry[-1].twist.twist.angular.z != 1.0)


def test_stamped_velocities_drive_a_robot_too(client: Client) -> None:
    client.until(lambda: client.odometry)
    velocities = client.node.publisher("cmd_vel", names.TWIST_STAMPED)
    message = client.node.messages.new(names.TWIST_STAMPED)
    message.twist.angular.z = -0.5
    velocities.publish(message, 1)
    client.until(lambda: client.odometry[-1].twist.twist.angular.z == -0.5)


def test_a_second_server_with_the_same_names_is_refused(served: Served) -> None:
    router = served.printed["router"]
    result = murmur("serve-ros2", "--map", "em", "--router", router, "--domain", "9", "--names", "eve,bob,al")
    assert result.exit_code == 2
    assert "names = eve,bob,al: in domain 9, /bob/murmur_simulator exists already" in result.stderr


def test_robots_can_leave_slam_and_navigation_to_the_users_nodes() -> None:
    with serving("--map", "em", "--robots", "1", "--no-slam", "--no-navigation", "--json") as found:
        node = found.node("client", "r0")
        edges: list[tuple[str, str]] = []
        node.subscription(
            "tf",
            names.TRANSFORMS,
            TF,
            lambda message, _: edges.extend(
                (each.header.frame_id, each.child_frame_id) for each in message.transforms
            ),
        )
        spin_until(lambda: len(edges) > 3, node)
        assert set(edges) == {("odom", "base_link")}
        graph = node.graph()
        assert set(graph.topics) == {f"/r0/{name}" for name in ("cmd_vel", "odom", "scan", "tf", "tf_static")}
        assert graph.services == {}
