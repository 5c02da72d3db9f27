"""Scans as logs and ROS have them, in meters and counterclockwise, in the form of `protocol.range_scans`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.message_fields import MAX_BEAMS
from protocol.range_scans import NO_MEASUREMENT, NOTHING, TURN


@dataclass(frozen=True)
class BeamAngles:
    """The angles of a laser's beams relative to the heading, as `protocol.range_scans.Laser` has them.

    Angles grow clockwise on a picture, so that they run against those of a log.
    """

    beams: int
    first: int
    """Angle of the first beam, in 1 / `TURN`."""
    span: int
    """Angle between the first and the last beam, in 1 / `TURN`."""

    @classmethod
    def of(cls, beams: int, first: float, increment: float) -> BeamAngles:
        """Return the angles of a laser that a log describes: in radians, counterclockwise; ValueError if invalid."""
        if not 2 <= beams <= MAX_BEAMS:
            raise ValueError(f"{beams} beams; a scan must have 2 to {MAX_BEAMS}")
        span, turn = (beams - 1) * abs(increment), 2 * math.pi
        if not (abs(first) <= turn and abs(increment) <= turn and 0 < span <= turn + abs(increment)):
            raise ValueError(f"beams from {first:g} rad, {increment:g} rad apart, are not those of a laser")
        last = first + (beams - 1) * increment
        return cls(beams, _units(-max(first, last)), _units(span))

    def __str__(self) -> str:
        left, right = -self.first, -self.first - self.span
        return f"{self.beams} beams from {360 * right / TURN:.1f} to {360 * left / TURN:.1f} degrees"


@dataclass(frozen=True, eq=False)
class MetricScan:
    """One scan in meters and radians; its angles are counterclockwise as seen from above."""

    ranges: NDArray[np.floating]
    first: float
    """Angle of the first beam, relative to the heading."""
    increment: float
    """Angle from each beam to the next one; negative if they run clockwise."""
    least: float
    """Ranges below it are no measurements; if it is not a number, it excludes none."""
    nothing: float
    """From this range on, a beam met nothing; there is no such limit if it is not above zero."""

    @classmethod
    def of_message(cls, message: Any, *, is_flipped: bool) -> MetricScan:
        """Return the scan of a message of type LaserScan; the angles of a flipped laser run the other way."""
        sign = -1 if is_flipped else 1
        first, increment = sign * float(message.angle_min), sign * float(message.angle_increment)
        return cls(
            np.asarray(message.ranges), first, increment, float(message.range_min), float(message.range_max)
        )

    @property
    def angles(self) -> BeamAngles:
        """The angles of its beams; ValueError if they are not those of a laser."""
        return BeamAngles.of(len(self.ranges), self.first, self.increment)

    def has_beams_of(self, other: MetricScan, tolerance: float) -> bool:
        """Return whether the beams have the same number as those of another scan, and nearly the same angles."""
        return (
            len(self.ranges) == len(other.ranges)
            and abs(self.first - other.first) <= tolerance
            and abs(self.increment - other.increment) <= tolerance
        )

    def at_angles_of(self, other: MetricScan) -> MetricScan:
        """Return the scan with the range that is nearest to each angle of another one; NaN where there is none."""
        if self.has_beams_of(other, 1e-6):
            return self
        found = np.full(len(other.ranges), np.nan)
        wanted = other.first + np.arange(len(found)) * other.increment
        with np.errstate(all="ignore"):
            turn = np.rint(2 * math.pi / np.abs(np.float64(self.increment)))
            index = np.rint((wanted - self.first) / self.increment) % turn
        exists = index < len(self.ranges)
        found[exists] = np.asarray(self.ranges)[index[exists].astype(np.int64)]
        return replace(self, ranges=found, first=other.first, increment=other.increment)

    def millimeters(self) -> NDArray[np.uint16]:
        """Return the ranges in the form of `protocol.range_scans`: millimeters, by ascending angle there.

        Ranges that are not above zero, or not a number, are no measurements either.
        """
        limit = min(self.nothing if self.nothing > 0 else math.inf, NOTHING / 1000)
        meters = np.asarray(self.ranges, np.float64)
        meters = meters[::-1] if self.increment > 0 else meters
        with np.errstate(invalid="ignore"):
            measured = ~(meters < self.least) & (meters > 0)
            met = measured & (meters < limit)
        found = np.where(measured, NOTHING, NO_MEASUREMENT).astype(np.uint16)
        found[met] = np.maximum(np.rint(1000 * meters[met]), 1).astype(np.uint16)
        return found


def _units(radians: float) -> int:
    return round(radians / (2 * math.pi) * TURN)
