"""Scans as logs and ROS have them, in meters and counterclockwise, in the form of `protocol.range_scans`."""

from __future__ import annotations

import math
from dataclasses import dataclass

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


def millimeters(
    ranges: NDArray[np.floating], *, least: float, nothing: float, reverse: bool
) -> NDArray[np.uint16]:
    """Convert ranges from meters to the form of `protocol.range_scans`.

    Ranges of at least `nothing` meters show that a beam met nothing; there is no such limit if it is not above zero.
    Those below `least`, not above zero, or not a number are no measurements; a `least` that is not a number excludes
    none. With `reverse`, the last beam becomes the first.
    """
    limit = min(nothing if nothing > 0 else math.inf, NOTHING / 1000)
    meters = np.asarray(ranges, np.float64)[::-1] if reverse else np.asarray(ranges, np.float64)
    with np.errstate(invalid="ignore"):
        measured = ~(meters < least) & (meters > 0)
        met = measured & (meters < limit)
    found = np.where(measured, NOTHING, NO_MEASUREMENT).astype(np.uint16)
    found[met] = np.maximum(np.rint(1000 * meters[met]), 1).astype(np.uint16)
    return found


def _units(radians: float) -> int:
    return round(radians / (2 * math.pi) * TURN)
