"""Transforms between the frames of a robot, in the plane: what tf2 does in ROS, without height, roll, and pitch.

A pose (x, y, yaw) of a frame in its parent is in meters and radians, counterclockwise. Between two poses, it is
interpolated. A frame may be upside down in its parent, as that of a laser that hangs below a plate: its pose is then
that of its x axis, and its y axis points to the right of it.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field
from typing import NamedTuple

LEAST_UPRIGHT = math.cos(math.radians(20))
"""Cosine of the largest angle between the vertical axes of two frames."""
STILL = 0.05
"""Meters and radians by which a frame may have moved between two poses that count as equal."""
FARTHEST_M = 1e9
"""Largest coordinate of a frame, in meters: larger ones are errors of a sender."""


class Pose(NamedTuple):
    """A pose in the plane."""

    x: float
    y: float
    yaw: float

    def inverse(self) -> Pose:
        """Return the pose of the parent in this frame."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return Pose(-cos * self.x - sin * self.y, sin * self.x - cos * self.y, -self.yaw)

    def then(self, inner: Pose) -> Pose:
        """Return the pose of a frame that has the pose `inner` in this frame."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        x = self.x + cos * inner.x - sin * inner.y
        y = self.y + sin * inner.x + cos * inner.y
        return Pose(x, y, self.yaw + inner.yaw)


def frame_name(name: str) -> str:
    """Return the name of a frame without the slash that old nodes put in front of it."""
    return name.lstrip("/")


def pose_of(x: float, y: float, q_x: float, q_y: float, q_z: float, q_w: float) -> Pose:
    """Return the pose in the plane of a frame with this position and quaternion.

    ValueError if the frame is tilted or upside down, or these are no position and rotation.
    """
    pose, is_flipped = mounting_of(x, y, q_x, q_y, q_z, q_w)
    if is_flipped:
        raise ValueError("it is upside down")
    return pose


def mounting_of(x: float, y: float, q_x: float, q_y: float, q_z: float, q_w: float) -> tuple[Pose, bool]:
    """Return the pose in the plane of a frame with this position and quaternion, and whether it is upside down.

    ValueError if the frame is tilted, or these are no position and rotation.
    """
    norm = q_x * q_x + q_y * q_y + q_z * q_z + q_w * q_w
    if not 0.5 < norm < 2:
        raise ValueError("its rotation is no unit quaternion")
    if not (abs(x) <= FARTHEST_M and abs(y) <= FARTHEST_M):
        raise ValueError(f"its position is not a number, or beyond {FARTHEST_M:g} m")
    upright = (q_w * q_w + q_z * q_z - q_x * q_x - q_y * q_y) / norm
    if abs(upright) < LEAST_UPRIGHT:
        raise ValueError("it is tilted; it must be level")
    yaw = math.atan2(2 * (q_w * q_z + q_x * q_y), q_w * q_w + q_x * q_x - q_y * q_y - q_z * q_z)
    return Pose(x, y, yaw), upright < 0


@dataclass
class _Edge:
    """The poses of a frame in its parent, by time."""

    parent: str
    is_static: bool
    is_flipped: bool
    stamps: list[float] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)


class TransformBuffer:
    """The poses of all frames in their parents; names of frames begin without a slash."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(
        self, parent: str, child: str, stamp: float, pose: Pose, *, is_static: bool, is_flipped: bool = False
    ) -> None:
        """Add the pose of a frame in its parent at a time; a frame keeps the parent that it had first.

        `is_flipped`: whether the frame is upside down there; it remains so.
        """
        edge = self._edges.setdefault(child, _Edge(parent, is_static, is_flipped))
        if edge.parent != parent or (edge.is_static and edge.poses):
            return
        at = bisect_right(edge.stamps, stamp)
        edge.stamps.insert(at, stamp)
        edge.poses.insert(at, pose)

    def forget(self, before: float) -> None:
        """Forget poses of earlier times, but keep the last of them, so that those after it can be interpolated."""
        for edge in self._edges.values():
            first = bisect_right(edge.stamps, before) - 1
            if not edge.is_static and first > 0:
                del edge.stamps[:first], edge.poses[:first]

    def forget_after(self, child: str, stamp: float) -> None:
        """Forget poses of a frame at later times, which are wrong if the clock of their sender was set back."""
        edge = self._edges.get(child)
        if edge is None or edge.is_static:
            return
        end = bisect_right(edge.stamps, stamp)
        del edge.stamps[end:], edge.poses[end:]

    @property
    def frames(self) -> list[str]:
        """All frames that have a parent, or are one."""
        return sorted({*self._edges, *(edge.parent for edge in self._edges.values())})

    def ancestors(self, frame: str) -> list[str]:
        """Return a frame, its parent, and so on up to the root."""
        found = [frame]
        while (edge := self._edges.get(found[-1])) is not None and edge.parent not in found:
            found.append(edge.parent)
        return found

    def is_fixed(self, frame: str, root: str) -> bool:
        """Return whether a frame never moves in another one."""
        line = self.ancestors(frame)
        return root in line and all(self._edges[each].is_static for each in line[: line.index(root)])

    def is_flipped(self, frame: str, root: str) -> bool:
        """Return whether a frame is upside down in one of its ancestors."""
        line = self.ancestors(frame)
        return sum(self._edges[each].is_flipped for each in line[: line.index(root)]) % 2 == 1

    def has_moved(self, frame: str, root: str) -> bool:
        """Return whether a frame, or one between it and one of its ancestors, had more than one pose."""
        line = self.ancestors(frame)
        edges = [self._edges[each] for each in line[: line.index(root)]]
        return any(_is_apart(edge.poses[0], pose) for edge in edges for pose in edge.poses)

    def times(self, frame: str, root: str) -> tuple[float, float]:
        """Return the first and the last time at which the pose of a frame in one of its ancestors may be known."""
        line = self.ancestors(frame)
        edges = [self._edges[each] for each in line[: line.index(root)]]
        moving = [edge.stamps for edge in edges if not edge.is_static]
        return max((each[0] for each in moving), default=-math.inf), min(
            (each[-1] for each in moving), default=math.inf
        )

    def newest(self, frame: str, root: str) -> float | None:
        """Return the newest time at which the pose of a frame in one of its ancestors may be known.

        None if the frame is fixed there, or the pose of a frame between them is unknown.
        """
        line = self.ancestors(frame)
        edges = [self._edges[each] for each in line[: line.index(root)]]
        return min((edge.stamps[-1] for edge in edges if not edge.is_static), default=None)

    def pose(self, frame: str, root: str, stamp: float, *, longest_gap: float = math.inf) -> Pose | None:
        """Return the pose of a frame in one of its ancestors at a time; None if it was not known before and after.

        Also None if a frame moved between two poses that are more than `longest_gap` apart in time.
        """
        found = Pose(0.0, 0.0, 0.0)
        line = self.ancestors(frame)
        for each in line[: line.index(root)]:
            edge = self._edges[each]
            outer = self._at(edge, stamp, longest_gap)
            if outer is None:
                return None
            found = outer.then(Pose(found.x, -found.y, -found.yaw) if edge.is_flipped else found)
        return found

    def _at(self, edge: _Edge, stamp: float, longest_gap: float) -> Pose | None:
        """Interpolate a pose."""
        if edge.is_static:
            return edge.poses[0]
        after = bisect_left(edge.stamps, stamp)
        if after == len(edge.stamps):
            return None
        if edge.stamps[after] == stamp:
            return edge.poses[after]
        if after == 0:
            return None
        before, later = edge.poses[after - 1], edge.poses[after]
        gap = edge.stamps[after] - edge.stamps[after - 1]
        if gap > longest_gap and _is_apart(before, later):
            return None
        share = (stamp - edge.stamps[after - 1]) / gap
        turn = math.remainder(later.yaw - before.yaw, 2 * math.pi)
        return Pose(
            before.x + share * (later.x - before.x),
            before.y + share * (later.y - before.y),
            before.yaw + share * turn,
        )


def _is_apart(one: Pose, other: Pose) -> bool:
    turn = math.remainder(other.yaw - one.yaw, 2 * math.pi)
    return math.dist(one[:2], other[:2]) > STILL or abs(turn) > STILL
