"""The hardware of a robot: the world simulates it, and the robots plan with it."""

from __future__ import annotations

import math

import msgspec

from protocol.range_scans import Laser


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
