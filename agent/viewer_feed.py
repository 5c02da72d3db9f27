"""The feed of a robot's maps to a viewer: at intervals, and only what has changed since the last time."""

from __future__ import annotations

import numpy as np

from agent.outline.polygons import SIDE_X, SIDE_Y, Polygons
from agent.robot import Robot
from protocol.grid import Grid
from protocol.messages import Outlines, Snapshot, grid_to_bytes

SHOWN_EVERY = 5
"""Steps from one feed to the next."""


class ViewerFeed:
    """What one viewer has been sent so far."""

    def __init__(self) -> None:
        self._planning: Grid | None = None
        self._polygons: dict[int, Polygons] = {}

    def news(self, step: int, robot: Robot) -> list[Snapshot | Outlines]:
        """Return what the viewer has not been sent yet."""
        said: list[Snapshot | Outlines] = []
        if self._planning is None or not np.array_equal(self._planning, robot.planning):
            self._planning = robot.planning.copy()
            height, width = robot.planning.shape
            said.append(Snapshot(step, width, height, grid_to_bytes(robot.planning)))
        for map_id, polygons in sorted(robot.polygons.items()):
            if self._polygons.get(map_id) is not polygons:
                self._polygons[map_id] = polygons
                said.append(Outlines(step, map_id, outline_bytes(polygons)))
        return said


def outline_bytes(polygons: Polygons) -> bytes:
    """Encode polygons as described in `protocol.messages.Outlines`."""
    sizes = np.diff(polygons.start)
    rows = np.empty((len(polygons.x), 4), "<i2")
    rows[:, 0] = np.repeat(np.arange(polygons.objects), sizes)
    rows[:, 1] = 4 * polygons.x + SIDE_X[polygons.side]
    rows[:, 2] = 4 * polygons.y + SIDE_Y[polygons.side]
    rows[:, 3] = polygons.occupied | np.repeat(polygons.inside, sizes).astype(np.uint8) << 1
    return rows.tobytes()
