"""Value of an edge, by which refinement chooses the next split (thesis, section 4.3.2).

Algorithm 6 takes the largest segment distance. The thesis refines "the most valuable edges" of all polygons first, and
notes that another value function adapts the approximation; it defines none. Section 4.3.1 names two further error
criteria, minimum height and minimum width. The area is what Eq. 6.1 counts: cells that differ.
"""

from __future__ import annotations

import math
from typing import get_args

import numpy as np

from agent.encoding_options import ValueFunction
from protocol.arrays import Int32s, Int64Rows, Int64s
from protocol.kernels import kernel

VALUE_FUNCTIONS: tuple[ValueFunction, ...] = get_args(ValueFunction)

_HEIGHT, _WIDTH = 1, 2


@kernel
def edge_value(function: int, x: Int32s, y: Int32s, first: int, end: int, a: int, b: int) -> float:
    """Return the value of the edge from point `a` to point `b` of the object ``first:end``, in cells.

    `function` is an index of `VALUE_FUNCTIONS` above 0. Coordinates are in quarters of a cell.
    """
    count = (b - a if b > a else b - a + end - first) + 1
    from_a = np.empty((count, 2), np.int64)
    for number in range(count):
        at = a + number if a + number < end else a + number - end + first
        from_a[number, 0], from_a[number, 1] = x[at] - x[a], y[at] - y[a]
    if function == _HEIGHT:
        return math.sqrt(_largest_square(from_a, from_a[0], from_a[-1])) / 4
    if function == _WIDTH:
        return _width(from_a) / 4
    twice = np.int64(0)
    for number in range(1, count):
        twice += (
            from_a[number - 1, 0] * from_a[number, 1] - from_a[number - 1, 1] * from_a[number, 0]
        )  # the side from b to a adds nothing, since a is the origin
    return math.sqrt(abs(twice) / 32)


@kernel
def _largest_square(points: Int64Rows, one: Int64s, other: Int64s) -> float:
    """Return the squared distance of the farthest point from the line through two points."""
    along_x, along_y = other[0] - one[0], other[1] - one[1]
    largest = np.int64(0)
    for number in range(len(points)):
        across = along_x * (points[number, 1] - one[1]) - along_y * (points[number, 0] - one[0])
        largest = max(largest, across * across)
    return float(largest / (along_x * along_x + along_y * along_y))


@kernel
def _width(points: Int64Rows) -> float:
    """Return the width of a set of points: a narrowest strip has an edge of the convex hull on its rim."""
    hull = _hull(points)
    if len(hull) < 3:
        return 0.0
    least = math.inf
    for number in range(len(hull)):
        least = min(least, _largest_square(hull, hull[number - 1], hull[number]))
    return math.sqrt(least)


@kernel
def _hull(points: Int64Rows) -> Int64Rows:
    """Return the corners of the convex hull, shape (n, 2), in counterclockwise order (Andrew's monotone chain)."""
    span = np.abs(points).max() + 1
    order = np.argsort(points[:, 0] * 4 * span + points[:, 1])
    hull = np.empty((2 * len(points) + 2, 2), np.int64)
    size = 0
    for turn in range(2):
        floor = size + 1
        for step in range(len(order)):
            point = points[order[step if turn == 0 else len(order) - 1 - step]]
            while size > floor and (
                (hull[size - 1, 0] - hull[size - 2, 0]) * (point[1] - hull[size - 2, 1])
                <= (hull[size - 1, 1] - hull[size - 2, 1]) * (point[0] - hull[size - 2, 0])
            ):
                size -= 1
            hull[size] = point
            size += 1
        size -= 1  # the last point begins the other half
    return hull[:size].copy()
