"""The team's map as a ROS 2 robot shows it: an OccupancyGrid in the robot's map frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FREE, OCCUPIED, Grid
from protocol.map_frame import MapFrame
from protocol.ros2.messages import OCCUPANCY_GRID, Messages
from protocol.transforms import Pose

_VALUES = np.full(256, -1, np.int8)
_VALUES[FREE], _VALUES[OCCUPIED] = 0, 100


def occupancy(grid: Grid) -> NDArray[np.int8]:
    """Return the data of an OccupancyGrid: -1 unknown, 0 free, 100 occupied; the row at the bottom comes first."""
    values: NDArray[np.int8] = _VALUES[grid[::-1]].reshape(-1)
    return values


def occupancy_grid(
    messages: Messages, grid: Grid, where: MapFrame, map_pose: Pose, frame: str, now_ns: int
) -> Any:
    """Return a grid as a message.

    `map_pose` is the pose of the robot's map frame, called `frame`, in the frame of the team, where the grid lies at
    `where`.
    """
    corner = map_pose.inverse().then(Pose(where.x, where.y, 0.0))
    message = messages.new(OCCUPANCY_GRID, header=messages.header(frame, now_ns), data=occupancy(grid))
    message.info.resolution = where.resolution
    message.info.width, message.info.height = where.width, where.height
    message.info.origin = messages.pose(*corner)
    message.info.map_load_time = message.header.stamp
    return message
