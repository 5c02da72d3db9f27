"""Refinement of an approximation by line simplification (thesis, section 4.3, Algorithm 6).

This is the Douglas-Peucker algorithm over all polygons at once. A priority queue holds all edges: the most valuable
edge (`agent.outline.edge_value`) is split at the contour point farthest from it, and its two halves are queued. An
object has at least two vertices, which divide it into two open lines to start with. Distances are to the segment, in
exact integers: coordinates count quarters of a cell.
"""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np

from agent.encoding_options import ValueFunction
from agent.outline.approximation import Marks
from agent.outline.edge_value import VALUE_FUNCTIONS, edge_value
from agent.outline.polygons import Polygons, Symbols, place_of
from protocol.arrays import Int32s
from protocol.kernels import kernel
from protocol.packets import MAX_VERTICES

_WORTH_OF_MIXED = 1e6
"""Added to the value of an edge of mixed occupancy that is refined first, in cells."""


def refine(
    contours: Polygons,
    marks: Marks,
    splits: int | None = None,
    *,
    mixed_first: bool = False,
    value_function: ValueFunction = "segment-distance",
) -> Marks:
    """Split the most valuable edges of an approximation, whose `marks` are vertices, at least two per object.

    By default the edge is split first whose farthest contour point is farthest, as in the thesis; of equal edges the
    one that is earlier in the contours. With `mixed_first`, edges with occupied and unknown contour points come before
    all others: teammates take such an edge for unexplored and drive to a wall that is already known.

    Returns the marks, and one more for each of at most `splits` splits (None: no limit) until the approximation is
    exact: the contour points of each edge lie on it and are all occupied or all unknown. A straight edge of mixed
    occupancy is split where the occupancy first changes. An object of 4096 vertices, the most that packets can address,
    is not refined further.
    """
    if splits == 0:
        return marks
    value_of = VALUE_FUNCTIONS.index(value_function), _WORTH_OF_MIXED if mixed_first else 0.0
    most = len(contours.symbols) if splits is None else splits
    refined: Marks = _refine(contours.symbols, contours.start, marks, most, value_of)
    return refined


_Contours = tuple[Int32s, Int32s, Symbols, Int32s]
"""All contour points: x and y in quarters of a cell, the points as symbols, and the start of each object."""

_ValueOf = tuple[int, float]
"""Index of the value function, and the worth of an edge of mixed occupancy."""


@kernel
def _split_of(contours: _Contours, k: int, a: int, b: int) -> tuple[float, int, bool]:
    """Find the split of the edge from point `a` to point `b` of object `k`.

    Returns the distance of the farthest point in cells, the index of the split point (-1: the edge is exact), and
    whether the occupancy is mixed.
    """
    x, y, points, start = contours
    first, end = start[k], start[k + 1]
    i = a + 1 if a + 1 < end else first
    if i == b:
        return 0.0, -1, False
    a_x, a_y = np.int64(x[a]), np.int64(y[a])
    edge_x, edge_y = x[b] - a_x, y[b] - a_y
    square = edge_x * edge_x + edge_y * edge_y
    farthest, largest, change = -1, 0, -1
    before = a
    while i != b:
        if change < 0 and (points[i] ^ points[before]) & 1:
            change = i
        p_x, p_y = x[i] - a_x, y[i] - a_y
        along = p_x * edge_x + p_y * edge_y
        if along <= 0:
            distance = (p_x * p_x + p_y * p_y) * square
        elif along >= square:
            distance = ((p_x - edge_x) * (p_x - edge_x) + (p_y - edge_y) * (p_y - edge_y)) * square
        else:
            across = p_x * edge_y - p_y * edge_x
            distance = across * across
        if distance > largest:
            farthest, largest = i, distance
        before = i
        i += 1
        if i == end:
            i = first
    if farthest < 0:
        return 0.0, change, change >= 0
    return np.sqrt(largest / square) / 4, farthest, change >= 0


@kernel
def _rated_split(contours: _Contours, k: int, a: int, b: int, value_of: _ValueOf) -> tuple[float, int]:
    """Return the value of an edge, and its split as `_split_of` does."""
    value, split, mixed = _split_of(contours, k, a, b)
    x, y, _, start = contours
    function, worth_of_mixed = value_of
    if split >= 0 and function > 0:
        value = edge_value(function, x, y, start[k], start[k + 1], a, b)
    return value + worth_of_mixed if mixed else value, split


@kernel
def _refine(points: Symbols, start: Int32s, marks: Int32s, splits: int, value_of: _ValueOf) -> Int32s:
    """Split at most `splits` edges."""
    x, y = np.empty(len(points), np.int32), np.empty(len(points), np.int32)
    for i in range(len(points)):
        x[i], y[i] = place_of(points[i])
    contours = x, y, points, start
    marked = np.zeros(len(x), np.bool_)
    vertices = np.zeros(len(start) - 1, np.int64)
    worth = np.empty(len(marks))  # values of the edges that are not exact
    edges = np.empty((len(marks), 4), np.int64)
    count = 0
    most = 0
    m = 0
    for k in range(len(start) - 1):
        begin = m
        while m < len(marks) and marks[m] < start[k + 1]:
            marked[marks[m]] = True
            m += 1
        vertices[k] = m - begin
        most = max(most, vertices[k])
        if vertices[k] >= MAX_VERTICES:
            continue
        for e in range(begin, m):
            a, b = marks[e], marks[e + 1 if e + 1 < m else begin]
            value, split = _rated_split(contours, k, a, b, value_of)
            if split >= 0:
                worth[count] = value
                edges[count, 0], edges[count, 1], edges[count, 2], edges[count, 3] = a, b, split, k
                count += 1

    # At most `splits` of the present edges are split: queue only the most valuable ones.
    least = np.full(1, -np.inf)
    if splits < count and most + splits <= MAX_VERTICES:
        least = np.partition(worth[:count], count - splits)[count - splits :]
    queue = [(0.0, 0, 0, 0, 0)]  # negative value, end points of the edge, split point, object
    queue.clear()
    for e in range(count):
        if worth[e] >= least[0]:
            heappush(queue, (-worth[e], edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]))
    while splits > 0 and len(queue) > 0:
        _, a, b, split, k = heappop(queue)
        if vertices[k] >= MAX_VERTICES:
            continue
        marked[split] = True
        vertices[k] += 1
        splits -= 1
        for one, other in ((a, split), (split, b)):
            value, next_split = _rated_split(contours, k, one, other, value_of)
            if next_split >= 0:
                heappush(queue, (-value, one, other, next_split, k))
    return np.flatnonzero(marked).astype(np.int32)
