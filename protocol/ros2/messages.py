"""Messages of one ROS 2 distribution: classes, type hashes, and CDR, all from the types that `rosbags` contains."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from protocol.errors import ProtocolError, there_are
from protocol.nanoseconds import SECOND
from protocol.ros2.interfaces import EVENT_INFO, Definitions, definitions
from protocol.ros2.names import NO_HASH
from protocol.transforms import Pose

DISTROS = ("humble", "jazzy", "kilted", "lyrical", "rolling")
"""Distributions; rolling has the messages of the newest one here."""
_STORES = {
    "humble": Stores.ROS2_HUMBLE,
    "jazzy": Stores.ROS2_JAZZY,
    "kilted": Stores.ROS2_KILTED,
    "lyrical": Stores.ROS2_LYRICAL,
}
_ZEROS = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}
"""Zero of types that are not integers."""

CLOCK = "rosgraph_msgs/msg/Clock"
HEADER = "std_msgs/msg/Header"
LASER_SCAN = "sensor_msgs/msg/LaserScan"
MARKERS = "visualization_msgs/msg/MarkerArray"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
ODOMETRY = "nav_msgs/msg/Odometry"
POINT = "geometry_msgs/msg/Point"
POSE = "geometry_msgs/msg/Pose"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
QUATERNION = "geometry_msgs/msg/Quaternion"
STRING = "std_msgs/msg/String"
TIME = "builtin_interfaces/msg/Time"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
TWIST = "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"


class Messages:
    """The messages of a distribution. `messages[name]` is the class of a type as ``std_msgs/msg/String``."""

    def __init__(self, distro: str = "jazzy") -> None:
        if distro not in DISTROS:
            raise ValueError(f"unknown distribution of ROS 2: {distro!r}; {there_are(DISTROS, distro)}")
        self.distro = distro
        known = "lyrical" if distro == "rolling" else distro
        self.types = get_typestore(_STORES[known])
        """The type store of rosbags."""
        self.types.fielddefs.pop(EVENT_INFO, None)
        self.register(definitions(known))
        self._hashes: dict[str, str] = {}

    def __getitem__(self, name: str) -> Any:
        """Return the class of a type; its instances take all fields by name. ValueError if it is unknown."""
        try:
            return self.types.types[name]
        except KeyError:
            raise ValueError(f"{self.distro} has no type {name!r}; {self._similar(name)}") from None

    def register(self, types: Definitions) -> None:
        """Add types, as those of `protocol.ros2.interfaces.service`."""
        self.types.register(types)

    def new(self, name: str, **fields: Any) -> Any:
        """Return a message with these fields; all others are zero, empty, or false."""
        kind = self[name]
        unset = [each for each in self.types.fielddefs[name][1] if each[0] not in fields]
        return kind(**fields, **{field: self._zero(description) for field, description in unset})

    def type_hash(self, name: str) -> str:
        """Return the hash of a message or service that keys contain; Humble has none. ValueError if it is unknown."""
        if name not in self._hashes:
            self[name]
            self._hashes[name] = NO_HASH if self.distro == "humble" else self.types.hash_rihs01(name)
        return self._hashes[name]

    def encode(self, message: Any) -> bytes:
        """Encode a message in CDR, little-endian, with its header of 4 bytes.

        ValueError if a field has a wrong type or size.
        """
        name: str = message.__msgtype__
        try:
            return bytes(self.types.serialize_cdr(message, name, little_endian=True))
        except Exception as error:  # rosbags raises errors of many types for wrong fields
            raise ValueError(f"not a message of type {name}: {error}") from None

    def decode(self, payload: bytes, name: str) -> Any:
        """Decode a message of a type from CDR; ProtocolError if it is malformed."""
        self[name]
        try:
            return self.types.deserialize_cdr(payload, name)
        except Exception as error:  # rosbags raises errors of many types for malformed bytes
            raise ProtocolError(name, 0, f"malformed CDR of {len(payload)} bytes: {error}") from None

    def time(self, now_ns: int) -> Any:
        """Return a time message of nanoseconds since 1970."""
        seconds, nanoseconds = divmod(now_ns, SECOND)
        return self[TIME](sec=seconds, nanosec=nanoseconds)

    def header(self, frame: str, now_ns: int) -> Any:
        """Return a header."""
        return self[HEADER](stamp=self.time(now_ns), frame_id=frame)

    def pose(self, x: float, y: float, heading: float) -> Any:
        """Return a pose in the plane: meters, and radians counterclockwise from +x."""
        return self[POSE](
            position=self[POINT](x=x, y=y, z=0.0),
            orientation=self[QUATERNION](x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2)),
        )

    def stamped(self, frame: str, pose: Pose, now_ns: int) -> Any:
        """Return a PoseStamped in the plane."""
        return self[POSE_STAMPED](header=self.header(frame, now_ns), pose=self.pose(*pose))

    def transforms(self, edges: Iterable[tuple[str, str, Pose]], now_ns: int) -> Any:
        """Return the transforms of some frames, in the plane; `edges` are parent, frame, and pose in the parent."""
        found = []
        for parent, child, pose in edges:
            each = self.new(TRANSFORM, header=self.header(parent, now_ns), child_frame_id=child)
            each.transform.translation.x, each.transform.translation.y = pose.x, pose.y
            each.transform.rotation = self.pose(*pose).orientation
            found.append(each)
        return self[TRANSFORMS](transforms=found)

    def _zero(self, description: Any) -> Any:
        """Return the value zero of a field, by its description in the type store."""
        kind, what = description
        if kind == Nodetype.NAME:
            return self.new(what)
        if kind == Nodetype.BASE:
            return _ZEROS.get(what[0], 0)
        (kind, what), size = what
        count = size if description[0] == Nodetype.ARRAY else 0
        if kind == Nodetype.BASE and what[0] != "string":
            return np.zeros(count, what[0].replace("byte", "uint8").replace("char", "uint8"))
        return [self._zero((kind, what)) for _ in range(count)]

    def _similar(self, name: str) -> str:
        package = name.partition("/")[0]
        same = [each for each in self.types.types if each.partition("/")[0] == package]
        return there_are(sorted(same), name) if same else f"and no package {package!r}"


def nanoseconds(stamp: Any) -> int:
    """Return the nanoseconds since 1970 of a time message."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)
