"""Read bags of ROS 1 and ROS 2, and MCAP files: laser scans, and where the laser was.

The pose of a scan is that of the laser's frame at the time of the scan, in the frame `map` if the transforms (tf)
contain it, else in `odom`. Odometry messages count as transforms, where tf has none for the same frame. If nothing
says where the laser is on the robot, it is where the odometry is.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from protocol.errors import there_are
from protocol.metric_scans import BeamAngles, millimeters
from protocol.packages import require
from protocol.transforms import Pose, TransformBuffer, frame_name, mounting_of
from worldsim.recorded.log import LogError, RecordedLog

SUFFIXES = (".bag", ".mcap", ".db3")

SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
FIXED_FRAMES = ("map", "odom")
"""Frames in which poses are wanted, the best one first."""


@dataclass
class _Content:
    """What a bag contains, as far as it is read."""

    scans: list[tuple[float, Any]] = field(default_factory=list)
    """Time and message of each scan."""
    transforms: TransformBuffer = field(default_factory=TransformBuffer)
    odometry: dict[str, list[tuple[float, str, str, Pose]]] = field(default_factory=dict)
    """Time, frame, frame of the robot, and pose of each message, by topic."""
    refused: dict[str, str] = field(default_factory=dict)
    """Why a frame has no pose in the plane, as those of tilted cameras; only frames below the laser matter."""

    def add_odometry(self, topic: str, message: Any) -> None:
        """Add an odometry message."""
        parent, child = frame_name(message.header.frame_id), frame_name(message.child_frame_id)
        pose, is_flipped = self._pose(message.pose.pose, child)
        if pose is not None and not is_flipped:
            entry = _seconds(message.header.stamp), parent, child, pose
            self.odometry.setdefault(topic, []).append(entry)

    def add_transforms(self, message: Any, *, is_static: bool) -> None:
        """Add a message of transforms."""
        for each in message.transforms:
            parent, child = frame_name(each.header.frame_id), frame_name(each.child_frame_id)
            pose, is_flipped = self._pose(each.transform, child)
            if pose is not None:
                stamp = _seconds(each.header.stamp)
                self.transforms.add(parent, child, stamp, pose, is_static=is_static, is_flipped=is_flipped)

    def _pose(self, message: Any, frame: str) -> tuple[Pose | None, bool]:
        """Return the pose that a message of type Pose or Transform contains, and whether the frame is upside down.

        None if it is refused.
        """
        is_transform = hasattr(message, "translation")
        place = message.translation if is_transform else message.position
        turn = message.rotation if is_transform else message.orientation
        try:
            return mounting_of(place.x, place.y, turn.x, turn.y, turn.z, turn.w)
        except ValueError as error:
            self.refused[frame] = str(error)
            return None, False


def read(path: Path, every: int, topic: str) -> RecordedLog:
    """Read each of `every` scans of a bag from `topic`, or from the only topic that has scans if it is empty.

    Raises LogError if the bag is damaged, its scans do not fit together, or it lacks scans or poses;
    MissingPackageError if the package that reads bags is not installed.
    """
    require("rosbags", "mcap", "bags need")
    from rosbags.highlevel import AnyReader  # noqa: PLC0415  optional, and slow to import
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            topic = _scan_topic(path, reader.connections, topic)
            content = _content(reader, topic, every)
    except LogError:
        raise
    except Exception as error:  # rosbags raises errors of many types for damaged bags
        cause = " ".join(str(error).split()) or type(error).__name__
        raise LogError(f"{path}: not a readable bag: {cause}{_repair(path)}") from None
    if not content.scans:
        raise LogError(f"{path}: no laser scans on {topic}")
    return _log(path, content)


def _repair(path: Path) -> str:
    """Return how to repair a bag whose recorder was killed; empty if no tool is known."""
    files = [path] if path.is_file() else sorted(path.iterdir())
    if any(file.suffix == ".mcap" for file in files):
        return "; mcap recover (https://mcap.dev) repairs files that were cut off"
    return "; rosbag reindex repairs bags that were cut off" if path.suffix == ".bag" else ""


def _scan_topic(path: Path, connections: list[Any], topic: str) -> str:
    topics: list[str] = sorted({each.topic for each in connections if each.msgtype == SCAN})
    if not topics:
        kinds = sorted({each.msgtype for each in connections})
        raise LogError(f"{path}: no laser scans ({SCAN}); it has {', '.join(kinds) or 'no messages'}")
    if not topic and len(topics) == 1:
        return topics[0]
    if not topic:
        raise LogError(f"{path}: several lasers; choose one with --topic: {', '.join(topics)}")
    if topic not in topics:
        raise LogError(f"{path}: topic = {topic!r}: no laser scans on it; {there_are(topics, topic)}")
    return topic


def _content(reader: Any, topic: str, every: int) -> _Content:
    """Read scans, transforms, and odometry."""
    content = _Content()
    wanted = [
        each
        for each in reader.connections
        if each.topic == topic or each.msgtype in TRANSFORMS or each.msgtype == ODOMETRY
    ]
    count = 0
    for connection, _, raw in reader.messages(connections=wanted):
        is_scan = connection.topic == topic
        count += is_scan
        if is_scan and (count - 1) % every:
            continue
        message = reader.deserialize(raw, connection.msgtype)
        if is_scan:
            content.scans.append((_seconds(message.header.stamp), message))
        elif connection.msgtype == ODOMETRY:
            content.add_odometry(connection.topic, message)
        else:
            content.add_transforms(message, is_static=connection.topic.endswith("tf_static"))
    return content


def _log(path: Path, content: _Content) -> RecordedLog:
    """Return the log: scans in the order of time, each with its pose."""
    scans = sorted(content.scans, key=lambda each: each[0])
    laser = frame_name(scans[0][1].header.frame_id)
    frame, root = _add_odometry(path, content, laser)
    angles, reverse = _angles(path, scans, -1 if content.transforms.is_flipped(frame, root) else 1)
    found = [(stamp, each, content.transforms.pose(frame, root, stamp)) for stamp, each in scans]
    placed = [(stamp, each, pose) for stamp, each, pose in found if pose is not None]
    if not placed:
        raise LogError(
            f"{path}: no poses: the transforms from {root} to {frame} are not of the time of any scan"
        )
    notes: tuple[str, ...] = ()
    if missing := len(scans) - len(placed):
        notes = (f"{path}: {missing} of {len(scans)} scans have no pose at their time, and are left out",)
    return RecordedLog(
        path.name.removesuffix(path.suffix) if path.is_file() else path.name,
        angles,
        np.array([pose for *_, pose in placed], np.float64),
        np.array(
            [
                millimeters(each.ranges, least=each.range_min, nothing=each.range_max, reverse=reverse)
                for _, each, _ in placed
            ]
        ),
        np.array([stamp for stamp, *_ in placed], np.float64),
        notes,
    )


def _add_odometry(path: Path, content: _Content, laser: str) -> tuple[str, str]:
    """Add odometry where tf has none; return the frame of the laser, and the fixed frame for its poses."""
    transforms = content.transforms
    root = _fixed_frame(transforms, laser)
    if root:
        return laser, root
    top = transforms.ancestors(laser)[-1]
    if top in content.refused:
        raise LogError(f"{path}: frame {top!r}: {content.refused[top]}")
    topics = sorted(content.odometry)
    if len(topics) > 1:
        listed = ", ".join(topics)
        raise LogError(
            f"{path}: no transforms (tf) to the laser's frame {laser!r}, and several odometries: {listed}; "
            "one of them, or tf, must say where the laser is"
        )
    if not topics:
        known = " -> ".join(reversed(transforms.ancestors(laser)))
        raise LogError(
            f"{path}: no poses: it has no odometry ({ODOMETRY}), and no transforms (tf) from "
            f"{' or '.join(FIXED_FRAMES)} to the laser's frame {laser!r}"
            + (f"; only {known}" if "->" in known else "")
        )
    for stamp, parent, child, pose in content.odometry[topics[0]]:
        transforms.add(parent or FIXED_FRAMES[-1], child or laser, stamp, pose, is_static=False)
    _, parent, child, _ = content.odometry[topics[0]][0]
    is_mounted = (child or laser) in transforms.ancestors(laser)
    return (laser if is_mounted else child), parent or FIXED_FRAMES[-1]


def _fixed_frame(transforms: TransformBuffer, laser: str) -> str:
    """Return the best fixed frame above a laser's frame in which it moves; empty if there is none."""
    above = transforms.ancestors(laser)
    for frame in FIXED_FRAMES:
        for each in above[1:]:
            if each.rpartition("/")[2] == frame and not transforms.is_fixed(laser, each):
                return each
    return ""


def _angles(path: Path, scans: list[tuple[float, Any]], sign: int) -> tuple[BeamAngles, bool]:
    """Return the angles of all scans, and whether their beams run counterclockwise; LogError if they change.

    `sign` is -1 for a laser that hangs upside down, so that its angles run the other way.
    """
    first, *_ = found = [
        (len(each.ranges), float(each.angle_min), float(each.angle_increment)) for _, each in scans
    ]
    try:
        angles = BeamAngles.of(first[0], sign * first[1], sign * first[2])
    except ValueError as error:
        raise LogError(f"{path}: {error}") from None
    for number, here in enumerate(found, 1):
        is_same = here[0] == first[0] and np.allclose(here[1:], first[1:], rtol=0, atol=1e-4)
        if not is_same:
            raise LogError(
                f"{path}: scan {number} has {_described(here)}, after scans of {_described(first)}: "
                "the laser must stay the same"
            )
    return angles, sign * first[2] > 0


def _described(beams: tuple[int, float, float]) -> str:
    return f"{beams[0]} beams from {beams[1]:.3f} rad, {beams[2]:.5f} rad apart"


def _seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec * 1e-9)
