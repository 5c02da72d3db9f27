"""Shortest collision-free ways in the continuous plane: visibility graph and Dijkstra (leader paper, section III-A).

Obstacles are all cells that are not free. A shortest way is a polyline that bends at convex corners of obstacles alone,
so the nodes of the graph are these corners. The way keeps a tenth of a cell from all obstacles: collisions are checked
every tenth of a cell, and a robot must not be stopped at a corner that it passes. Apart from this margin it is exact.

The search skips corners farther away than an upper bound of the way, the length of a way over cells.
"""

from __future__ import annotations

import numpy as np

from protocol.arrays import Cells, Int64Rows, Int64s
from protocol.grid import FINE, FREE, Grid, Point
from protocol.kernels import kernel

MARGIN = 100
"""Distance of a way from obstacles, in thousandths of a cell."""

_HALF = FINE // 2


def shortest_way(floor: Grid, start: Point, goals: Cells, most: float) -> Cells | None:
    """Find the shortest way to the center of the nearest of `goals`, free cells, over cells that the robot may enter.

    `start` is the robot's position in thousandths of a cell; if it is too close to an obstacle, the way begins at the
    center of its cell. `most` is an upper bound of the length in cells: the length of a way over cells to a goal.

    Returns waypoints in thousandths of a cell, shape (m, 2), the last one a goal's center; None if no goal is
    reachable.
    """
    at = np.array(start, np.int64)
    middle = (at + _HALF) // FINE * FINE
    first: list[Int64Rows] = []
    if not _is_clear(floor, at[0], at[1], at[0], at[1]) or not _is_clear(
        floor, at[0], at[1], middle[0], middle[1]
    ):
        first, at = [middle], middle
    reach = (most + 1.0) * FINE
    targets = _within(goals.astype(np.int64) * FINE, at, reach)
    nodes = np.concatenate([at[None], targets, _within(_corners(floor), at, reach)])
    came = np.full(len(nodes), -1, np.int64)
    found = int(_search(floor, nodes, len(targets), reach, came))
    if found < 0:
        return None
    way = []
    while found > 0:
        way.append(nodes[found])
        found = int(came[found])
    return np.array(first + way[::-1], np.int32).reshape(-1, 2)


def _within(points: Int64Rows, at: Int64Rows, reach: float) -> Int64Rows:
    near: Int64Rows = points[((points - at) ** 2).sum(axis=1) <= reach * reach]
    return near


@kernel
def _corners(floor: Grid) -> Int64Rows:
    """Return the points where ways may bend, at the convex corners of obstacles, shape (n, 2)."""
    height, width = floor.shape
    out = np.empty((256, 2), np.int64)
    count = 0
    for y in range(height):
        for x in range(width):
            if floor[y, x] != FREE:
                continue
            for sy in (-1, 1):
                for sx in (-1, 1):
                    nx, ny = x + sx, y + sy
                    if not (0 <= nx < width and 0 <= ny < height) or floor[ny, nx] == FREE:
                        continue
                    if floor[y, nx] != FREE or floor[ny, x] != FREE:
                        continue
                    if count == len(out):
                        larger = np.empty((2 * count, 2), np.int64)
                        larger[:count] = out
                        out = larger
                    out[count, 0] = x * FINE + sx * (_HALF - MARGIN)
                    out[count, 1] = y * FINE + sy * (_HALF - MARGIN)
                    count += 1
    return out[:count].copy()


@kernel
def _is_clear(floor: Grid, x0: int, y0: int, x1: int, y1: int) -> bool:
    """Return whether a line keeps the distance `MARGIN` from all obstacles."""
    height, width = floor.shape
    side = float(_HALF + MARGIN) - 0.5
    low_y, high_y = min(y0, y1), max(y0, y1)
    for row in range(int(np.ceil((low_y - side) / FINE)), int(np.floor((high_y + side) / FINE)) + 1):
        # The part of the line in this row of cells, margin included.
        left, right = float(min(x0, x1)), float(max(x0, x1))
        if y0 != y1:
            top, bottom = max(float(low_y), row * FINE - side), min(float(high_y), row * FINE + side)
            at_top = x0 + (x1 - x0) * ((top - y0) / (y1 - y0))
            at_bottom = x0 + (x1 - x0) * ((bottom - y0) / (y1 - y0))
            left, right = min(at_top, at_bottom), max(at_top, at_bottom)
        for column in range(int(np.ceil((left - side) / FINE)), int(np.floor((right + side) / FINE)) + 1):
            inside = 0 <= row < height and 0 <= column < width
            if not inside or floor[row, column] != FREE:
                return False
    return True


@kernel
def _search(floor: Grid, nodes: Int64Rows, goals: int, reach: float, came: Int64s) -> int:
    """Search by Dijkstra's algorithm from node 0 to the nearest of nodes 1 to `goals`; -1 if none is reachable.

    `came` gets the predecessor of each node. Of equally long ways the one over the first nodes counts.
    """
    length = np.full(len(nodes), np.inf)
    done = np.zeros(len(nodes), np.bool_)
    length[0] = 0.0
    while True:
        here = -1
        for node in range(len(nodes)):
            if not done[node] and length[node] < np.inf and (here < 0 or length[node] < length[here]):
                here = node
        if here < 0 or 1 <= here <= goals:
            return here
        done[here] = True
        for node in range(1, len(nodes)):
            if done[node]:
                continue
            dx, dy = float(nodes[node, 0] - nodes[here, 0]), float(nodes[node, 1] - nodes[here, 1])
            new = length[here] + np.sqrt(dx * dx + dy * dy)
            if (
                new < length[node]
                and new <= reach
                and _is_clear(floor, nodes[here, 0], nodes[here, 1], nodes[node, 0], nodes[node, 1])
            ):
                length[node] = new
                came[node] = here
    return -1
