"""A ROS 2 robot as a body: what it measures becomes `Sense`, a `Move` becomes a goal.

Messages go in and come out; the classes have no socket and no clock. Poses come from tf: from the frame of the laser or
of the robot's base to the robot's map frame, which its SLAM keeps. `map_pose` places that frame in the frame of the
team; with SLAM that begins where the robot stands, it is the robot's start pose.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from agent.bodies.own_map import OwnMap
from agent.pose_guard import JUMP_M, PoseGuard
from protocol.cell_bytes import cells_from_bytes, points_from_bytes
from protocol.grid import FINE, Cell
from protocol.map_frame import MapFrame
from protocol.messages import Move, Sense
from protocol.nanoseconds import SECOND
from protocol.range_scans import UNIT, Laser, cell_offset, nearest_heading
from protocol.ros2.messages import nanoseconds
from protocol.transforms import Pose, TransformBuffer, frame_name, mounting_of

REMEMBERED_NS = 10 * SECOND
"""Age up to which transforms are kept, relative to the last known pose."""
UNUSED_NS = 60 * SECOND
"""Age up to which transforms are kept while no pose is known, relative to the last transform."""
BACK_NS = 10 * SECOND
"""Time by which the stamps of a frame's transforms must go back to show that the clock was set back."""


@dataclass(frozen=True)
class BodySettings:
    """What the body must know of its robot.

    `map_pose`: the robot's map frame in the frame of the team, in meters and radians. `reach_m`: range up to which
    the robot maps. `speed`: the robot's largest speed, in meters per second.
    """

    map_pose: Pose
    reach_m: float = 10.0
    speed: float = 1.0
    map_frame: str = "map"
    base_frame: str = "base_link"


class Ros2Body(ABC):
    """One robot; `grid` is where the team's grid lies in the frame of the team."""

    silence: ClassVar[str]
    """What to say if nothing new arrives any more."""
    problem: str
    """Why there is no new pose; empty if there is one."""

    def __init__(self, grid: MapFrame, settings: BodySettings) -> None:
        self._grid = grid
        self._settings = settings
        self._transforms = TransformBuffer()
        self._refused: dict[str, str] = {}
        self._pose: tuple[int, Pose] | None = None
        """Time and pose of the sensor, the laser or the base, in the map frame of the robot."""
        self._here: tuple[int, int] | None = None
        """The sensor's last plausible position in the team's grid, in 1 / `UNIT` cell."""
        self._heading = 0
        """Its heading there, in 1 / `TURN`."""
        self._guard = PoseGuard(settings.speed, JUMP_M)
        self._map: OwnMap | None = None

    @property
    def stamp_ns(self) -> int | None:
        """Time of the last known pose, by the robot's clock; None before the first."""
        return None if self._pose is None else self._pose[0]

    @property
    def has_jumped(self) -> bool:
        """Whether the pose has jumped, and has not settled since."""
        return self._guard.has_jumped

    @property
    def has_map(self) -> bool:
        """Whether the robot's own map has arrived."""
        return self._map is not None

    @property
    @abstractmethod
    def laser(self) -> Laser | None:
        """The beams of the robot's laser (`agent.settings.Settings.laser`); None until the robot can begin."""

    @abstractmethod
    def take_newest(self) -> None:
        """Take the newest known and plausible pose, and what was measured there.

        `sense` does so, too; between steps, it shows early whether messages still arrive (`stamp_ns`).
        """

    @abstractmethod
    def sense(self, step: int, *, measures: bool = True) -> Sense | None:
        """Return what the robot senses in a step; None before the first known pose.

        Without `measures`, only the pose counts.
        """

    def base(self, frame: str) -> Pose | None:
        """Return the pose of the robot's base, called `frame`, in its map frame at the time of the last pose.

        That of the sensor if the base is not on the way to it; None before the first pose.
        """
        if self._pose is None:
            return None
        stamp, sensor = self._pose
        root = self._settings.map_frame
        known = root in self._transforms.ancestors(frame)
        return (self._transforms.pose(frame, root, stamp) if known else None) or sensor

    def add_transforms(self, message: Any, *, is_static: bool) -> None:
        """Take a message of ``tf`` or ``tf_static``."""
        for each in message.transforms:
            parent, child = frame_name(each.header.frame_id), frame_name(each.child_frame_id)
            place, turn = each.transform.translation, each.transform.rotation
            try:
                pose, is_flipped = mounting_of(place.x, place.y, turn.x, turn.y, turn.z, turn.w)
            except ValueError as error:
                self._refused[child] = str(error)
                continue
            stamp = nanoseconds(each.header.stamp)
            self._transforms.forget_after(child, stamp + BACK_NS)
            self._transforms.add(parent, child, stamp, pose, is_static=is_static, is_flipped=is_flipped)
            if not is_static:
                self._transforms.forget(stamp - UNUSED_NS)

    def add_map(self, message: Any) -> None:
        """Limit goals to the known cells of the robot's own map; `problem` names what is wrong with a malformed map."""
        try:
            self._map = OwnMap(message)
        except ValueError as error:
            self.problem = f"map: {error}"

    def goal(self, move: Move, target: Cell | None = None) -> Pose | None:
        """Return where a robot is to drive, in its map frame; None if it stays.

        That is its target, to which it finds its own way, or else the end of the move. If the robot's map does not know
        this cell, it is the last cell of the move that it knows.
        """
        way = self._way(move)
        if target is not None and len(way):
            way = np.concatenate([way, np.array([target]) + 0.5])
        if self._here is None or not len(way):
            return None
        here = np.array([self._here], np.float64) / UNIT
        points = np.array([self._grid.position(column, row) for column, row in np.concatenate([here, way])])
        steps = np.diff(points, axis=0)
        to_map = self._settings.map_pose.inverse()
        for point, step in zip(points[:0:-1].tolist(), steps[::-1].tolist(), strict=True):
            pose = to_map.then(Pose(point[0], point[1], math.atan2(step[1], step[0])))
            if self._map is None or self._map.is_known(pose):
                return pose
        return None

    def _way(self, move: Move) -> NDArray[np.float64]:
        """Return the points of a move in cells, from the corner of the grid: float64 of shape (n, 2)."""
        if move.points:
            return points_from_bytes(move.points).astype(np.float64) / FINE + 0.5
        return cells_from_bytes(move.path).astype(np.float64) + 0.5

    def _cell(self) -> tuple[int, int, int]:
        """Return cell and heading of the sensor as `Sense` has them."""
        assert self._here is not None
        x, y = self._here
        return x // UNIT, y // UNIT, nearest_heading(self._heading)

    def _offsets(self) -> tuple[int, int]:
        """Return the position of the sensor within its cell as `Sense` has it."""
        assert self._here is not None
        x, y = self._here
        return cell_offset(x), cell_offset(y)

    def _accept(self, stamp: int, pose: Pose, what: str) -> bool:
        """Take a new pose of the sensor, called `what`; return whether it is plausible, and lies on the grid."""
        self._transforms.forget(stamp - REMEMBERED_NS)
        self._pose = stamp, pose
        if not self._guard.accept(pose.x, pose.y, stamp):
            self.problem = "the pose has jumped; waiting until it settles"
            return False
        team_pose = self._settings.map_pose.then(pose)
        place = self._grid.place(team_pose)
        if not self._grid.has(place):
            where = f"({team_pose.x:.2f}, {team_pose.y:.2f}) m"
            self.problem = f"{what} is at {where} in the frame of the team, outside the grid"
            return False
        self._here, self._heading, self.problem = place, self._grid.heading(team_pose), ""
        return True

    def _note_missing(self, frame: str, what: str) -> None:
        """Note that a frame, called `what`, is not connected to the map frame."""
        line = self._transforms.ancestors(frame)
        known = " -> ".join(reversed(line))
        root, top = self._settings.map_frame, line[-1]
        self.problem = f"no transforms (tf) from {root!r} to {what} {frame!r}; only {known}"
        if top in self._refused:
            self.problem = f"frame {top!r}: {self._refused[top]}"
