"""The hardware of a robot: the world simulates it, and the robots plan with it."""

from __future__ import annotations

import math

import msgspec

from protocol.range_scans import Laser

OPENING_M = 0.3
"""Width in meters of the narrowest opening that robots with real sensors explore; wider robots need their own width."""

OPENING_CELLS = 2
"""The same in cells, at least."""


class Body(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One robot's hardware."""

    range_cells: float
    """Sensor range in cells."""
    field_of_view: float
    """Degrees, centered on the heading."""
    speed: float
    """Cells per step."""
    scanner_turn: float = 0.0
    """Degrees that the scanner turns and covers per step; 0 if it covers the whole field of view at once."""
    radius_cells: float = 0.0
    """Radius of the robot, a disc, in cells; 0 for a point."""
    laser: Laser | None = None
    """The beams of its laser; None: the laser and the pose are exact, and readings count cells (`protocol.scans`)."""
    scan_rate: float = 1.0
    """Scans per step, at most 1."""

    @property
    def turn_steps(self) -> int:
        """Steps of a full turn of the scanner."""
        return math.ceil(360 / self.scanner_turn) if self.scanner_turn else 1


def narrowest_opening(radius_cells: float, resolution: float) -> int:
    """Return the width in cells of the narrowest opening that a robot with real sensors explores.

    `radius_cells` is the radius of the robot in cells of `resolution` meters.
    """
    return max(OPENING_CELLS, round(OPENING_M / resolution), math.ceil(2 * radius_cells))
