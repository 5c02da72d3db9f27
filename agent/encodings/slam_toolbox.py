"""The `slam-toolbox` encoding: what teams send that run the ROS package slam_toolbox (a baseline).

With its multi-robot version, a robot publishes each scan that its own SLAM takes in: the first one, and one whenever
it has moved or turned by `TRAVEL_M` or `TURN_RAD` since the last. The log holds the message LocalizedLaserScan in the
layout in which ROS 2 sends it (CDR, little-endian): a LaserScan without intensities, the pose of the laser on the
robot, and the robot's pose with its covariance. Names of coordinate frames have a fixed length.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from agent.encodings.scans import RangeScans, ScanEncoding
from agent.settings import Settings
from protocol.errors import ProtocolError
from protocol.range_scans import MAX_COORDINATE, NO_MEASUREMENT, NOTHING, TURN, UNIT, RangeScan
from protocol.scans import Scan

TRAVEL_M, TURN_RAD = 0.5, 0.5
"""The defaults of minimum_travel_distance and minimum_travel_heading."""

CDR = b"\0\1\0\0"
"""The first bytes of a message: CDR, little-endian."""

FULL_TURN = 2 * math.pi

_FIELDS = (
    ("scan.stamp", "(2,)<u4"), ("scan.frame.size", "<u4"), ("scan.frame", "S11"), ("limits", "(7,)<f4"),
    ("beams", "<u4"), ("ranges", "({beams},)<f4"), ("intensities", "<u4"),
    ("offset.stamp", "(2,)<u4"), ("offset.frame.size", "<u4"), ("offset.frame", "S10"),
    ("offset.child.size", "<u4"), ("offset.child", "S11"), ("offset", "(7,)<f8"),
    ("pose.stamp", "(2,)<u4"), ("pose.frame.size", "<u4"), ("pose.frame", "S4"), ("pose", "(7,)<f8"),
    ("covariance", "(36,)<f8"),
)  # fmt: skip
"""Fields of LocalizedLaserScan. A pose is x, y, z, and a quaternion x, y, z, w; a text ends with a zero byte."""


@lru_cache(maxsize=16)
def message_layout(beams: int) -> np.dtype[np.void]:
    """Return the layout of the message behind `CDR`: each number is aligned to its size."""
    formats = [np.dtype(kind.format(beams=beams)) for _, kind in _FIELDS]
    offsets, end = [], 0
    for each in formats:
        size = 1 if each.kind == "S" else each.base.itemsize
        offsets.append(-(-end // size) * size)
        end = offsets[-1] + each.itemsize
    names = [name for name, _ in _FIELDS]
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": end})


class SlamToolboxEncoding(ScanEncoding):
    """Encodes some of the scans, as messages of slam_toolbox; teammates estimate the author's map from them."""

    name = "slam-toolbox"
    needs_range_scans = True

    def make_format(self, settings: Settings) -> LocalizedScans:
        """Return the format of the scans; ValueError for exact lasers."""
        if settings.laser is None:
            raise ValueError(f"map_encoding = {self.name!r}: needs lasers or poses with errors")
        return LocalizedScans(settings)


class LocalizedScans(RangeScans):
    """Messages LocalizedLaserScan."""

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._cell_m = settings.resolution
        self._message = self._template()
        self._last: RangeScan | None = None
        """The last scan that was sent."""
        self._step = 0

    def size(self, map_id: int) -> int:
        """Return the bytes of a message of a map."""
        return len(CDR) + message_layout(self.laser_of(map_id).beams).itemsize

    def _template(self) -> NDArray[np.void]:
        """Return a message with the fields that all scans of this robot share."""
        robot, laser = self.settings.robot, self.laser_of(self.settings.own_map)
        message = np.zeros(1, message_layout(laser.beams))
        frame, base = f"r{robot:03}/laser", f"r{robot:03}/base"
        texts = {"scan.frame": frame, "offset.frame": base, "offset.child": frame, "pose.frame": "map"}
        for name, text in texts.items():
            message[name], message[f"{name}.size"] = text.encode(), len(text) + 1
        first, span = FULL_TURN * laser.first / TURN, FULL_TURN * laser.span / TURN
        message["limits"] = first, first + span, laser.spacing_rad, 0.0, 0.0, 0.0, laser.reach_mm / 1000
        message["beams"] = laser.beams
        message["offset"][:, 6] = 1.0
        message["covariance"][:, [0, 7, 35]] = 1.0
        return message

    def encode(self, scan: Scan | RangeScan) -> bytes:
        """Encode a scan; nothing if the robot has hardly moved since the last one, or the scan has no readings."""
        assert isinstance(scan, RangeScan)
        self._step += 1
        if not scan.ranges.any() or not self._has_moved(scan):
            return b""
        self._last = scan
        message, ranges = self._message, scan.ranges.astype(np.float64) / 1000
        ranges[scan.ranges == NO_MEASUREMENT] = np.nan
        ranges[scan.ranges == NOTHING] = np.inf
        half = math.pi * scan.heading / TURN
        x, y = (units / UNIT * self._cell_m for units in scan.place)
        for name in ("scan", "offset", "pose"):
            message[f"{name}.stamp"] = self._step, 0
        message["ranges"], message["pose"] = ranges, (x, y, 0, 0, 0, math.sin(half), math.cos(half))
        return CDR + message.tobytes()

    def _has_moved(self, scan: RangeScan) -> bool:
        """Whether a robot has moved far enough since the last scan that it sent."""
        if self._last is None:
            return True
        (x, y), (before_x, before_y) = scan.place, self._last.place
        turn = abs((scan.heading - self._last.heading + TURN // 2) % TURN - TURN // 2)
        way = math.hypot(x - before_x, y - before_y) / UNIT * self._cell_m
        return way >= TRAVEL_M or turn * FULL_TURN / TURN >= TURN_RAD

    def decode(self, map_id: int, data: bytes) -> RangeScan:
        """Decode a message of a map."""
        (message,) = np.frombuffer(data[len(CDR) :], message_layout(self.laser_of(map_id).beams))
        if not data.startswith(CDR) or message["beams"] != message["ranges"].size:
            raise ProtocolError(SlamToolboxEncoding.name, 0, "no scan of its author's laser")
        x, y, *_, sine, cosine = message["pose"].tolist()
        if not (all(map(math.isfinite, (x, y, sine, cosine))) and max(abs(x), abs(y)) <= self._farthest_m):
            raise ProtocolError(SlamToolboxEncoding.name, 0, f"position ({x}, {y}) is outside any grid")
        place = round(x / self._cell_m * UNIT), round(y / self._cell_m * UNIT)
        meters = message["ranges"].astype(np.float64)
        millimeters = np.clip(np.nan_to_num(np.rint(1000 * meters), nan=1), 1, NOTHING - 1).astype(np.uint16)
        millimeters[np.isnan(meters)], millimeters[meters == np.inf] = NO_MEASUREMENT, NOTHING
        return RangeScan(place, round(math.atan2(sine, cosine) / math.pi * TURN) % TURN, millimeters)

    @property
    def _farthest_m(self) -> float:
        return MAX_COORDINATE / UNIT * self._cell_m
