"""`murmur export`: a run as a ROS 2 bag in MCAP, for Foxglove and ROS tools.

    /tf                 map -> rN (its pose), map -> rN/laser (its position, not rotated: beams are fixed
                        to the map)
    /truth              nav_msgs/OccupancyGrid, once
    /rN/pose            geometry_msgs/PoseStamped, every step
    /rN/scan            sensor_msgs/LaserScan, every step: cast again from map and poses (`deploy.after.recast_scans`)
    /rN/map             nav_msgs/OccupancyGrid: its planning map, at the steps where it was updated
    /rN/polygons        visualization_msgs/MarkerArray: the approximations of all maps, as this robot holds them
    /radio/frames       murmur_msgs/RadioFrame: each frame with its sender, receiver, contents and verdict
    /radio/steps        murmur_msgs/RadioStep, every step: bytes transmitted, by traffic type, and bytes over the budget

Time is the step in seconds. The frame `map` is the frame of the map file: meters, y up. The bag contains the
definitions of all messages, including the two of Murmur, so that any reader can decode them.
"""

from __future__ import annotations

import importlib.util
import math
import shutil
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from deploy.after.archive import Archive, Table, read
from deploy.after.recast_scans import Lasers, Rescan
from deploy.dashboard.shapes import corner
from deploy.record.colors import GROUPS, robot_color
from netshaper.ledger import FRAMES
from protocol.grid import FREE, OCCUPIED, Grid, RayTable
from protocol.messages import Outlines
from protocol.scans import HIT, NONE, Readings
from worldsim.maps import Map

BAG = "rosbag"
MAP_FRAME = "map"
EDGE_WIDTH_M = 0.05

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
    with tempfile.TemporaryDirectory(dir=directory, prefix=".export-") as folder:
        writer = Writer(Path(folder) / BAG, version=8, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            topics: dict[str, Any] = {}
            for topic, kind, step, message in messages.all():
                if topic not in topics:
                    topics[topic] = writer.add_connection(topic, kind, typestore=messages.types)
                writer.write(topics[topic], step * 10**9, messages.types.serialize_cdr(message, kind))
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
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415  only exports need it

        self.types = get_typestore(Stores.ROS2_HUMBLE)
        for name, text in DEFINITIONS.items():
            self.types.register(get_types_from_msg(text, name))
        self._archive = archive
        self._lasers = Lasers(archive)

    def all(self) -> Iterator[Stamped]:
        """Yield them one by one."""
        yield "/truth", "nav_msgs/msg/OccupancyGrid", 0, self._grid(0, self._archive.plan.map.cells)
        maps = self._map_reports()
        for step, scans in self._lasers.scans():
            poses = {scan.robot: self._pose(scan.robot, step) for scan in scans}
            yield "/tf", "tf2_msgs/msg/TFMessage", step, self._transforms(step, poses)
            for scan in scans:
                name = f"/r{scan.robot}"
                pose = self._make(
                    "geometry_msgs/msg/PoseStamped", header=self._header(step), pose=poses[scan.robot]
                )
                yield f"{name}/pose", "geometry_msgs/msg/PoseStamped", step, pose
                yield f"{name}/scan", "sensor_msgs/msg/LaserScan", step, self._scan(step, scan)
            for robot, report in maps.get(step, []):
                if isinstance(report, Outlines):
                    markers = self._markers(step, report)
                    yield f"/r{robot}/polygons", "visualization_msgs/msg/MarkerArray", step, markers
                else:
                    yield f"/r{robot}/map", "nav_msgs/msg/OccupancyGrid", step, self._grid(step, report)
            yield from self._radio(step)

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
        totals = self._make(
            RADIO_STEP,
            header=self._header(step),
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
        return self._make(
            RADIO_FRAME,
            header=self._header(step),
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

    def _make(self, kind: str, **fields: Any) -> Any:
        """Make a message; fields that are left out are zero or empty."""
        return self.types.types[kind](**(self._zeros(kind) | fields))

    @cache  # noqa: B019  as long as the export
    def _zeros(self, kind: str) -> dict[str, Any]:
        """Return a message's fields with value zero, or empty."""
        zeros: dict[str, Any] = {}
        for name, (node, details) in self.types.fielddefs[kind][1]:
            if node.name == "NAME":
                zeros[name] = self._make(details)
            elif node.name == "BASE":
                zeros[name] = "" if details[0] == "string" else 0
            else:
                zeros[name] = np.empty(0, np.uint8)
        return zeros

    def _header(self, step: int, frame: str = MAP_FRAME) -> Any:
        stamp = self._make("builtin_interfaces/msg/Time", sec=step)
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _point(self, x: float, y: float, kind: str = "Point") -> Any:
        return self._make(f"geometry_msgs/msg/{kind}", x=float(x), y=float(y))

    def _turn(self, yaw: float) -> Any:
        return self._make("geometry_msgs/msg/Quaternion", z=math.sin(yaw / 2), w=math.cos(yaw / 2))

    def _placed(self, x: float, y: float, yaw: float = 0.0) -> Any:
        return self._make("geometry_msgs/msg/Pose", position=self._point(x, y), orientation=self._turn(yaw))

    def _pose(self, robot: int, step: int) -> Any:
        """A robot's pose; the recorded heading is clockwise, because the world computes with y down."""
        steps = self._archive.steps
        (row,) = np.flatnonzero((steps["robot"] == robot) & (steps["step"] == step))
        return self._placed(steps["x"][row], steps["y"][row], -math.radians(steps["heading"][row]))

    def _transforms(self, step: int, poses: dict[int, Any]) -> Any:
        kind, header, transforms = "geometry_msgs/msg/TransformStamped", self._header(step), []
        for robot, pose in poses.items():
            place = self._point(pose.position.x, pose.position.y, "Vector3")
            for frame, turn in ((f"r{robot}", pose.orientation), (f"r{robot}/laser", self._turn(0.0))):
                moved = self._make("geometry_msgs/msg/Transform", translation=place, rotation=turn)
                transforms.append(self._make(kind, header=header, child_frame_id=frame, transform=moved))
        return self._make("tf2_msgs/msg/TFMessage", transforms=transforms)

    def _scan(self, step: int, scan: Rescan) -> Any:
        ray_table, world = self._lasers.ray_tables[scan.robot], self._archive.plan.map
        ranges = ranges_of(scan.readings, ray_table, world.resolution)
        turn = 2 * math.pi / ray_table.beams
        return self._make(
            "sensor_msgs/msg/LaserScan",
            header=self._header(step, f"r{scan.robot}/laser"),
            angle_max=turn * (ray_table.beams - 1),
            angle_increment=turn,
            scan_time=1.0,
            range_max=self._archive.plan.world.bodies[scan.robot].range_cells * world.resolution,
            ranges=ranges,
        )

    def _grid(self, step: int, grid: Grid) -> Any:
        world: Map = self._archive.plan.map
        info = self._make(
            "nav_msgs/msg/MapMetaData",
            resolution=world.resolution,
            width=world.width,
            height=world.height,
            origin=self._placed(*world.origin[:2]),
        )
        return self._make(
            "nav_msgs/msg/OccupancyGrid", header=self._header(step), info=info, data=occupancy(grid)
        )

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
            self._make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=alpha) for alpha in (1.0, 0.4)
        )
        points, colors = [], []
        for here, there in enumerate(following):
            points += [self._point(*places[here]), self._point(*places[there])]
            colors += 2 * [wall if rows[here, 3] & 1 else open_]
        kind: Any = self.types.types["visualization_msgs/msg/Marker"]
        marker = self._make(
            "visualization_msgs/msg/Marker",
            header=self._header(step),
            ns="approximations",
            id=outlines.map_id,
            type=kind.LINE_LIST,
            action=kind.ADD if points else kind.DELETE,
            pose=self._placed(0.0, 0.0),
            scale=self._make("geometry_msgs/msg/Vector3", x=EDGE_WIDTH_M),
            color=self._make("std_msgs/msg/ColorRGBA", a=1.0),
            points=points,
            colors=colors,
            text=f"map of robot {outlines.map_id}",
        )
        return self._make("visualization_msgs/msg/MarkerArray", markers=[marker])
