"""A robot's body and its ROS 2 node, as its settings describe them: for the robot itself, and for the doctor."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

from agent.bodies.map_body import MapBody
from agent.bodies.ros2 import BodySettings, Ros2Body
from agent.bodies.scan_body import ScanBody
from deploy.field.robot_file import RobotSettings, Ros2Table
from deploy.field.robot_plan import map_frame
from protocol.ros2.messages import LASER_SCAN, OCCUPANCY_GRID, TRANSFORMS
from protocol.ros2.node import Ros2Node
from protocol.ros2.qos import LATCHED, SENSOR, TF, TF_STATIC, Qos
from protocol.transforms import Pose


class Source(NamedTuple):
    """What a body receives: its setting in ``[ros2]``, its type, its quality of service, and where messages go."""

    name: str
    type_name: str
    qos: Qos
    take: Callable[[Any], None]


def map_pose(names: Ros2Table) -> Pose:
    """Return the pose of the robot's map frame in the common frame."""
    x, y, degrees = names.map_pose
    return Pose(x, y, math.radians(degrees))


def make_body(settings: RobotSettings) -> Ros2Body:
    """Return the body of a robot."""
    names = settings.ros2
    options = BodySettings(
        map_pose(names), settings.sensor_range, settings.speed, names.map_frame, names.base_frame
    )
    return (ScanBody if names.scan else MapBody)(map_frame(settings), options)


def open_node(names: Ros2Table, suffix: str = "") -> Ros2Node:
    """Open a robot's node, whose name ends in `suffix`; ConnectionError if no router answers."""
    name = names.node + suffix
    return Ros2Node(name, names.namespace or "/", names.domain, distro=names.distro, router=names.router)


def sources(names: Ros2Table, body: Ros2Body) -> Iterator[Source]:
    """Yield what a body receives: transforms before scans and maps, which need them."""
    yield Source("tf_static", TRANSFORMS, TF_STATIC, partial(body.add_transforms, is_static=True))
    yield Source("tf", TRANSFORMS, TF, partial(body.add_transforms, is_static=False))
    if names.map:
        yield Source("map", OCCUPANCY_GRID, LATCHED, body.add_map)
    if isinstance(body, ScanBody):
        yield Source("scan", LASER_SCAN, SENSOR, body.add_scan)
