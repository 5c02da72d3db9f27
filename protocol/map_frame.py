"""Where a grid lies: between poses in meters, as logs and ROS have them, and positions in cells.

Poses have y up, and angles counterclockwise. Cells have their origin at the upper left corner of the grid and y down,
as pictures have, and so angles clockwise (`protocol.range_scans`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from protocol.range_scans import TURN, UNIT
from protocol.transforms import Pose


@dataclass(frozen=True)
class MapFrame:
    """A grid of `width` x `height` cells of `resolution` meters with its lower left corner at (`x`, `y`), in meters."""

    width: int
    height: int
    resolution: float
    x: float = 0.0
    y: float = 0.0

    def place(self, pose: Pose) -> tuple[int, int]:
        """Return the position of a pose in 1 / `UNIT` cell."""
        column = (pose.x - self.x) / self.resolution
        row = self.height - (pose.y - self.y) / self.resolution
        return math.floor(column * UNIT), math.floor(row * UNIT)

    def heading(self, pose: Pose) -> int:
        """Return the heading of a pose in 1 / `TURN`."""
        return round(-pose.yaw / math.tau * TURN) % TURN

    def has(self, place: tuple[int, int]) -> bool:
        """Return whether a position is on the grid."""
        return 0 <= place[0] < self.width * UNIT and 0 <= place[1] < self.height * UNIT

    def position(self, column: float, row: float) -> tuple[float, float]:
        """Return a position in cells as meters; the center of cell (0, 0) is at (0.5, 0.5)."""
        return self.x + column * self.resolution, self.y + (self.height - row) * self.resolution
