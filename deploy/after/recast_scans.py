"""The laser scans of a finished run, cast again from the map and the recorded poses.

The world casts scans from cell centers in exact arithmetic. For lasers that cover their whole field of view at once
these are the scans of the run, bit for bit. A scanner that turns, or that is off while its robot drives, saw only part
of the scan returned here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from deploy.after.archive import Archive
from protocol.grid import HEADINGS, Mask, ray_table
from protocol.scans import Readings
from worldsim.laser import cast
from worldsim.maps import to_cell


@dataclass(frozen=True)
class Rescan:
    """One scan: the robot, its cell, and uint16 readings of shape (beams,) (`protocol.scans`)."""

    robot: int
    x: int
    y: int
    heading: int
    readings: Readings


class Lasers:
    """The lasers of a run's robots."""

    def __init__(self, archive: Archive) -> None:
        self._archive = archive
        plan = archive.plan
        self._bodies = plan.world.bodies
        self.ray_tables = [ray_table(body.range_cells, plan.world.beams) for body in self._bodies]

    def scans(self) -> Iterator[tuple[int, list[Rescan]]]:
        """Yield each step and its scans, by ascending robot."""
        steps, world = self._archive.steps, self._archive.plan.map
        starts = np.flatnonzero(np.diff(steps["step"], prepend=-1))
        for first, end in zip(starts, [*starts[1:], len(steps["step"])], strict=True):
            places = []
            for row in range(first, end):
                x, y = to_cell(world, steps["x"][row], steps["y"][row])
                heading = round(steps["heading"][row] * HEADINGS / 360) % HEADINGS
                places.append((int(steps["robot"][row]), round(x), round(y), heading))
            standing: Mask = np.zeros(world.cells.shape, np.bool_)
            for _, x, y, _ in places:
                standing[y, x] = True
            yield int(steps["step"][first]), [self._scan(standing, *place) for place in sorted(places)]

    def _scan(self, standing: Mask, robot: int, x: int, y: int, heading: int) -> Rescan:
        truth, body = self._archive.plan.map.cells, self._bodies[robot]
        readings = cast(truth, standing, self.ray_tables[robot], x, y, heading, body.field_of_view)
        return Rescan(robot, x, y, heading, readings)
