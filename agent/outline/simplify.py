"""Line simplification: where an approximation is refined next (thesis, section 4.3, Algorithm 6).

Douglas-Peucker over all polygons at once, by a priority queue over all edges: the most valuable edge is
split at the contour point farthest from it, its two halves go back into the queue. Two vertices of an
object halve it into two open lines, so the algorithm needs no other beginning. Distances are to the
segment, in exact integers: coordinates count quarters of a cell.
"""

from __future__ import annotations

from collections.abc import Callable
from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from agent.outline.approximation import Marks
from agent.outline.polygons import SIDE_X, SIDE_Y, Polygons
from protocol.kernels import kernel
from protocol.packets import MAX_VERTICES

ValueFunction = Callable[[float, bool], float]
"""What it is worth to split an edge, from the distance of its farthest contour point, in cells, and whether
its occupancy is mixed. A kernel of signature ``float64(float64, boolean)``; larger is sooner."""


@kernel("float64(float64, boolean)")
def by_distance(distance: float, mixed: bool) -> float:  # noqa: ARG001 - the form of a value function
    """Value an edge by its distance alone: the thesis' rule."""
    return distance


@kernel("float64(float64, boolean)")
def mixed_first(distance: float, mixed: bool) -> float:
    """Value edges that stand for occupied and unknown points alike above all others.

    Such an edge counts as unexplored, so it sends teammates to walls that are known.
    """
    return distance + 1e6 if mixed else distance


def refine(
    contours: Polygons, marks: Marks, splits: int | None = None, value: ValueFunction = by_distance
) -> Marks:
    """Split the most valuable edges of an approximation.

    Parameters
    ----------
    contours : Polygons
        The exact contours P(t).
    marks : int32 array, ascending
        The vertices of the approximation, as positions in `contours`; at least two an object.
    splits : int, optional
        How many edges to split; by default until the approximation is exact.
    value : ValueFunction
        Which edge comes first; of equal ones the earlier in the contours.

    Returns
    -------
    int32 array, ascending
        `marks`, and one more for each split: fewer than `splits` where the approximation is exact before.

    Notes
    -----
    It is exact when each edge's contour points lie on it and are all occupied or all unknown. A straight
    edge of mixed occupancy is split where the occupancy first changes. An object of 4096 vertices, the
    most that packets can speak of, is not refined further.
    """
    if splits == 0:
        return marks
    wanted = len(contours.x) if splits is None else splits
    return _refine(
        contours.x, contours.y, contours.side, contours.occupied, contours.start, marks, wanted, value
    )


@kernel(
    "Tuple((float64, int64, boolean))"
    "(int16[::1], int16[::1], uint8[::1], uint8[::1], int64, int64, int64, int64)"
)
def _split_of(
    x: NDArray[np.int16],
    y: NDArray[np.int16],
    side: NDArray[np.uint8],
    occupied: NDArray[np.uint8],
    first: int,
    end: int,
    a: int,
    b: int,
) -> tuple[float, int, bool]:
    """Look at the edge from point `a` to point `b` of the object ``first:end``.

    Returns the distance of the farthest point in cells, where to split (-1: the edge is exact), and
    whether the occupancy is mixed.
    """
    a_x, a_y = 4 * x[a] + SIDE_X[side[a]], 4 * y[a] + SIDE_Y[side[a]]
    edge_x, edge_y = 4 * x[b] + SIDE_X[side[b]] - a_x, 4 * y[b] + SIDE_Y[side[b]] - a_y
    square = edge_x * edge_x + edge_y * edge_y
    farthest, largest, change = -1, 0, -1
    before, i = a, a + 1
    if i == end:
        i = first
    while i != b:
        if change < 0 and occupied[i] != occupied[before]:
            change = i
        p_x, p_y = 4 * x[i] + SIDE_X[side[i]] - a_x, 4 * y[i] + SIDE_Y[side[i]] - a_y
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
    split = farthest if largest > 0 else change
    return np.sqrt(largest / square) / 4, split, change >= 0


@kernel(
    "int32[::1](int16[::1], int16[::1], uint8[::1], uint8[::1], int32[::1], int32[::1], int64, "
    "FunctionType(float64(float64, boolean)))"
)
def _refine(
    x: NDArray[np.int16],
    y: NDArray[np.int16],
    side: NDArray[np.uint8],
    occupied: NDArray[np.uint8],
    start: NDArray[np.int32],
    marks: NDArray[np.int32],
    splits: int,
    value: ValueFunction,
) -> NDArray[np.int32]:
    queue = [(0.0, 0, 0, 0, 0)]  # minus the value, the edge's two points, where to split it, its object
    queue.clear()
    points = marks.astype(np.int64)
    marked = np.zeros(len(x), np.bool_)
    vertices = np.zeros(len(start) - 1, np.int64)
    m = 0
    for k in range(len(start) - 1):
        first = m
        while m < len(marks) and marks[m] < start[k + 1]:
            marked[marks[m]] = True
            m += 1
        vertices[k] = m - first
        for e in range(first, m):
            a, b = points[e], points[e + 1 if e + 1 < m else first]
            distance, split, mixed = _split_of(x, y, side, occupied, start[k], start[k + 1], a, b)
            if split >= 0:
                heappush(queue, (-value(distance, mixed), a, b, split, k))
    while splits > 0 and len(queue) > 0:
        _, a, b, split, k = heappop(queue)
        if vertices[k] >= MAX_VERTICES:
            continue
        marked[split] = True
        vertices[k] += 1
        splits -= 1
        for one, other in ((a, split), (split, b)):
            distance, next_split, mixed = _split_of(x, y, side, occupied, start[k], start[k + 1], one, other)
            if next_split >= 0:
                heappush(queue, (-value(distance, mixed), one, other, next_split, k))
    return np.flatnonzero(marked).astype(np.int32)
