"""Read bags of ROS 1 and ROS 2, and MCAP files: laser scans, and where the laser was.

The pose of a scan is that of its frame at the time of the scan, in the frame `map` if the transforms (tf) contain it,
else in `odom`. Odometry messages count as transforms, where tf has none for the same frame. If nothing says where the
laser is on the robot, it is where the odometry is. Without odometry, any other frame in which the laser moves is used.

If robots have namespaces, only topics in those around the scans count: frames of several robots may have equal names.
Times are those in the headers of messages. Messages without one were sent when they were recorded.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from protocol.errors import there_are
from protocol.metric_scans import MetricScan
from protocol.packages import require
from protocol.transforms import Pose, TransformBuffer, frame_name, mounting_of
from worldsim.recorded.log import MAX_BACK_S, LogError, RecordedLog

SUFFIXES = (".bag", ".mcap", ".db3")

SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
FIXED_FRAMES = ("map", "odom")
"""Frames in which poses are wanted, the best one first."""
LONGEST_GAP_S = 2.0
"""Seconds between two transforms from which on the motion between them is unknown."""


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

    def add_odometry(self, topic: str, message: Any, recorded: float) -> None:
        """Add an odometry message that was recorded at a time."""
        parent, child = frame_name(message.header.frame_id), frame_name(message.child_frame_id)
        pose, is_flipped = self._pose(message.pose.pose, child)
        if pose is not None and not is_flipped:
            entry = _seconds(message.header, recorded), parent, child, pose
            self.odometry.setdefault(topic, []).append(entry)

    def add_transforms(self, message: Any, recorded: float, *, is_static: bool) -> None:
        """Add a message of transforms that was recorded at a time."""
        for each in message.transforms:
            parent, child = frame_name(each.header.frame_id), frame_name(each.child_frame_id)
            pose, is_flipped = self._pose(each.transform, child)
            if pose is not None:
                stamp = _seconds(each.header, recorded)
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
    """Return what may help: the bag of a single file, or a tool for bags whose recorder was killed."""
    files = [path] if path.is_file() else sorted(path.iterdir())
    whole = path.is_file() and (path.parent / "metadata.yaml").is_file()
    hints = [f"it is a file of the bag {path.parent}, which may be readable"] if whole else []
    if any(file.suffix == ".mcap" for file in files):
        hints.append("mcap recover (https://mcap.dev) repairs files that were cut off")
    elif path.suffix == ".bag":
        hints.append("rosbag reindex repairs bags that were cut off")
    return "".join(f"; {hint}" for hint in hints)


def _scan_topic(path: Path, connections: list[Any], topic: str) -> str:
    topics: list[str] = sorted({each.topic for each in connections if each.msgtype == SCAN})
    if not topics:
        kinds = sorted({each.msgtype for each in connections})
        raise LogError(f"{path}: no laser scans ({SCAN}); it has {', '.join(kinds) or 'no messages'}")
    if not topic and len(topics) == 1:
        return topics[0]
    if not topic:
        raise LogError(
            f"{path}: several lasers; choose one with --topic: {', '.join(topics)}; --topic "
            f"{','.join(topics[:2])} makes a robot of each"
        )
    if topic not in topics:
        raise LogError(f"{path}: topic = {topic!r}: no laser scans on it; {there_are(topics, topic)}")
    return topic


def _content(reader: Any, topic: str, every: int) -> _Content:
    """Read scans, transforms, and odometry."""
    content = _Content()
    of_robot = {topic}
    for is_one in (_is_static, _is_transform, lambda each: each.msgtype == ODOMETRY):
        of_robot |= _around(topic, {each.topic for each in reader.connections if is_one(each)})
    wanted = [each for each in reader.connections if each.topic in of_robot]
    count = 0
    for connection, nanoseconds, raw in reader.messages(connections=wanted):
        is_scan = connection.topic == topic
        count += is_scan
        if is_scan and (count - 1) % every:
            continue
        message, recorded = reader.deserialize(raw, connection.msgtype), nanoseconds * 1e-9
        if is_scan:
            content.scans.append((_seconds(message.header, recorded), message))
        elif connection.msgtype == ODOMETRY:
            content.add_odometry(connection.topic, message, recorded)
        else:
            content.add_transforms(message, recorded, is_static=_is_static(connection))
    return content


def _is_static(connection: Any) -> bool:
    return connection.msgtype in TRANSFORMS and connection.topic.endswith("tf_static")


def _is_transform(connection: Any) -> bool:
    return connection.msgtype in TRANSFORMS and not _is_static(connection)


def _around(scan: str, topics: set[str]) -> set[str]:
    """Return the topics in namespaces around a topic of scans, as those of its robot; all if there are none."""
    return {each for each in topics if scan.startswith(f"{each.rpartition('/')[0]}/")} or topics


def _log(path: Path, content: _Content) -> RecordedLog:
    """Return the log: scans in the order of time, each with its pose."""
    _check_times(path, content.scans)
    scans = sorted(content.scans, key=lambda each: each[0])
    frames = dict.fromkeys(frame_name(each.header.frame_id) for _, each in scans)
    lines = {laser: _add_odometry(path, content, laser) for laser in frames}
    """The frame whose pose is that of the laser, and the fixed frame."""
    frame, root = next(iter(lines.values()))
    if other := next((laser for laser, line in lines.items() if line[1] != root), ""):
        raise LogError(
            f"{path}: scans of frame {next(iter(frames))!r} have poses in {root!r}, and those of {other!r} in "
            f"{lines[other][1]!r}; all must have them in one frame"
        )
    transforms, placed, gaps = content.transforms, [], 0
    for stamp, each in scans:
        frame, _ = lines[frame_name(each.header.frame_id)]
        pose = transforms.pose(frame, root, stamp, longest_gap=LONGEST_GAP_S)
        if pose is None:
            gaps += transforms.pose(frame, root, stamp) is not None
            continue
        scan = MetricScan.of_message(each, is_flipped=transforms.is_flipped(frame, root))
        placed.append((scan, pose, stamp))
    if not placed and gaps:
        raise LogError(
            f"{path}: no poses: all scans lie between transforms from {root} to {frame} that are more than "
            f"{LONGEST_GAP_S:g} s apart"
        )
    if not placed:
        first, last = transforms.times(frame, root)
        raise LogError(
            f"{path}: no poses: the transforms from {root} to {frame} are not of the time of any scan: they are of "
            f"{first:.1f} to {last:.1f} s, and scans of {scans[0][0]:.1f} to {scans[-1][0]:.1f} s"
        )
    notes = [
        f"{path}: {number} of {len(scans)} scans {why}, and are left out"
        for number, why in (
            (len(scans) - len(placed) - gaps, "have no pose at their time"),
            (gaps, f"lie between transforms that are more than {LONGEST_GAP_S:g} s apart"),
        )
        if number
    ]
    fixed = root.rpartition("/")[2]
    if fixed not in FIXED_FRAMES:
        notes.append(
            f"{path}: poses are those in frame {root!r}, as there is neither {' nor '.join(FIXED_FRAMES)}"
        )
    elif fixed != FIXED_FRAMES[0]:
        notes.append(
            f"{path}: poses are those of odometry, in frame {root!r}: their errors grow, and robots share no frame"
        )
    name = path.name.removesuffix(path.suffix) if path.is_file() else path.name
    found, poses, stamps = zip(*placed, strict=True)
    return RecordedLog.of(path, name, found, poses, stamps, notes)


def _check_times(path: Path, scans: list[tuple[float, Any]]) -> None:
    """Raise LogError if the time jumps back, so that some times are not unique."""
    newest = scans[0][0]
    for number, (stamp, _) in enumerate(scans, 1):
        if newest - stamp > MAX_BACK_S:
            raise LogError(
                f"{path}: the time jumps back by {newest - stamp:.0f} s at scan {number}, so a clock was set back, or "
                "the bag was recorded in parts; cut it there (for example mcap filter --start ... --end ...), and "
                "replay one part"
            )
        newest = max(newest, stamp)


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
    if not topics and transforms.has_moved(laser, top):
        return laser, top
    if len(topics) > 1:
        listed = ", ".join(topics)
        raise LogError(
            f"{path}: no transforms (tf) to the laser's frame {laser!r}, and several odometries: {listed}; "
            "one of them, or tf, must say where the laser is"
        )
    if not topics:
        known = " -> ".join(reversed(transforms.ancestors(laser)))
        others = (
            f"; only between {', '.join(transforms.frames)}: was /tf_static recorded?"
            if transforms.frames
            else ""
        )
        raise LogError(
            f"{path}: no poses: it has no odometry ({ODOMETRY}), and no transforms (tf) from "
            f"{' or '.join(FIXED_FRAMES)} to the laser's frame {laser!r}"
            + (f"; only {known}" if "->" in known else others)
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


def _seconds(header: Any, recorded: float) -> float:
    """Return the time of a message; that at which it was recorded if its header has none."""
    return float(header.stamp.sec + header.stamp.nanosec * 1e-9) or recorded
