"""The messages of an exported run (`deploy.after.export`): poses, scans, maps, outlines, and radio traffic."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from agent.bodies.team_map import occupancy_grid
from deploy.after.archive import Archive, Table
from deploy.after.recast_scans import Lasers, Rescan
from deploy.dashboard.shapes import outline_strips
from deploy.record.colors import GROUPS, robot_color
from netshaper.ledger import FRAMES
from protocol.grid import Grid, RayTable
from protocol.messages import Outlines
from protocol.nanoseconds import SECOND
from protocol.ros2.interfaces import fields_of
from protocol.ros2.messages import LASER_SCAN, MARKERS, ODOMETRY, POINT, Messages
from protocol.scans import HIT, NONE, Readings
from protocol.transforms import Pose

EDGE_WIDTH_M = 0.05
MAP_FRAME = "map"
"""The frame of the map file: meters, y up."""
HERE = Pose(0.0, 0.0, 0.0)
MARKER, COLOR = "visualization_msgs/msg/Marker", "std_msgs/msg/ColorRGBA"

_BY_TYPE = "".join(f"# {group.label}\nuint32 {name}\n" for name, group in GROUPS.items())
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
    RADIO_STEP: f"""\
# Traffic of one step, in bytes.
std_msgs/Header header
# The limit; NaN: unlimited.
float64 budget
uint32 frames
uint32 carried
# Bytes over the budget.
uint32 waiting
{_BY_TYPE}""",
}
"""Definitions of the messages of Murmur, in the format of ROS."""

Stamped = tuple[str, int, Any]
"""Topic, step, message."""


def ranges_of(readings: Readings, ray_table: RayTable, resolution: float) -> Any:
    """Return a scan's readings in ROS' convention: meters, counterclockwise from +x (y up).

    A beam that hit no wall is infinite; a beam that was not sent is NaN. A wall lies at the center of its cell.
    """
    crossed = (readings & NONE).astype(np.int64)
    at = np.minimum(ray_table.start[:-1] + crossed, len(ray_table.cells) - 1)
    meters = resolution * np.hypot(ray_table.cells[at, 0], ray_table.cells[at, 1])
    meters = np.where(readings & HIT, meters, np.inf)
    meters[readings == NONE] = np.nan
    return np.roll(meters[::-1], 1).astype(np.float32)


class BagMessages:
    """All messages of a run, in chronological order."""

    def __init__(self, archive: Archive) -> None:
        self.ros = Messages("humble")
        self.ros.register({name: fields_of(text) for name, text in DEFINITIONS.items()})
        self._archive = archive
        self._lasers = Lasers(archive)
        self._tracks = {robot: archive.of_robot(robot) for robot in range(archive.plan.scenario.robots)}
        self._poses = {robot: _poses(track) for robot, track in self._tracks.items()}
        """The poses of each robot by step."""
        self._goals: dict[int, tuple[float, float]] = {}
        """The last goal of each robot."""

    def all(self) -> Iterator[Stamped]:
        """Yield them one by one."""
        yield "/truth", 0, self._grid(0, self._archive.plan.map.cells)
        yield "/tf_static", 0, self.ros.transforms(self._static_frames(), 0)
        maps = self._map_reports()
        for step, scans in self._lasers.scans():
            robots = [scan.robot for scan in scans]
            moved = [(f"r{robot}/odom", f"r{robot}/base_link", self._moved(robot, step)) for robot in robots]
            yield "/tf", step, self.ros.transforms(moved, step * SECOND)
            for scan in scans:
                yield from self._robot(step, scan)
            for robot, report in maps.get(step, []):
                if isinstance(report, Outlines):
                    yield f"/r{robot}/polygons", step, self._markers(step, report)
                else:
                    yield f"/r{robot}/map", step, self._grid(step, report)
            yield from self._radio(step)

    def _robot(self, step: int, scan: Rescan) -> Iterator[Stamped]:
        """The pose, motion, new goal, and scan of a robot in a step."""
        robot, name = scan.robot, f"/r{scan.robot}"
        yield f"{name}/pose", step, self.ros.stamped(MAP_FRAME, self._poses[robot][step], step * SECOND)
        yield f"{name}/odom", step, self._odometry(step, robot)
        track = self._tracks[robot]
        (row,) = np.flatnonzero(track["step"] == step)
        goal = float(track["target_x"][row]), float(track["target_y"][row])
        if not math.isnan(goal[0]) and goal != self._goals.get(robot):
            self._goals[robot] = goal
            yield f"{name}/goal_pose", step, self.ros.stamped(MAP_FRAME, Pose(*goal, 0.0), step * SECOND)
        yield f"{name}/scan", step, self._scan(step, scan)

    def _static_frames(self) -> Iterator[tuple[str, str, Pose]]:
        """Yield each frame that does not move: its parent, its name, and its pose there."""
        for robot, poses in self._poses.items():
            if poses:
                yield MAP_FRAME, f"r{robot}/odom", next(iter(poses.values()))
                yield f"r{robot}/base_link", f"r{robot}/laser", HERE

    def _moved(self, robot: int, step: int) -> Pose:
        """A robot's pose in the frame that lies at its first one."""
        poses = self._poses[robot]
        return next(iter(poses.values())).inverse().then(poses[step])

    def _odometry(self, step: int, robot: int) -> Any:
        """A robot's motion since the start, and its velocity in its own frame, from the motion in this step."""
        before, now = self._poses[robot].get(step - 1), self._poses[robot][step]
        speed = before.inverse().then(now) if before is not None else HERE
        message = self.ros.new(
            ODOMETRY,
            header=self.ros.header(f"r{robot}/odom", step * SECOND),
            child_frame_id=f"r{robot}/base_link",
        )
        message.pose.pose = self.ros.pose(*self._moved(robot, step))
        message.twist.twist.linear.x, message.twist.twist.linear.y = speed.x, speed.y
        message.twist.twist.angular.z = math.remainder(speed.yaw, 2 * math.pi)
        return message

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
            yield "/radio/frames", step, frame
        carried = here["carried"].astype(bool)
        sums = {
            name: int(here["bytes"][carried & np.isin(here["kind"], group.kinds)].sum())
            for name, group in GROUPS.items()
        }
        budget = float(self._archive.budgets[step])
        totals = self.ros.new(
            RADIO_STEP,
            header=self.ros.header(MAP_FRAME, step * SECOND),
            budget=budget if math.isfinite(budget) else math.nan,
            frames=len(frames),
            carried=int(here["bytes"][carried].sum()),
            waiting=int(here["bytes"][here["cause"] == "budget"].sum()),
            **sums,
        )
        yield "/radio/steps", step, totals

    def _frame(self, step: int, key: dict[str, int], here: Table, rows: list[int]) -> Any:
        """One frame: the rows of the ledger that differ only in packet kind, or in whether the packets were carried."""
        carried, sizes = here["carried"][rows].astype(bool), here["bytes"][rows]
        kinds = here["kind"][rows]
        unique = list(dict.fromkeys(kinds.tolist()))
        return self.ros.new(
            RADIO_FRAME,
            header=self.ros.header(MAP_FRAME, step * SECOND),
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
        return self.ros.new(
            LASER_SCAN,
            header=self.ros.header(f"r{scan.robot}/laser", step * SECOND),
            angle_min=angle_min,
            angle_max=angle_min + turn * (ray_table.beams - 1),
            angle_increment=turn,
            scan_time=1.0,
            range_max=self._archive.plan.world.bodies[scan.robot].range_cells * world.resolution,
            ranges=np.roll(ranges, -first),
        )

    def _grid(self, step: int, grid: Grid) -> Any:
        where = self._archive.plan.map.frame
        return occupancy_grid(self.ros, grid, where, HERE, MAP_FRAME, step * SECOND)

    def _markers(self, step: int, outlines: Outlines) -> Any:
        """One marker per map: its edges, walls in full color, edges to unknown cells in a pale one."""
        strips = outline_strips(self._archive.plan.map, outlines.vertices)
        edges = [edge for strip in strips for edge in pairwise((strip * (1, -1)).tolist())]
        walls = np.frombuffer(outlines.vertices, "<i2").reshape(-1, 4)[:, 3] & 1
        red, green, blue = (part / 255 for part in robot_color(outlines.map_id))
        wall, open_ = (self.ros[COLOR](r=red, g=green, b=blue, a=alpha) for alpha in (1.0, 0.4))
        points = [self.ros[POINT](x=x, y=y, z=0.0) for edge in edges for x, y in edge]
        colors = [wall if is_wall else open_ for is_wall in walls for _ in range(2)]
        kind = self.ros[MARKER]
        marker = self.ros.new(
            MARKER,
            header=self.ros.header(MAP_FRAME, step * SECOND),
            ns="approximations",
            id=outlines.map_id,
            type=kind.LINE_LIST,
            action=kind.ADD if points else kind.DELETE,
            pose=self.ros.pose(*HERE),
            scale=self.ros.new("geometry_msgs/msg/Vector3", x=EDGE_WIDTH_M),
            color=self.ros.new(COLOR, a=1.0),
            points=points,
            colors=colors,
            text=f"map of robot {outlines.map_id}",
        )
        return self.ros[MARKERS](markers=[marker])


def _poses(track: Table) -> dict[int, Pose]:
    """Return a robot's poses by step; recorded headings are clockwise, because the world computes with y down."""
    columns = (track[name].tolist() for name in ("step", "x", "y", "heading"))
    return {step: Pose(x, y, -math.radians(heading)) for step, x, y, heading in zip(*columns, strict=True)}
