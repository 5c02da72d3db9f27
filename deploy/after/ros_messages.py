"""ROS 2 messages as an export writes them: headers, poses, transforms, and the two types of Murmur."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from deploy.record.colors import GROUPS
from protocol.transforms import Pose

RADIO_FRAME, RADIO_STEP = "murmur_msgs/msg/RadioFrame", "murmur_msgs/msg/RadioStep"
DEFINITIONS = {
    RADIO_FRAME: """\
# One frame on the radio, as recorded in the ledger (docs/protocol.md).
std_msgs/Header header
int32 round
# Of this round; -1: a broadcast.
int32 connection
# offer, answer, data, broadcast or news
string frame
int32 sender
# -1: all robots in range.
int32 receiver
# The robot whose map it describes; -1: none.
int32 map
# Its packet kinds, and the number and bytes of packets of each kind.
string[] kinds
uint32[] packets
uint32[] bytes
# Bytes transmitted, bytes refused, and the reason.
uint32 carried
uint32 refused
string cause
# Number of robots that received it.
uint32 received
""",
    RADIO_STEP: "\n".join(
        [
            "# Traffic of one step, in bytes.",
            "std_msgs/Header header",
            "# The limit; NaN: unlimited.",
            "float64 budget",
            "uint32 frames",
            "uint32 carried",
            "# Bytes over the budget.",
            "uint32 waiting",
            *(line for name, group in GROUPS.items() for line in (f"# {group.label}", f"uint32 {name}")),
            "",
        ]
    ),
}
"""Definitions of the messages of Murmur, in the format of ROS."""

FOREVER = divmod(2**63 - 1, 10**9)
"""Seconds and nanoseconds of an infinite duration."""

MAP_FRAME = "map"
"""The frame of the map file: meters, y up."""


class RosMessages:
    """Makes messages; fields that the caller leaves out are zero or empty."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415  only exports need it

        self.types = get_typestore(Stores.ROS2_HUMBLE)
        for name, text in DEFINITIONS.items():
            self.types.register(get_types_from_msg(text, name))

    def make(self, kind: str, **fields: Any) -> Any:
        """Make a message; fields that are left out are zero or empty."""
        return self.types.types[kind](**(self._zeros(kind) | fields))

    @cache  # noqa: B019  as long as the export
    def _zeros(self, kind: str) -> dict[str, Any]:
        """Return a message's fields with value zero, or empty."""
        zeros: dict[str, Any] = {}
        for name, (node, details) in self.types.fielddefs[kind][1]:
            if node.name == "NAME":
                zeros[name] = self.make(details)
            elif node.name == "BASE":
                zeros[name] = "" if details[0] == "string" else 0
            elif node.name == "ARRAY":
                zeros[name] = np.zeros(details[1])
            else:
                zeros[name] = np.empty(0, np.uint8)
        return zeros

    def header(self, step: int, frame: str = MAP_FRAME) -> Any:
        """Return the header of a message of a step, whose time is the step in seconds."""
        stamp = self.make("builtin_interfaces/msg/Time", sec=step)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def point(self, x: float, y: float, kind: str = "Point") -> Any:
        """Return a point, or a vector, in the plane."""
        return self.make(f"geometry_msgs/msg/{kind}", x=float(x), y=float(y))

    def turn(self, yaw: float) -> Any:
        """Return a rotation about the vertical axis, in radians."""
        return self.make("geometry_msgs/msg/Quaternion", z=math.sin(yaw / 2), w=math.cos(yaw / 2))

    def pose(self, pose: Pose) -> Any:
        """Return a pose in the plane."""
        return self.make(
            "geometry_msgs/msg/Pose", position=self.point(pose.x, pose.y), orientation=self.turn(pose.yaw)
        )

    def stamped(self, step: int, pose: Pose) -> Any:
        """Return a pose in the plane, with a header."""
        return self.make("geometry_msgs/msg/PoseStamped", header=self.header(step), pose=self.pose(pose))

    def transforms(self, step: int, frames: Mapping[tuple[str, str], Pose]) -> Any:
        """Return the message that gives each frame's pose in its parent; `frames` has the pose by parent and frame."""
        kind = "geometry_msgs/msg/TransformStamped"
        transforms = []
        for (parent, frame), (x, y, yaw) in frames.items():
            placed = self.make(
                "geometry_msgs/msg/Transform",
                translation=self.point(x, y, "Vector3"),
                rotation=self.turn(yaw),
            )
            header = self.header(step, parent)
            transforms.append(self.make(kind, header=header, child_frame_id=frame, transform=placed))
        return self.make("tf2_msgs/msg/TFMessage", transforms=transforms)


def profile(*, latched: bool, depth: int) -> Any:
    """Return the quality of service of a topic in a bag: reliable, the last `depth` messages, without time limits.

    If it is `latched` (transient local), a subscription that joins later gets these messages.
    """
    from rosbags import interfaces as bag  # noqa: PLC0415

    return bag.Qos(
        bag.QosHistory.KEEP_LAST,
        depth,
        bag.QosReliability.RELIABLE,
        bag.QosDurability.TRANSIENT_LOCAL if latched else bag.QosDurability.VOLATILE,
        bag.QosTime(*FOREVER),
        bag.QosTime(*FOREVER),
        bag.QosLiveliness.AUTOMATIC,
        bag.QosTime(*FOREVER),
        avoid_ros_namespace_conventions=False,
    )
