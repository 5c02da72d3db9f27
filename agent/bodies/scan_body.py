"""A ROS 2 robot with laser scans: each scan whose pose is known becomes a `Sense`."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.bodies.ros2 import BodySettings, Ros2Body
from protocol.map_frame import MapFrame
from protocol.messages import Sense
from protocol.metric_scans import BeamAngles, millimeters
from protocol.nanoseconds import SECOND
from protocol.range_scans import NO_MEASUREMENT, Laser, RangeScan, encode_range_scan
from protocol.ros2.messages import nanoseconds
from protocol.transforms import Pose, frame_name

WAITING_SCANS = 32
"""Scans that wait for the transform at their time."""
LATE_NS = SECOND
"""Time after the last scan with a known pose from which transforms count as missing; before, they may be on the way."""


class ScanBody(Ros2Body):
    """A robot with a laser; its pose is that of the laser, at the time of the newest scan."""

    silence = "no laser scan arrives any more"

    def __init__(self, grid: MapFrame, settings: BodySettings) -> None:
        super().__init__(grid, settings)
        self.problem = "no laser scan has arrived"
        self._beams: _Beams | None = None
        self._waiting: deque[tuple[int, Any]] = deque(maxlen=WAITING_SCANS)
        self._ranges: NDArray[np.uint16] | None = None
        """The ranges of the last scan with a known pose."""
        self._is_new = False

    @property
    def laser(self) -> Laser | None:
        """The laser's beams, known from the first scan with a known pose on: the laser may hang upside down."""
        if self._beams is None:
            return None
        angles = self._beams.angles
        return Laser(angles.beams, angles.first, angles.span, round(1000 * self._settings.reach_m))

    def add_scan(self, message: Any) -> None:
        """Take a message of ``scan``; one that is no scan is noted in `problem`."""
        if self._beams is None:
            try:
                _Beams.of(message, is_flipped=False)
            except ValueError as error:
                self.problem = f"laser scan: {error}"
                return
        self._waiting.append((nanoseconds(message.header.stamp), message))

    def take_newest(self) -> None:
        """Take the newest waiting scan whose pose is known and plausible; those before it are dropped."""
        for number in reversed(range(len(self._waiting))):
            stamp, message = self._waiting[number]
            pose = self._pose_of(frame_name(message.header.frame_id), stamp)
            if pose is not None:
                break
        else:
            return
        for _ in range(number + 1):
            self._waiting.popleft()
        if self._beams is None:
            frame = frame_name(message.header.frame_id)
            self._beams = _Beams.of(
                message, is_flipped=self._transforms.is_flipped(frame, self._settings.map_frame)
            )
        if self._accept(stamp, pose, "the laser"):
            self._ranges, self._is_new = self._beams.ranges(message), True

    def sense(self, step: int, *, measures: bool = True) -> Sense | None:
        """Return the newest scan since the last step, or where the robot was, without one."""
        self.take_newest()
        if self._here is None or self._ranges is None:
            return None
        ranges = self._ranges
        if not (self._is_new and measures):
            ranges = np.full_like(ranges, NO_MEASUREMENT)
        self._is_new = False
        scan = encode_range_scan(RangeScan(self._here, self._heading, ranges))
        return Sense(step, *self._cell(), b"", b"", "", *self._offsets(), scan)

    def _pose_of(self, frame: str, stamp: int) -> Pose | None:
        """Return the pose of a frame in the map frame at a time; None, and a problem, if it is not known."""
        root = self._settings.map_frame
        if root not in self._transforms.ancestors(frame):
            self._note_missing(frame, "the laser's frame")
            return None
        pose = self._transforms.pose(frame, root, stamp)
        if pose is None and (self._pose is None or stamp - self._pose[0] > LATE_NS):
            self.problem = f"the transforms (tf) from {root!r} to {frame!r} are not of the time of the scans"
        return pose


@dataclass(frozen=True)
class _Beams:
    """The beams of the first scan; later scans are read at these angles.

    Angles are counterclockwise as seen from above; those of a laser that hangs upside down run the other way.
    """

    angles: BeamAngles
    first: float
    increment: float
    sign: int
    """By which angles of messages are multiplied."""

    @classmethod
    def of(cls, message: Any, *, is_flipped: bool) -> _Beams:
        """Return the beams of a scan; ValueError if it is none."""
        sign = -1 if is_flipped else 1
        first, increment = sign * float(message.angle_min), sign * float(message.angle_increment)
        return cls(BeamAngles.of(len(message.ranges), first, increment), first, increment, sign)

    def ranges(self, message: Any) -> NDArray[np.uint16]:
        """Return the ranges of a scan in millimeters; beams that it lacks are no measurements."""
        meters = np.asarray(message.ranges, np.float64)
        first, increment = self.sign * float(message.angle_min), self.sign * float(message.angle_increment)
        here, there = (len(meters), first, increment), (self.angles.beams, self.first, self.increment)
        if not np.allclose(here, there, rtol=0, atol=1e-6):
            meters = self._nearest(meters, first, increment)
        return millimeters(
            meters, least=message.range_min, nothing=message.range_max, reverse=self.increment > 0
        )

    def _nearest(self, meters: NDArray[np.float64], first: float, increment: float) -> NDArray[np.float64]:
        """Return the ranges nearest to the angles of the first scan; not a number where there is none."""
        wanted = self.first + np.arange(self.angles.beams) * self.increment
        if not increment or not len(meters):
            return np.full(len(wanted), np.nan)
        index = np.rint((wanted - first) / increment)
        exists = (index >= 0) & (index < len(meters))
        return np.where(exists, meters[np.where(exists, index, 0).astype(np.int64)], np.nan)
