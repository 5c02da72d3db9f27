"""A ROS 2 robot with laser scans: each scan whose pose is known becomes a `Sense`."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.bodies.ros2 import BodySettings, Ros2Body
from protocol.map_frame import MapFrame
from protocol.messages import Sense
from protocol.metric_scans import MetricScan
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
        self._first: MetricScan | None = None
        """The first scan with a known pose; later scans are read at its angles."""
        self._waiting: deque[tuple[int, Any]] = deque(maxlen=WAITING_SCANS)
        self._ranges: NDArray[np.uint16] | None = None
        """The ranges of the last scan with a known pose."""
        self._is_new = False

    @property
    def laser(self) -> Laser | None:
        """The laser's beams, known from the first scan with a known pose on: the laser may hang upside down."""
        if self._first is None:
            return None
        angles = self._first.angles
        return Laser(angles.beams, angles.first, angles.span, round(1000 * self._settings.reach_m))

    def add_scan(self, message: Any) -> None:
        """Take a message of ``scan``; one that is no scan is noted in `problem`."""
        if self._first is None:
            try:
                MetricScan.of_message(message, is_flipped=False).angles  # noqa: B018  checks them
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
        frame = frame_name(message.header.frame_id)
        is_flipped = self._transforms.is_flipped(frame, self._settings.map_frame)
        scan = MetricScan.of_message(message, is_flipped=is_flipped)
        self._first = self._first or scan
        if self._accept(stamp, pose, "the laser"):
            self._ranges, self._is_new = scan.at_angles_of(self._first).millimeters(), True

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
