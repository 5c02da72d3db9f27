"""Feeds of a robot's maps, to a viewer and to the recorder: every few steps, and only the maps that changed."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from agent.outline.polygons import SIDE_X, SIDE_Y, Polygons
from agent.robot import Robot
from agent.settings import Settings
from protocol.cell_bytes import grid_to_bytes
from protocol.grid import Grid
from protocol.messages import MapChanges, Outlines, Snapshot

SHOWN_EVERY = 5
"""Steps from one feed to the next."""
NEVER_REPORTED = 255
"""A value that no cell has: with it as the last report, the next one lists every cell."""


class ViewerFeed:
    """The maps that one viewer has been sent so far."""

    def __init__(self) -> None:
        self._planning: Grid | None = None
        self._outlines = _OutlineFeed()

    def news(self, step: int, robot: Robot) -> list[Snapshot | Outlines]:
        """Return the maps that changed since the last call."""
        changed: list[Snapshot | Outlines] = []
        if self._planning is None or not np.array_equal(self._planning, robot.planning):
            self._planning = robot.planning.copy()
            height, width = robot.planning.shape
            changed.append(Snapshot(step, width, height, grid_to_bytes(robot.planning)))
        return changed + self._outlines.changes(step, robot)


class RecorderFeed:
    """The maps that the recorder has been sent so far.

    Where a robot starts again, the recorder holds the maps of its former incarnation: the first report then lists
    every cell.
    """

    def __init__(self, settings: Settings) -> None:
        reported = NEVER_REPORTED if settings.incarnation else 0
        self._cells = np.full((settings.height, settings.width), reported, np.uint8)
        self._outlines = _OutlineFeed()

    def changes(self, step: int, robot: Robot) -> list[MapChanges | Outlines]:
        """Return the cells and outlines that changed since the last call."""
        cells = robot.own | robot.planning << np.uint8(2)
        changed = np.flatnonzero(cells != self._cells)
        self._cells = cells
        reports: list[MapChanges | Outlines] = [*self._outlines.changes(step, robot)]
        if len(changed):
            values = cells.ravel()[changed]
            reports.append(MapChanges(step, changed.astype("<u4").tobytes(), values.tobytes()))
        return reports


class _OutlineFeed:
    """Outlines that a receiver has been sent so far, by map."""

    def __init__(self) -> None:
        self._sent: dict[int, Polygons] = {}

    def changes(self, step: int, robot: Robot) -> list[Outlines]:
        changed = [
            (map_id, polygons)
            for map_id, polygons in sorted(robot.polygons.items())
            if self._sent.get(map_id) is not polygons
        ]
        self._sent |= changed
        return [Outlines(step, map_id, outline_bytes(polygons)) for map_id, polygons in changed]


@lru_cache(maxsize=256)
def outline_bytes(polygons: Polygons) -> bytes:
    """Encode polygons as described in `protocol.messages.Outlines`; robots of this process share the result."""
    sizes = np.diff(polygons.start)
    rows = np.empty((len(polygons.x), 4), "<i2")
    rows[:, 0] = np.repeat(np.arange(polygons.objects), sizes)
    rows[:, 1] = 4 * polygons.x + SIDE_X[polygons.side]
    rows[:, 2] = 4 * polygons.y + SIDE_Y[polygons.side]
    rows[:, 3] = polygons.occupied | np.repeat(polygons.inside, sizes).astype(np.uint8) << 1
    return rows.tobytes()
