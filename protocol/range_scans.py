"""Scans of real lasers: where the robot believes it is, and ranges in millimeters.

Beams start at the robot's position and at angles around its heading (`Laser`). The binary form of a scan has
2 * beams + 10 bytes, big-endian: x and y as int32, the heading as uint16, one uint16 per beam.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from functools import lru_cache

import msgspec
import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Bools, Int32Rows, Int64Rows, Int64s, Uint16s
from protocol.errors import ProtocolError
from protocol.grid import FINE, HEADINGS, MAX_SIDE
from protocol.kernels import kernel

UNIT = 256
"""Units of a position in a cell; the low corner of cell (0, 0) is at (0, 0)."""

TURN = 1 << 16
"""Units of an angle in a full turn. Angle 0 points along +x; angles grow towards +y, clockwise on a picture."""

NO_MEASUREMENT = 0
"""Range of a beam of which the laser knows nothing."""

NOTHING = 0xFFFF
"""Range of a beam that met nothing within the laser's reach."""

MAX_REACH_M = 65.0
"""Largest `Laser.reach_mm`, in meters: ranges are uint16."""

DIRECTION_LENGTH = 1 << 14
"""Length of the vectors in `directions`."""

Vector = tuple[int, int]
"""A direction (x, y), of any length."""

_HEAD = struct.Struct(">iiH")

MAX_COORDINATE = 2 * MAX_SIDE * UNIT
"""Largest coordinate of a scan's position, so that the ends of its beams fit into int32."""


class Laser(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The beams of a laser scanner: `beams` angles, evenly spaced from `first` over `span`, in units of 1 / `TURN`.

    `first` is relative to the heading; the last beam lies at `first` + `span`. `reach_mm` is the range up to which
    scans are mapped, in millimeters: longer ranges show free cells up to there.
    """

    beams: int
    first: int
    span: int
    reach_mm: int

    @property
    def angles(self) -> NDArray[np.int64]:
        """Angle of each beam relative to the heading, in 1 / `TURN`."""
        return self.first + np.arange(self.beams, dtype=np.int64) * self.span // max(self.beams - 1, 1)

    @property
    def spacing_rad(self) -> float:
        """Angle between neighboring beams, in radians."""
        return 2 * math.pi * self.span / TURN / max(self.beams - 1, 1)


@dataclass(frozen=True)
class RangeScan:
    """One scan: position in 1 / `UNIT` cell, heading in 1 / `TURN`, uint16 ranges in millimeters of shape (beams,)."""

    place: tuple[int, int]
    heading: int
    ranges: Uint16s

    @property
    def x(self) -> int:
        """Column of the robot's cell."""
        return self.place[0] // UNIT

    @property
    def y(self) -> int:
        """Row of the robot's cell."""
        return self.place[1] // UNIT


def cell_offset(units: int) -> int:
    """Return a coordinate in 1 / `UNIT` cell as `Sense` has it: in 1 / `FINE` cell from the center of its cell."""
    return (units % UNIT * FINE + FINE // 2) // UNIT - FINE // 2


def nearest_heading(heading: int) -> int:
    """Return an angle in 1 / `TURN` as `Sense` has it: the nearest of `HEADINGS`."""
    return round(heading * HEADINGS / TURN) % HEADINGS


def encode_range_scan(scan: RangeScan) -> bytes:
    """Encode a scan in its binary form."""
    return _HEAD.pack(*scan.place, scan.heading) + scan.ranges.astype(">u2").tobytes()


def range_scan_size(laser: Laser) -> int:
    """Return the bytes of a scan in its binary form."""
    return _HEAD.size + 2 * laser.beams


def decode_range_scan(data: bytes, laser: Laser) -> RangeScan:
    """Decode a scan; ProtocolError for a wrong length, or a position far outside any grid."""
    if len(data) != range_scan_size(laser):
        reason = f"{len(data)} bytes instead of {range_scan_size(laser)}"
        raise ProtocolError("range scan", 0, reason)
    x, y, heading = _HEAD.unpack_from(data)
    if max(abs(x), abs(y)) > MAX_COORDINATE:
        raise ProtocolError("range scan", 0, f"position ({x}, {y}) is outside any grid")
    return RangeScan((x, y), heading, np.frombuffer(data, ">u2", offset=_HEAD.size).astype(np.uint16))


def beam_ends(scan: RangeScan, laser: Laser, resolution: float) -> tuple[Int32Rows, Bools]:
    """Return where the measured beams of a scan end, and which of them ended at an obstacle.

    The ends have shape (n, 2), in 1 / `UNIT` cell; `resolution` is the side of a cell in meters.
    """
    scale = round(UNIT / (1000 * resolution) * (1 << 20))
    x, y = scan.place
    return _ends(x, y, scan.heading, _angles(laser), scan.ranges, laser.reach_mm, scale, directions())


def smoothed(scan: RangeScan, laser: Laser) -> RangeScan:
    """Return a scan in which each range is the median of itself and its two neighbors.

    This removes single wrong beams, and reduces errors along walls, but keeps edges. A beam without a measurement
    remains so, and one without two measured neighbors keeps its range.
    """
    return RangeScan(scan.place, scan.heading, _medians(scan.ranges, _sees_all_around(laser)))


def directions_between(scan: RangeScan, laser: Laser) -> tuple[Vector, Vector]:
    """Return the directions of the first and last beam, as vectors; both are (0, 0) if the laser sees all around."""
    if _sees_all_around(laser):
        return (0, 0), (0, 0)
    angles = scan.heading + laser.first + np.array([0, laser.span])
    (x, y), (last_x, last_y) = directions()[angles & (TURN - 1)].tolist()
    return (x, y), (last_x, last_y)


def _sees_all_around(laser: Laser) -> bool:
    """Return whether the last beam is as near to the first one as to the one before it."""
    return (TURN - laser.span) * (laser.beams - 1) <= laser.span + laser.beams


@kernel
def _medians(ranges: Uint16s, wraps: bool) -> Uint16s:
    found, count = ranges.copy(), len(ranges)
    for beam in range(count):
        if not wraps and (beam == 0 or beam == count - 1):
            continue
        before, here, after = ranges[beam - 1], ranges[beam], ranges[(beam + 1) % count]
        if min(before, here, after) > NO_MEASUREMENT:
            found[beam] = max(min(before, here), min(max(before, here), after))
    return found


@lru_cache(maxsize=16)
def _angles(laser: Laser) -> Int64s:
    return laser.angles


@lru_cache(maxsize=1)
def directions() -> Int64Rows:
    """Return the vector (cos, sin) of each angle, of length `DIRECTION_LENGTH`: shape (`TURN`, 2)."""
    angle = np.arange(TURN) * (2 * np.pi / TURN)
    table: Int64Rows = np.rint(np.stack([np.cos(angle), np.sin(angle)], axis=1) * DIRECTION_LENGTH).astype(
        np.int64
    )
    return table


@kernel
def _ends(
    x: int, y: int, heading: int, angles: Int64s, ranges: Uint16s, reach: int, scale: int, table: Int64Rows
) -> tuple[Int32Rows, Bools]:
    ends, hits = np.empty((len(ranges), 2), np.int32), np.empty(len(ranges), np.bool_)
    count = 0
    for beam in range(len(ranges)):
        if ranges[beam] == NO_MEASUREMENT:
            continue
        length = min(np.int64(ranges[beam]), np.int64(reach))
        angle = (heading + angles[beam]) & (TURN - 1)
        ends[count, 0] = x + (length * scale * table[angle, 0] >> 34)
        ends[count, 1] = y + (length * scale * table[angle, 1] >> 34)
        hits[count] = np.int64(ranges[beam]) <= reach
        count += 1
    return ends[:count], hits[:count]
