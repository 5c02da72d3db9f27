"""One message of each type with values that are easy to lose, and its comparison with those of other libraries."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from protocol.ros2 import messages as names
from protocol.ros2.messages import Messages

TRANSFORM, MARKER = "geometry_msgs/msg/TransformStamped", "visualization_msgs/msg/Marker"
NOW_NS = 1_700_000_000_123_456_789


def sample(messages: Messages, name: str) -> Any:
    """Return a message of a type."""
    header = messages.header("map", NOW_NS)
    match name:
        case names.LASER_SCAN:
            ranges = np.array([0.1, np.inf, 12.25, 0.0, 3.0e-3], np.float32)
            return messages.new(
                name, header=header, angle_min=-1.5, angle_increment=0.75, range_max=30.0, ranges=ranges
            )
        case names.TRANSFORMS:
            transforms = [
                messages.new(TRANSFORM, header=header, child_frame_id=each) for each in ("odom", "base_link")
            ]
            transforms[1].transform.translation.x = 1.0 / 3.0
            return messages[name](transforms=transforms)
        case names.POSE_STAMPED:
            return messages[name](header=header, pose=messages.pose(1.0 / 3.0, -7.5, 2.0))
        case names.OCCUPANCY_GRID:
            grid = messages.new(name, header=header, data=np.array([-1, 0, 100, 50, -1, 1], np.int8))
            grid.info.width, grid.info.height, grid.info.resolution = 3, 2, 0.0625
            return grid
        case names.ODOMETRY:
            odometry = messages.new(name, header=header, child_frame_id="base_link")
            odometry.pose.covariance[35] = 0.25
            return odometry
        case names.TWIST:
            twist = messages.new(name)
            twist.linear.x, twist.angular.z = 0.2, -1.0
            return twist
        case names.CLOCK:
            return messages[name](clock=messages.time(NOW_NS))
        case names.STRING:
            return messages[name](data="grün")
        case names.MARKERS:
            marker = messages.new(MARKER, header=header, ns="targets", id=7, type=2, text="r1")
            marker.points.append(messages[names.POINT](x=1.0, y=2.0, z=0.0))
            return messages[name](markers=[marker])
    raise ValueError(name)


def plain(value: Any) -> Any:
    """Return a message of any library as dictionaries, lists, and numbers."""
    if is_dataclass(value):
        return {
            each.name: plain(getattr(value, each.name))
            for each in fields(value)
            if each.name.islower() and each.name != "__msgtype__"  # without constants
        }
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(each) for each in value]
    return value
