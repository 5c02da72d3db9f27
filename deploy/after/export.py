"""`murmur export`: a run as a ROS 2 bag in MCAP, for RViz, Foxglove, and other ROS tools.

    topic               type and content
    /tf_static          map -> rN/odom (its start pose), rN/base_link -> rN/laser (the same place)
    /tf                 rN/odom -> rN/base_link, every step: its true motion since the start
    /truth              nav_msgs/OccupancyGrid, once
    /rN/pose            geometry_msgs/PoseStamped, every step
    /rN/odom            nav_msgs/Odometry, every step: the transform of /tf, and the velocity in this step
    /rN/goal_pose       geometry_msgs/PoseStamped, when its target changes
    /rN/scan            sensor_msgs/LaserScan, every step: cast again from map and poses (`deploy.after.recast_scans`)
    /rN/map             nav_msgs/OccupancyGrid: its planning map, at the steps where it was updated
    /rN/polygons        visualization_msgs/MarkerArray: the approximations of all maps, as this robot holds them
    /radio/frames       murmur_msgs/RadioFrame: each frame with its sender, receiver, contents and verdict
    /radio/steps        murmur_msgs/RadioStep, every step: bytes transmitted, by traffic type, and bytes over the budget

Time is the step in seconds. The frame `map` is the frame of the map file: meters, y up. The bag contains the
definitions of all messages, including the two of Murmur, so that any reader can decode them. All topics are reliable;
maps, polygons, and static transforms are transient local: a viewer that joins later gets the last ones.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

from deploy.after.archive import read
from protocol.nanoseconds import SECOND
from protocol.packages import require
from worldsim.atomic_files import naming

BAG = "rosbag"

LATCHED = {"map": 1, "truth": 1, "tf_static": 1, "polygons": 100}
"""Topics whose last messages a viewer gets that joins later: the last part of their name, and how many."""

DEPTH = 100
"""Queue length of all other topics."""

FOREVER = divmod(2**63 - 1, SECOND)
"""Seconds and nanoseconds of an infinite duration."""


def export_mcap(directory: Path) -> Path:
    """Write a run directory's bag, ``rosbag/`` in it; return the MCAP file.

    Raises MissingPackageError if the package that writes it is not installed; ScenarioError if it is not a run
    directory, or a table is missing.
    """
    require("rosbags", "mcap", "an export needs")
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer  # noqa: PLC0415

    from deploy.after.bag_messages import BagMessages  # noqa: PLC0415

    messages = BagMessages(read(directory))
    types = messages.ros.types
    with (
        naming(directory / BAG),
        tempfile.TemporaryDirectory(dir=directory, prefix=".export-") as folder,
    ):
        writer = Writer(Path(folder) / BAG, version=8, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            topics: dict[str, Any] = {}
            for topic, step, message in messages.all():
                if topic not in topics:
                    name = topic.rpartition("/")[2]
                    offered = profile(latched=name in LATCHED, depth=LATCHED.get(name, DEPTH))
                    topics[topic] = writer.add_connection(
                        topic, message.__msgtype__, typestore=types, offered_qos_profiles=[offered]
                    )
                writer.write(topics[topic], step * SECOND, messages.ros.encode(message))
        shutil.rmtree(directory / BAG, ignore_errors=True)
        shutil.move(Path(folder) / BAG, directory / BAG)
    return directory / BAG / f"{BAG}.mcap"


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
