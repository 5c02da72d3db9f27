"""A laser scanner that measures ranges in meters, with errors (beam model of Thrun et al. 2005, section 6.3).

A beam measures the distance to the middle of its way through the first cell that is not free: walls of the true map
are cells, and their surfaces lie somewhere within. Then the errors follow: a Gaussian error; beams that end early;
beams without a return; and beams that are split at an edge, so that their range lies between the two surfaces.

A robot knows where its teammates are, and filters them out: beams that meet one have no measurement.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from protocol.arrays import FloatRows, Floats, Uint16s
from protocol.grid import FREE, Grid, Mask
from protocol.kernels import kernel
from protocol.range_scans import DIRECTION_LENGTH, NO_MEASUREMENT, NOTHING, TURN, Laser, directions
from worldsim.sensor_options import LaserOptions

EDGE_M = 0.3
"""Difference of the ranges of neighboring beams between which there is an edge, in meters."""

NO_DISCS: FloatRows = np.empty((0, 3))

_BEYOND, _TEAMMATE = -1.0, -2.0
"""Results of a beam that meets nothing within its reach, and of one that meets a teammate."""


class RangeLaser:
    """One robot's laser scanner; `resolution` is the side of a cell in meters."""

    def __init__(self, options: LaserOptions, geometry: Laser, resolution: float) -> None:
        self._options = options
        self._angles = geometry.angles
        self._resolution = resolution
        reach_m = geometry.reach_mm / 1000 + 6 * (options.range_error_m + EDGE_M)
        if options.max_range_m:
            reach_m = min(reach_m, options.max_range_m)
        self._reach = reach_m / resolution

    def ranges(
        self,
        truth: Grid,
        teammates: Mask,
        place: tuple[float, float],
        heading: int,
        random: Generator,
        people: FloatRows = NO_DISCS,
    ) -> Uint16s:
        """Measure from a position (x, y) in cells, as millimeters of shape (beams,).

        `truth` (uint8) and `teammates` (bool) have shape (h, w). `people`, shape (n, 3), are discs: center (x, y) and
        radius, in cells. The low corner of cell (0, 0) is at (0, 0); `heading` is in 1 / `TURN`.
        """
        beams = directions()[(heading + self._angles) & (TURN - 1)] / DIRECTION_LENGTH
        exact = _cast_ranges(truth, teammates.view(np.uint8), people, *place, beams, self._reach)
        return self._disturb(exact, random)

    def _disturb(self, exact: Floats, random: Generator) -> Uint16s:
        """Add the errors to exact distances in cells."""
        options, count = self._options, len(exact)
        is_wall = exact > 0
        normal, kind, share = random.standard_normal(count), random.random(count), random.random(count)
        meters = np.where(is_wall, exact, self._reach) * self._resolution
        ahead = np.append(meters[1:], meters[-1])
        is_edge = is_wall & np.append(is_wall[1:], False) & (np.abs(ahead - meters) > EDGE_M)
        mixed = (random.random(count) < options.mixed) & is_edge
        measured = np.where(mixed, meters + share * (ahead - meters), meters)
        is_short = kind < options.short
        measured = np.where(is_short, share * meters, measured)
        measured = measured + normal * (options.range_error_m + options.range_error_share * measured)
        millimeters = np.clip(np.rint(1000 * measured), 1, NOTHING - 1)
        found = np.where((exact == _BEYOND) & ~is_short, NOTHING, millimeters)
        is_missing = (kind >= options.short) & (kind < options.short + options.missing)
        off = is_missing | (exact == _TEAMMATE) | (measured < options.min_range_m)
        return np.where(off, NO_MEASUREMENT, found).astype(np.uint16)


@kernel
def _nearest_disc(discs: FloatRows, x: float, y: float, dx: float, dy: float) -> float:
    """Return the distance from (x, y) in direction (dx, dy) to the nearest disc that does not contain (x, y)."""
    nearest = np.inf
    for disc in range(len(discs)):
        to_x, to_y, radius = discs[disc, 0] - x, discs[disc, 1] - y, discs[disc, 2]
        along, aside = to_x * dx + to_y * dy, to_x * dy - to_y * dx
        half_chord = radius * radius - aside * aside
        if half_chord > 0 and along > np.sqrt(half_chord):
            nearest = min(nearest, along - np.sqrt(half_chord))
    return nearest


@kernel
def _cast_ranges(
    truth: Grid, teammates: Grid, people: FloatRows, x: float, y: float, beams: FloatRows, reach: float
) -> Floats:
    """Return the distance in cells to what each beam meets first.

    Of a cell that is not free, this is the middle of the beam's way through it; of a disc, the point where the beam
    meets its border.
    """
    found = np.empty(len(beams))
    height, width = truth.shape
    for beam in range(len(beams)):
        dx, dy = beams[beam, 0], beams[beam, 1]
        column, row = int(np.floor(x)), int(np.floor(y))
        step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        every_x = abs(1.0 / dx) if dx != 0.0 else np.inf
        every_y = abs(1.0 / dy) if dy != 0.0 else np.inf
        to_x = (column + 1 - x if dx > 0 else x - column) * every_x if dx != 0.0 else np.inf
        to_y = (row + 1 - y if dy > 0 else y - row) * every_y if dy != 0.0 else np.inf
        person = _nearest_disc(people, x, y, dx, dy)
        found[beam] = person if person <= reach else _BEYOND
        while True:
            entered = min(to_x, to_y)
            if entered > min(reach, person):
                break
            if to_x <= to_y:
                column += step_x
                to_x += every_x
            else:
                row += step_y
                to_y += every_y
            if not (0 <= column < width and 0 <= row < height) or truth[row, column] != FREE:
                found[beam] = (entered + min(to_x, to_y)) / 2
                break
            if teammates[row, column]:
                found[beam] = _TEAMMATE
                break
    return found
