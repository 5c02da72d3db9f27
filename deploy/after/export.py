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

import importlib.util
import math
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from deploy.after.archive import Archive, Table, read
from deploy.after.recast_scans import Lasers, Rescan
from deploy.after.ros_messages import MAP_FRAME, RADIO_FRAME, RADIO_STEP, RosMessages, profile
from deploy.dashboard.shapes import corner
from deploy.record.colors import GROUPS, robot_color
from netshaper.ledger import FRAMES
from protocol.grid import FREE, OCCUPIED, Grid, RayTable
from protocol.messages import Outlines
from protocol.scans import HIT, NONE, Readings
from protocol.transforms import Pose
from worldsim.maps import Map

BAG = "rosbag"
EDGE_WIDTH_M = 0.05

GRID, POSE, TRANSFORMS = (
    "nav_msgs/msg/OccupancyGrid",
    "geometry_msgs/msg/PoseStamped",
    "tf2_msgs/msg/TFMessage",
)

LATCHED = {"map": 1, "truth": 1, "tf_static": 1, "polygons": 100}
"""Topics whose last messages a viewer gets that joins later: the last part of their name, and how many."""

DEPTH = 100
"""Queue length of all other topics."""

HERE = Pose(0.0, 0.0, 0.0)

Stamped = tuple[str, str, int, Any]
"""Topic, message type, step, message."""


class ExportError(ValueError):
    """A package needed for the export is missing."""


def export_mcap(directory: Path) -> Path:
    """Write a run directory's bag, ``rosbag/`` in it; return the MCAP file.

    Raises ExportError if the package that writes it is not installed; ScenarioError if it is not a run directory, or a
    table is missing.
    """
    if importlib.util.find_spec("rosbags") is None:
        raise ExportError("an export needs the package rosbags: pip install 'murmur-robots[mcap]'")
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer  # noqa: PLC0415

    archive = read(directory)
    messages = _Messages(archive)
    types = messages.ros.types
    with tempfile.TemporaryDirectory(dir=directory, prefix=".export-") as folder:
        writer = Writer(Path(folder) / BAG, version=8, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            topics: dict[str, Any] = {}
            for topic, kind, step, message in messages.all():
                if topic not in topics:
                    name = topic.rpartition("/")[2]
                    offered = profile(latched=name in LATCHED, depth=LATCHED.get(name, DEPTH))
                    topics[topic] = writer.add_connection(
                        topic, kind, typestore=types, offered_qos_profiles=[offered]
                    )
                writer.write(topics[topic], step * 10**9, types.serialize_cdr(message, kind))
        shutil.rmtree(directory / BAG, ignore_errors=True)
        shutil.move(Path(folder) / BAG, directory / BAG)
    return directory / BAG / f"{BAG}.mcap"


def ranges_of(readings: Readings, ray_table: RayTable, resolution: float) -> Any:
    """Return a scan's readings in ROS' convention: metres, counterclockwise from +x (y up).

    A beam that hit no wall is infinite; a beam that was not sent is NaN. A wall lies at the center of its cell.
    """
    crossed = (readings & NONE).astype(np.int64)
    at = np.minimum(ray_table.start[:-1] + crossed, len(ray_table.cells) - 1)
    meters = resolution * np.hypot(ray_table.cells[at, 0], ray_table.cells[at, 1])
    meters = np.where(readings & HIT, meters, np.inf)
    meters[readings == NONE] = np.nan
    return np.roll(meters[::-1], 1).astype(np.float32)


def occupancy(grid: Grid) -> Any:
    """Return a grid as ROS' occupancy data, starting at the lower left: -1 unknown, 0 free, 100 occupied."""
    shades = np.full(grid.shape, -1, np.int8)
    shades[grid == FREE] = 0
    shades[grid == OCCUPIED] = 100
    return shades[::-1].ravel()


class _Messages:
    """All messages of a run, in chronological order."""

    def __init__(self, archive: Archive) -> None:
        self.ros = RosMessages()
        self._archive = archive
        self._lasers = Lasers(archive)
        self._tracks = {robot: archive.of_robot(robot) for robot in range(archive.plan.scenario.robots)}
        self._poses = {robot: _poses(track) for robot, track in self._tracks.items()}
        """The poses of each robot by step."""
        self._goals: dict[int, tuple[float, float]] = {}
        """The last goal of each robot."""

    def all(self) -> Iterator[Stamped]:
        """Yield them one by one."""
        yield "/truth", GRID, 0, self._grid(0, self._archive.plan.map.cells)
        yield "/tf_static", TRANSFORMS, 0, self.ros.transforms(0, self._static_frames())
        maps = self._map_reports()
        for step, scans in self._lasers.scans():
            moved = {(_odom(scan.robot), _base(scan.robot)): self._moved(scan.robot, step) for scan in scans}
            yield "/tf", TRANSFORMS, step, self.ros.transforms(step, moved)
            for scan in scans:
                yield from self._robot(step, scan)
            for robot, report in maps.get(step, []):
                if isinstance(report, Outlines):
                    markers = self._markers(step, report)
                    yield f"/r{robot}/polygons", "visualization_msgs/msg/MarkerArray", step, markers
                else:
                    yield f"/r{robot}/map", GRID, step, self._grid(step, report)
            yield from self._radio(step)

    def _robot(self, step: int, scan: Rescan) -> Iterator[Stamped]:
        """The pose, motion, new goal, and scan of a robot in a step."""
        robot, name = scan.robot, f"/r{scan.robot}"
        yield f"{name}/pose", POSE, step, self.ros.stamped(step, self._poses[robot][step])
        yield f"{name}/odom", "nav_msgs/msg/Odometry", step, self._odometry(step, robot)
        track = self._tracks[robot]
        (row,) = np.flatnonzero(track["step"] == step)
        goal = float(track["target_x"][row]), float(track["target_y"][row])
        if not math.isnan(goal[0]) and goal != self._goals.get(robot):
            self._goals[robot] = goal
            yield f"{name}/goal_pose", POSE, step, self.ros.stamped(step, Pose(*goal, 0.0))
        yield f"{name}/scan", "sensor_msgs/msg/LaserScan", step, self._scan(step, scan)

    def _static_frames(self) -> dict[tuple[str, str], Pose]:
        """The pose of each frame that does not move, in its parent."""
        frames = {}
        for robot, poses in self._poses.items():
            if poses:
                frames[MAP_FRAME, _odom(robot)] = next(iter(poses.values()))
                frames[_base(robot), _laser(robot)] = HERE
        return frames

    def _moved(self, robot: int, step: int) -> Pose:
        """A robot's pose in the frame that lies at its first one."""
        poses = self._poses[robot]
        return next(iter(poses.values())).inverse().then(poses[step])

    def _odometry(self, step: int, robot: int) -> Any:
        """A robot's motion since the start, and its velocity in its own frame, from the motion in this step."""
        before, now = self._poses[robot].get(step - 1), self._poses[robot][step]
        speed = before.inverse().then(now) if before is not None else HERE
        twist = self.ros.make(
            "geometry_msgs/msg/Twist",
            linear=self.ros.point(speed.x, speed.y, "Vector3"),
            angular=self.ros.make("geometry_msgs/msg/Vector3", z=math.remainder(speed.yaw, 2 * math.pi)),
        )
        pose = self.ros.make(
            "geometry_msgs/msg/PoseWithCovariance", pose=self.ros.pose(self._moved(robot, step))
        )
        return self.ros.make(
            "nav_msgs/msg/Odometry",
            header=self.ros.header(step, _odom(robot)),
            child_frame_id=_base(robot),
            pose=pose,
            twist=self.ros.make("geometry_msgs/msg/TwistWithCovariance", twist=twist),
        )

    def _radio(self, step: int) -> Iterator[Stamped]:
        """The frames of a step, in the order of the ledger, and the sums of their bytes."""
        ledger = self._archive.ledger
        begin, end = np.searchsorted(ledger["step"], (step, step + 1))
        here = {name: column[begin:end] for name, column in ledger.items()}
        same = ("round", "connection", "frame", "sender", "receiver", "map")
        frames: dict[tuple[int, ...], list[int]] = {}
        for row, key in enumerate(zip(*(here[name].tolist() for name in same), strict=True)):
            frames.setdefault(key, []).append(row)
        for key, rows in frames.items():
            frame = self._frame(step, dict(zip(same, key, strict=True)), here, rows)
            yield "/radio/frames", RADIO_FRAME, step, frame
        carried = here["carried"].astype(bool)
        sums = {
            name: int(here["bytes"][carried & np.isin(here["kind"], group.kinds)].sum())
            for name, group in GROUPS.items()
        }
        budget = float(self._archive.budgets[step])
        totals = self.ros.make(
            RADIO_STEP,
            header=self.ros.header(step),
            budget=budget if math.isfinite(budget) else math.nan,
            frames=len(frames),
            carried=int(here["bytes"][carried].sum()),
            waiting=int(here["bytes"][here["cause"] == "budget"].sum()),
            **sums,
        )
        yield "/radio/steps", RADIO_STEP, step, totals

    def _frame(self, step: int, key: dict[str, int], here: Table, rows: list[int]) -> Any:
        """One frame: the rows of the ledger that differ only in packet kind, or in whether the packets were carried."""
        carried, sizes = here["carried"][rows].astype(bool), here["bytes"][rows]
        kinds = here["kind"][rows]
        unique = list(dict.fromkeys(kinds.tolist()))
        return self.ros.make(
            RADIO_FRAME,
            header=self.ros.header(step),
            **key | {"frame": FRAMES[key["frame"]]},
            kinds=unique,
            packets=np.array([here["packets"][rows][kinds == kind].sum() for kind in unique], np.uint32),
            bytes=np.array([sizes[kinds == kind].sum() for kind in unique], np.uint32),
            carried=int(sizes[carried].sum()),
            refused=int(sizes[~carried].sum()),
            cause=next((cause for cause in here["cause"][rows].tolist() if cause), ""),
            received=int(here["received_by"][rows].max()),
        )

    def _map_reports(self) -> dict[int, list[tuple[int, Grid | Outlines]]]:
        """Changed planning maps and outlines, each with its robot, by step."""
        maps = self._archive.maps
        by_step: dict[int, list[tuple[int, Grid | Outlines]]] = {}
        for robot in range(self._archive.plan.scenario.robots):
            for step in sorted(set(maps.steps(robot))):
                grid = maps.planning(robot, step)
                assert grid is not None
                by_step.setdefault(step, []).append((robot, grid))
        for robot, outlines in maps.outline_changes():
            by_step.setdefault(outlines.step, []).append((robot, outlines))
        return by_step

    def _scan(self, step: int, scan: Rescan) -> Any:
        """A scan in the frame of the laser, whose first beam points backward."""
        ray_table, world = self._lasers.ray_tables[scan.robot], self._archive.plan.map
        ranges = ranges_of(scan.readings, ray_table, world.resolution)
        turn = 2 * math.pi / ray_table.beams
        backward = (self._poses[scan.robot][step].yaw - math.pi) / turn  # in beams from +x of the map
        first = round(backward)
        angle_min = (first - backward) * turn - math.pi
        return self.ros.make(
            "sensor_msgs/msg/LaserScan",
            header=self.ros.header(step, _laser(scan.robot)),
            angle_min=angle_min,
            angle_max=angle_min + turn * (ray_table.beams - 1),
            angle_increment=turn,
            scan_time=1.0,
            range_max=self._archive.plan.world.bodies[scan.robot].range_cells * world.resolution,
            ranges=np.roll(ranges, -first),
        )

    def _grid(self, step: int, grid: Grid) -> Any:
        world: Map = self._archive.plan.map
        info = self.ros.make(
            "nav_msgs/msg/MapMetaData",
            resolution=world.resolution,
            width=world.width,
            height=world.height,
            origin=self.ros.pose(Pose(*world.origin[:2], 0.0)),
        )
        return self.ros.make(GRID, header=self.ros.header(step), info=info, data=occupancy(grid))

    def _markers(self, step: int, outlines: Outlines) -> Any:
        """One marker per map: its edges, walls in full color, edges to unknown cells in a pale one."""
        rows = np.frombuffer(outlines.vertices, "<i2").reshape(-1, 4)
        world = self._archive.plan.map
        places = (np.array(corner(world)) + (rows[:, 1:3] / 4 + 0.5) * world.resolution) * (1, -1)
        starts = np.flatnonzero(np.diff(rows[:, 0], prepend=-1))
        following = np.arange(1, len(rows) + 1)
        following[np.append(starts[1:], len(rows)).astype(int) - 1] = starts
        red, green, blue = (part / 255 for part in robot_color(outlines.map_id))
        wall, open_ = (
            self.ros.make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=alpha) for alpha in (1.0, 0.4)
        )
        points, colors = [], []
        for here, there in enumerate(following):
            points += [self.ros.point(*places[here]), self.ros.point(*places[there])]
            colors += 2 * [wall if rows[here, 3] & 1 else open_]
        kind: Any = self.ros.types.types["visualization_msgs/msg/Marker"]
        marker = self.ros.make(
            "visualization_msgs/msg/Marker",
            header=self.ros.header(step),
            ns="approximations",
            id=outlines.map_id,
            type=kind.LINE_LIST,
            action=kind.ADD if points else kind.DELETE,
            pose=self.ros.pose(HERE),
            scale=self.ros.make("geometry_msgs/msg/Vector3", x=EDGE_WIDTH_M),
            color=self.ros.make("std_msgs/msg/ColorRGBA", a=1.0),
            points=points,
            colors=colors,
            text=f"map of robot {outlines.map_id}",
        )
        return self.ros.make("visualization_msgs/msg/MarkerArray", markers=[marker])


def _poses(track: Table) -> dict[int, Pose]:
    """Return a robot's poses by step; recorded headings are clockwise, because the world computes with y down."""
    columns = (track[name].tolist() for name in ("step", "x", "y", "heading"))
    return {step: Pose(x, y, -math.radians(heading)) for step, x, y, heading in zip(*columns, strict=True)}


def _odom(robot: int) -> str:
    return f"r{robot}/odom"


def _base(robot: int) -> str:
    return f"r{robot}/base_link"


def _laser(robot: int) -> str:
    return f"r{robot}/laser"
