"""Where Algorithm 3 of the thesis starts each object.

The algorithm keeps all contour points in an array, at first in scan order. An object starts at the first point of the
array. Each point of the object is then removed: the last point of the array takes its place. So all objects but the
first start at points that depend on the objects before, and a start moves when any of these changes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agent.outline.polygons import Polygons, Symbols
from protocol.arrays import Int32s, Int64s
from protocol.kernels import kernel


def extracted(contours: Polygons) -> Polygons:
    """Return exact contours whose objects start where Algorithm 3 starts them; the order of objects stays."""
    order = _extraction_order(contours.symbols, contours.start)
    return replace(contours, symbols=contours.symbols[order])


@kernel
def _extraction_order(points: Symbols, start: Int32s) -> Int64s:
    """Return for each place in the rotated contours the point that moves there."""
    left = len(points)
    array = np.argsort(points)
    place = np.empty(left, np.int64)
    for i in range(left):
        place[array[i]] = i
    owner = np.empty(left, np.int32)
    for k in range(len(start) - 1):
        owner[start[k] : start[k + 1]] = k
    order = np.empty(left, np.int64)
    while left > 0:
        point = array[0]
        k = owner[point]
        for i in range(start[k], start[k + 1]):
            order[i] = point
            left -= 1
            last = array[left]
            array[place[point]] = last
            place[last] = place[point]
            point = point + 1 if point + 1 < start[k + 1] else start[k]
    return order
