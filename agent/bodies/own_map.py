"""The map that a ROS 2 robot's own SLAM makes: which cells it knows, and its states in the team's grid."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.map_frame import MapFrame
from protocol.transforms import FARTHEST_M, Pose

LEAST_OCCUPIED, MOST_FREE = 65, 25
"""Values from 0 to 100 from which a cell is occupied, and up to which it is free, as map_saver of nav2 has them."""


class OwnMap:
    """A message of ``map`` (OccupancyGrid), in the robot's map frame; ValueError if it is malformed."""

    def __init__(self, message: Any) -> None:
        info = message.info
        origin = info.origin
        corner = origin.position.x, origin.position.y
        angles = origin.orientation.z, origin.orientation.w
        if not (all(map(math.isfinite, angles)) and all(abs(each) <= FARTHEST_M for each in corner)):
            raise ValueError("its origin is not a pose")
        if not 1e-3 <= info.resolution <= 1e3:
            raise ValueError(f"its resolution is {info.resolution:g} m")
        if len(message.data) != info.width * info.height:
            raise ValueError(f"{len(message.data)} cells instead of {info.width} x {info.height}")
        self._values: NDArray[np.int8] = np.asarray(message.data, np.int8).reshape(info.height, info.width)
        self._corner = Pose(*corner, 2 * math.atan2(origin.orientation.z, origin.orientation.w))
        self._resolution = float(info.resolution)

    def is_known(self, pose: Pose) -> bool:
        """Return whether the cell of a pose in the robot's map frame is known."""
        inner = self._corner.inverse().then(pose)
        column, row = math.floor(inner.x / self._resolution), math.floor(inner.y / self._resolution)
        height, width = self._values.shape
        return 0 <= column < width and 0 <= row < height and bool(self._values[row, column] >= 0)

    def states(self, grid: MapFrame, map_pose: Pose) -> Grid:
        """Return the states of the cells of `grid`, with the robot's map frame at `map_pose` in the frame of the grid.

        A cell has the state at its center. It is also occupied if the center of an occupied cell of the map lies in it,
        so that no wall is lost, whatever the resolutions. Values between free and occupied count as unknown.
        """
        found = np.full((grid.height, grid.width), UNKNOWN, np.uint8)
        corner = map_pose.then(self._corner)
        values = self._at_centers(grid, corner)
        found[(values >= 0) & (values <= MOST_FREE)] = FREE
        found[values >= LEAST_OCCUPIED] = OCCUPIED
        rows, columns = np.nonzero(self._values >= LEAST_OCCUPIED)
        cos, sin = math.cos(corner.yaw), math.sin(corner.yaw)
        right, up = (columns + 0.5) * self._resolution, (rows + 0.5) * self._resolution
        x, y = corner.x + cos * right - sin * up, corner.y + sin * right + cos * up
        column = np.floor((x - grid.x) / grid.resolution)
        row = np.floor(grid.height - (y - grid.y) / grid.resolution)
        inside = (column >= 0) & (column < grid.width) & (row >= 0) & (row < grid.height)
        found[row[inside].astype(np.int64), column[inside].astype(np.int64)] = OCCUPIED
        return found

    def _at_centers(self, grid: MapFrame, corner: Pose) -> NDArray[np.int8]:
        """Return the values at the centers of the cells of `grid`, shape (h, w); -1 outside of the map."""
        x = grid.x + (np.arange(grid.width) + 0.5) * grid.resolution - corner.x
        y = (grid.y + (grid.height - np.arange(grid.height) - 0.5) * grid.resolution - corner.y)[:, None]
        cos, sin = math.cos(corner.yaw) / self._resolution, math.sin(corner.yaw) / self._resolution
        column = np.floor(cos * x + sin * y).astype(np.int32)
        row = np.floor(cos * y - sin * x).astype(np.int32)
        height, width = self._values.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        values = np.full(inside.shape, -1, np.int8)
        values[inside] = self._values[row[inside], column[inside]]
        return values
