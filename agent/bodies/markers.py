"""What a robot in the field shows in RViz: its target, its teammates, and the frontiers, as markers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from agent.planning.frontier import frontier_cells
from protocol.arrays import Cells
from protocol.grid import FREE, Cell, Grid
from protocol.map_frame import MapFrame
from protocol.ros2.messages import MARKERS, POINT, Messages
from protocol.transforms import Pose

MARKER = "visualization_msgs/msg/Marker"
COLOR = "std_msgs/msg/ColorRGBA"
VECTOR = "geometry_msgs/msg/Vector3"
SPHERE_LIST, POINTS = 7, 8
"""Types of markers."""
ADD, DELETE = 0, 2
"""Actions of markers: one without points is deleted."""
MOST_POINTS = 2000
"""Points of a marker at most, so that large frontiers do not fill the network."""


class Layer(NamedTuple):
    """A marker: cells that are drawn in one color, with a size in meters."""

    name: str
    kind: int
    cells: Cells
    size_m: float
    color: tuple[float, float, float]


def layers(grid: Grid, target: Cell | None, teammates: Sequence[Cell]) -> list[Layer]:
    """Return the markers of a robot: a grid's frontiers, its target, and the cells of its teammates."""
    frontier = frontier_cells(grid, grid == FREE)
    own = np.array([target] if target else [], np.int32).reshape(-1, 2)
    others = np.array(teammates, np.int32).reshape(-1, 2)
    return [
        Layer("frontiers", POINTS, frontier[:: len(frontier) // MOST_POINTS + 1], 0.05, (0.1, 0.6, 1.0)),
        Layer("target", SPHERE_LIST, own, 0.3, (1.0, 0.3, 0.1)),
        Layer("teammates", SPHERE_LIST, others, 0.4, (0.2, 0.8, 0.2)),
    ]


def marker_array(
    messages: Messages, shown: Sequence[Layer], where: MapFrame, map_pose: Pose, frame: str, now_ns: int
) -> Any:
    """Return markers as a message in the robot's map frame, called `frame`; `where` and `map_pose` as for its map."""
    to_map = map_pose.inverse()
    return messages[MARKERS](
        markers=[_marker(messages, layer, where, to_map, messages.header(frame, now_ns)) for layer in shown]
    )


def _marker(messages: Messages, layer: Layer, where: MapFrame, to_map: Pose, header: Any) -> Any:
    points = []
    for x, y in layer.cells.tolist():
        place = to_map.then(Pose(*where.position(x + 0.5, y + 0.5), 0.0))
        points.append(messages[POINT](x=place.x, y=place.y, z=0.0))
    red, green, blue = layer.color
    return messages.new(
        MARKER,
        header=header,
        ns=layer.name,
        type=layer.kind,
        action=ADD if points else DELETE,
        pose=messages.pose(0.0, 0.0, 0.0),
        scale=messages[VECTOR](x=layer.size_m, y=layer.size_m, z=layer.size_m),
        color=messages[COLOR](r=red, g=green, b=blue, a=1.0),
        points=points,
    )
