"""Logs that tests write: a robot drives through a rectangular room and scans it."""

from __future__ import annotations

import gzip
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 8.0, 6.0
"""Sides of the room in meters; its lower left corner is the origin."""

PoseTuple = tuple[float, float, float]


def distances(pose: PoseTuple, angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances from a point in the room to its walls, at angles (radians, counterclockwise) from the heading."""
    x, y, heading = pose
    cos, sin = np.cos(heading + angles), np.sin(heading + angles)
    with np.errstate(divide="ignore"):
        to_x = np.where(cos > 0, (WIDTH - x) / cos, np.where(cos < 0, -x / cos, np.inf))
        to_y = np.where(sin > 0, (HEIGHT - y) / sin, np.where(sin < 0, -y / sin, np.inf))
    nearest: NDArray[np.float64] = np.minimum(to_x, to_y)
    return nearest


def drive(scans: int) -> list[PoseTuple]:
    """Poses of a robot that drives through the room from left to right, and turns."""
    return [(1.0 + 6.0 * at / max(scans - 1, 1), 2.0 + 0.01 * at, 0.7 * at) for at in range(scans)]


def sick_angles(beams: int) -> NDArray[np.float64]:
    """Angles of the beams of a log of CARMEN, in radians."""
    spacing = math.pi / (beams - beams % 2)
    angles: NDArray[np.float64] = -math.pi / 2 + np.arange(beams, dtype=np.float64) * spacing
    return angles


def flaser(pose: PoseTuple, ranges: Iterable[float], stamp: float | None = None) -> str:
    """A line of a log of CARMEN."""
    values = [f"{value:.3f}" for value in ranges]
    place = " ".join(f"{value:.6f}" for value in pose)
    time = "" if stamp is None else f" {stamp:.3f} host {stamp:.3f}"
    return f"FLASER {len(values)} {' '.join(values)} {place} {place}{time}\n"


def robotlaser(pose: PoseTuple, ranges: Iterable[float], first: float, increment: float, most: float) -> str:
    """A line of a log of CARMEN that states angles (radians) and maximum (meters) of the laser; the time is 7."""
    values = [f"{value:.3f}" for value in ranges]
    head = f"0 {first:.6f} {increment * (len(values) - 1):.6f} {increment:.6f} {most:.3f} 0.01 0"
    place = " ".join(f"{value:.6f}" for value in pose)
    return f"ROBOTLASER1 {head} {len(values)} {' '.join(values)} 1 99 {place} 0 0 0 1 2 3 4 5 7 host 8\n"


def carmen_text(scans: int = 24, beams: int = 181, period_s: float | None = 1.0) -> str:
    """A log of CARMEN, with a scan each `period_s` seconds; None: without times."""
    lines = ["# message formats defined\n", "PARAM robot_width 0.5\n"]
    for number, pose in enumerate(drive(scans)):
        stamp = None if period_s is None else 100 + period_s * number
        lines.append(flaser(pose, distances(pose, sick_angles(beams)), stamp))
        lines.append("ODOM 0 0 0 0 0 0 0.1 host 0.1\n")
    return "".join(lines)


def write_carmen(path: Path, **options: Any) -> Path:
    """Write a log of CARMEN; compress it if its name says so."""
    text = carmen_text(**options).encode()
    path.write_bytes(gzip.compress(text) if path.suffix == ".gz" else text)
    return path


class Bag:
    """Writes a bag of ROS: `kind` is ``ros1``, ``sqlite3``, or ``mcap``."""

    def __init__(self, path: Path, kind: str) -> None:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.is_ros1 = kind == "ros1"
        self._types = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_HUMBLE)
        if self.is_ros1:
            transforms = "geometry_msgs/TransformStamped[] transforms"
            self._types.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
        self._writer: Any
        if self.is_ros1:
            self._writer = rosbag1.Writer(path)
        else:
            plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
            self._writer = rosbag2.Writer(path, version=8, storage_plugin=plugin)
        self._connections: dict[str, Any] = {}
        self.recorded: float | None = None
        """When messages are recorded; None: at the times in their headers."""

    def __enter__(self) -> Bag:
        self._writer.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._writer.__exit__(*error)

    def write(self, topic: str, kind: str, stamp: float, **fields: Any) -> None:
        """Write a message of a type, as ``sensor_msgs/LaserScan``."""
        kind = kind.replace("/", "/msg/")
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._types)
        message = self.make(kind, **fields)
        serialize = self._types.serialize_ros1 if self.is_ros1 else self._types.serialize_cdr
        time = round(1e9 * (stamp if self.recorded is None else self.recorded))
        self._writer.write(self._connections[topic], time, serialize(message, kind))

    def make(self, kind: str, **fields: Any) -> Any:
        """Make a message; fields that are left out are zero or empty."""
        zeros: dict[str, Any] = {}
        for name, (node, details) in self._types.fielddefs[kind][1]:
            if name in fields:
                continue
            if node.name == "NAME":
                zeros[name] = self.make(details)
            elif node.name == "BASE":
                zeros[name] = "" if details[0] == "string" else 0
            else:
                zeros[name] = np.zeros(details[1] if node.name == "ARRAY" else 0)
        return self._types.types[kind](**zeros, **fields)

    def header(self, stamp: float, frame: str) -> Any:
        time = {"sec": int(stamp), "nanosec": round(1e9 * (stamp % 1))}
        return self.make(
            "std_msgs/msg/Header", stamp=self.make("builtin_interfaces/msg/Time", **time), frame_id=frame
        )

    def scan(
        self,
        stamp: float,
        ranges: Sequence[float] | NDArray[np.float64],
        *,
        topic: str = "/scan",
        frame: str = "laser",
        first: float = -math.pi,
        increment: float = math.radians(2),
        least: float = 0.1,
        most: float = 30.0,
    ) -> None:
        """Write a scan."""
        self.write(
            topic,
            "sensor_msgs/LaserScan",
            stamp,
            header=self.header(stamp, frame),
            angle_min=first,
            angle_max=first + increment * (len(ranges) - 1),
            angle_increment=increment,
            range_min=least,
            range_max=most,
            ranges=np.asarray(ranges, np.float32),
        )

    def transform(
        self,
        stamp: float,
        parent: str,
        child: str,
        pose: PoseTuple,
        *,
        static: bool = False,
        roll: float = 0.0,
        namespace: str = "",
    ) -> None:
        """Write a transform, on /tf or /tf_static behind a namespace."""
        x, y, _ = pose
        moved = self.make(
            "geometry_msgs/msg/Transform",
            translation=self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=0.3),
            rotation=self.turn(pose[2], roll),
        )
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp, parent),
            child_frame_id=child,
            transform=moved,
        )
        topic = f"{namespace}/tf_static" if static else f"{namespace}/tf"
        self.write(topic, "tf2_msgs/TFMessage", stamp, transforms=[stamped])

    def odometry(
        self, stamp: float, pose: PoseTuple, *, child: str = "base_link", topic: str = "/odom"
    ) -> None:
        """Write an odometry message."""
        x, y, yaw = pose
        place = self.make(
            "geometry_msgs/msg/Pose",
            position=self.make("geometry_msgs/msg/Point", x=x, y=y),
            orientation=self.turn(yaw),
        )
        self.write(
            topic,
            "nav_msgs/Odometry",
            stamp,
            header=self.header(stamp, "odom"),
            child_frame_id=child,
            pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=place, covariance=np.zeros(36)),
            twist=self.make("geometry_msgs/msg/TwistWithCovariance", covariance=np.zeros(36)),
        )

    def turn(self, yaw: float, roll: float = 0.0) -> Any:
        """A rotation by a roll, then by a yaw."""
        return self.make(
            "geometry_msgs/msg/Quaternion",
            x=math.cos(yaw / 2) * math.sin(roll / 2),
            y=math.sin(yaw / 2) * math.sin(roll / 2),
            z=math.sin(yaw / 2) * math.cos(roll / 2),
            w=math.cos(yaw / 2) * math.cos(roll / 2),
        )


FULL_CIRCLE = np.radians(np.arange(-180.0, 180.0, 2.0))
"""Angles of the beams of `Bag.scan` by default."""
