"""A ROS 2 robot as a body: laser scans and transforms become `Sense`, a `Move` becomes a goal.

Messages go in and come out; the class has no socket and no clock. Poses come from tf: from the laser's frame to the
robot's map frame, which its SLAM keeps. `map_pose` places that frame in the frame of the team; with SLAM that begins
where the robot stands, it is the robot's start pose.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.map_frame import MapFrame
from protocol.messages import Move, Sense, cells_from_bytes, points_from_bytes
from protocol.metric_scans import BeamAngles, millimeters
from protocol.range_scans import NO_MEASUREMENT, TURN, UNIT, Laser, RangeScan, encode_range_scan
from protocol.ros2.messages import nanoseconds
from protocol.transforms import FARTHEST_M, Pose, TransformBuffer, pose_of

HEADINGS = 8
FINE = 1000
"""Units of `Sense.offset_x` and of way points, in a cell."""
WAITING_SCANS = 32
"""Scans that wait for the transform at their time."""
REMEMBERED_NS = 10 * 10**9
"""Age up to which transforms are kept, relative to the last scan with a known pose."""
UNUSED_NS = 60 * 10**9
"""Age up to which transforms are kept while no scan has a known pose, relative to the last transform."""
SETTLE_NS = 2 * 10**9
"""Time for which poses must be plausible again after a jump."""
JUMP_M = 0.5
"""Distance that a pose may jump: SLAM corrects it."""


@dataclass(frozen=True)
class BodySettings:
    """What the body must know of its robot.

    `map_pose`: the robot's map frame in the frame of the team, in meters and radians. `reach_m`: range up to which
    scans are mapped. `speed`: the robot's largest speed, in meters per second.
    """

    map_pose: Pose
    reach_m: float = 10.0
    speed: float = 1.0
    map_frame: str = "map"


class Ros2Body:
    """One robot; `grid` is where the team's grid lies in the frame of the team."""

    def __init__(self, grid: MapFrame, settings: BodySettings) -> None:
        self._grid = grid
        self._settings = settings
        self._transforms = TransformBuffer()
        self._refused: dict[str, str] = {}
        self._beams: _Beams | None = None
        self._waiting: deque[tuple[int, Any]] = deque(maxlen=WAITING_SCANS)
        self._scan: RangeScan | None = None
        """The last scan with a known pose."""
        self._is_new = False
        self._pose: tuple[int, Pose] | None = None
        """Time and pose of the last scan in the map frame of the robot."""
        self._settled_ns = 0
        """Time from which poses are used again after a jump."""
        self._map: Any = None
        self.problem = "no laser scan has arrived"
        """Why there is no new scan; empty if there is one."""

    @property
    def stamp_ns(self) -> int | None:
        """Time of the last scan whose pose is known, by the robot's clock; None before the first."""
        return None if self._pose is None else self._pose[0]

    @property
    def has_jumped(self) -> bool:
        """Whether the pose has jumped, and has not settled since."""
        return self._pose is not None and self._pose[0] < self._settled_ns

    @property
    def has_map(self) -> bool:
        """Whether the robot's own map has arrived."""
        return self._map is not None

    def base(self, frame: str) -> Pose | None:
        """Return the pose of the robot's base, called `frame`, in its map frame at the last scan.

        That of the laser if the base is not on the way to it; None before the first scan.
        """
        if self._pose is None:
            return None
        stamp, laser = self._pose
        root = self._settings.map_frame
        known = root in self._transforms.ancestors(frame)
        return (self._transforms.pose(frame, root, stamp) if known else None) or laser

    @property
    def laser(self) -> Laser | None:
        """The laser's beams (`agent.settings.Settings.laser`), known from the first scan on."""
        if self._beams is None:
            return None
        angles = self._beams.angles
        return Laser(angles.beams, angles.first, angles.span, round(1000 * self._settings.reach_m))

    def add_transforms(self, message: Any, *, is_static: bool) -> None:
        """Take a message of ``tf`` or ``tf_static``."""
        for each in message.transforms:
            parent, child = _frame(each.header.frame_id), _frame(each.child_frame_id)
            place, turn = each.transform.translation, each.transform.rotation
            try:
                pose = pose_of(place.x, place.y, turn.x, turn.y, turn.z, turn.w)
            except ValueError as error:
                self._refused[child] = str(error)
                continue
            stamp = nanoseconds(each.header.stamp)
            self._transforms.add(parent, child, stamp, pose, is_static=is_static)
            if not is_static:
                self._transforms.forget(stamp - UNUSED_NS)

    def add_scan(self, message: Any) -> None:
        """Take a message of ``scan``; one that is no scan is noted in `problem`."""
        if self._beams is None:
            try:
                self._beams = _Beams.of(message)
            except ValueError as error:
                self.problem = f"laser scan: {error}"
                return
        self._waiting.append((nanoseconds(message.header.stamp), message))

    def add_map(self, message: Any) -> None:
        """Limit goals to the known cells of the robot's own map; `problem` names what is wrong with a malformed map."""
        info = message.info
        origin = info.origin
        angles = origin.orientation.z, origin.orientation.w
        corner = origin.position.x, origin.position.y
        if not (all(map(math.isfinite, angles)) and all(abs(each) <= FARTHEST_M for each in corner)):
            self.problem = "map: its origin is not a pose"
        elif not 1e-3 <= info.resolution <= 1e3:
            self.problem = f"map: its resolution is {info.resolution:g} m"
        elif len(message.data) != info.width * info.height:
            self.problem = f"map: {len(message.data)} cells instead of {info.width} x {info.height}"
        else:
            self._map = message

    def sense(self, step: int, *, measures: bool = True) -> Sense | None:
        """Return what the robot senses in a step: its newest scan since the last step, or where it was, without one.

        None before the first scan whose pose is known. Without `measures`, only the pose of the scan counts.
        """
        self.take_newest_scan()
        if self._scan is None:
            return None
        scan = self._scan
        if not (self._is_new and measures):
            nothing = np.full_like(scan.ranges, NO_MEASUREMENT)
            scan = RangeScan(scan.place, scan.heading, nothing)
        self._is_new = False
        heading = round(scan.heading * HEADINGS / TURN) % HEADINGS
        offset = _offset(scan.place[0]), _offset(scan.place[1])
        return Sense(step, scan.x, scan.y, heading, b"", b"", "", *offset, encode_range_scan(scan))

    def goal(self, move: Move, target: tuple[int, int] | None = None) -> Pose | None:
        """Return where a robot is to drive, in its map frame; None if it stays.

        That is its target, to which it finds its own way, or else the end of the move. If the robot's map does not know
        this cell, it is the last cell of the move that it knows.
        """
        way = self._way(move)
        if target is not None and len(way):
            way = np.concatenate([way, np.array([target]) + 0.5])
        if self._scan is None or not len(way):
            return None
        here = np.array([self._scan.place], np.float64) / UNIT
        points = np.array([self._grid.position(column, row) for column, row in np.concatenate([here, way])])
        steps = np.diff(points, axis=0)
        to_map = self._settings.map_pose.inverse()
        for point, step in zip(points[:0:-1].tolist(), steps[::-1].tolist(), strict=True):
            pose = to_map.then(Pose(point[0], point[1], math.atan2(step[1], step[0])))
            if self._is_known(pose):
                return pose
        return None

    def _way(self, move: Move) -> NDArray[np.float64]:
        """Return the points of a move in cells, from the corner of the grid: float64 of shape (n, 2)."""
        if move.points:
            return points_from_bytes(move.points).astype(np.float64) / FINE + 0.5
        return cells_from_bytes(move.path).astype(np.float64) + 0.5

    def _is_known(self, pose: Pose) -> bool:
        """Return whether the cell of a pose is known on the robot's map; without a map, every cell counts as known."""
        if self._map is None:
            return True
        info = self._map.info
        origin = info.origin
        corner = Pose(
            origin.position.x, origin.position.y, 2 * math.atan2(origin.orientation.z, origin.orientation.w)
        )
        inner = corner.inverse().then(pose)
        column, row = math.floor(inner.x / info.resolution), math.floor(inner.y / info.resolution)
        if not (0 <= column < info.width and 0 <= row < info.height):
            return False
        return bool(self._map.data[row * info.width + column] >= 0)

    def take_newest_scan(self) -> None:
        """Take the newest waiting scan whose pose is known and plausible; those before it are dropped.

        `sense` does so, too; between steps, it shows early whether scans still arrive (`stamp_ns`).
        """
        for number in reversed(range(len(self._waiting))):
            stamp, message = self._waiting[number]
            pose = self._pose_of(_frame(message.header.frame_id), stamp)
            if pose is not None:
                break
        else:
            return
        for _ in range(number + 1):
            self._waiting.popleft()
        self._transforms.forget(stamp - REMEMBERED_NS)
        if not self._is_plausible(stamp, pose):
            return
        team_pose = self._settings.map_pose.then(pose)
        place = self._grid.place(team_pose)
        if not self._grid.has(place):
            where = f"({team_pose.x:.2f}, {team_pose.y:.2f}) m"
            self.problem = f"the laser is at {where} in the frame of the team, outside the grid"
            return
        assert self._beams is not None
        self._scan = RangeScan(place, self._grid.heading(team_pose), self._beams.ranges(message))
        self._is_new, self.problem = True, ""

    def _pose_of(self, frame: str, stamp: int) -> Pose | None:
        """Return the pose of a frame in the map frame at a time; None, and a problem, if it is not known."""
        root, line = self._settings.map_frame, self._transforms.ancestors(frame)
        if root not in line:
            top = line[-1]
            known = " -> ".join(reversed(line))
            self.problem = f"no transforms (tf) from {root!r} to the laser's frame {frame!r}; only {known}"
            if top in self._refused:
                self.problem = f"frame {top!r}: {self._refused[top]}"
            return None
        pose = self._transforms.pose(frame, root, stamp)
        if pose is None:
            self.problem = f"the transforms (tf) from {root!r} to {frame!r} are not of the time of the scans"
        return pose

    def _is_plausible(self, stamp: int, pose: Pose) -> bool:
        """Return whether a pose is plausible: neither it nor one of the last `SETTLE_NS` has jumped."""
        before, self._pose = self._pose, (stamp, pose)
        if before is not None:
            elapsed_s = max(0, stamp - before[0]) / 10**9
            jump = math.dist(before[1][:2], pose[:2])
            if jump > self._settings.speed * elapsed_s + JUMP_M:
                self._settled_ns = stamp + SETTLE_NS
        if stamp < self._settled_ns:
            self.problem = "the pose has jumped; waiting until it settles"
            return False
        return True


@dataclass(frozen=True)
class _Beams:
    """The beams of the first scan; later scans are read at these angles."""

    angles: BeamAngles
    first: float
    increment: float

    @classmethod
    def of(cls, message: Any) -> _Beams:
        """Return the beams of a scan; ValueError if it is none."""
        first, increment = float(message.angle_min), float(message.angle_increment)
        return cls(BeamAngles.of(len(message.ranges), first, increment), first, increment)

    def ranges(self, message: Any) -> NDArray[np.uint16]:
        """Return the ranges of a scan in millimeters; beams that it lacks are no measurements."""
        meters = np.asarray(message.ranges, np.float64)
        first, increment = float(message.angle_min), float(message.angle_increment)
        here, there = (len(meters), first, increment), (self.angles.beams, self.first, self.increment)
        if not np.allclose(here, there, rtol=0, atol=1e-6):
            meters = self._nearest(meters, first, increment)
        nothing = float(message.range_max) if message.range_max > 0 else math.inf
        return millimeters(
            meters, least=float(message.range_min), nothing=nothing, reverse=self.increment > 0
        )

    def _nearest(self, meters: NDArray[np.float64], first: float, increment: float) -> NDArray[np.float64]:
        """Return the ranges nearest to the angles of the first scan; not a number where there is none."""
        wanted = self.first + np.arange(self.angles.beams) * self.increment
        if not increment or not len(meters):
            return np.full(len(wanted), np.nan)
        index = np.rint((wanted - first) / increment)
        exists = (index >= 0) & (index < len(meters))
        return np.where(exists, meters[np.where(exists, index, 0).astype(np.int64)], np.nan)


def _frame(name: str) -> str:
    return name.lstrip("/")


def _offset(units: int) -> int:
    """Return a position as thousandths of a cell from the center of its cell."""
    return (units % UNIT * FINE + FINE // 2) // UNIT - FINE // 2
