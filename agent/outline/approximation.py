"""Incremental approximation: the coarse polygons that a robot sends to its team (thesis, section 4.2).

An approximation A(t) is a set of marked points of the exact contours P(t); their order and objects follow from P(t). A
vertex that is still a contour point never moves, which keeps updates short. `repair` replaces the cutting and tracing
of section 4.2.1. Its cases become

1. vertices that vanish: their points are not on P(t), and the contour connects their neighbors;
2. edges that no longer fit: they are refined afterwards (`agent.outline.simplify`);
3. new objects: they have no marks, or one after a split of an object, and get the missing ones. Splits, and merges of
   objects, which the thesis does not mention, need nothing else: a mark belongs to the object on which it now lies.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from agent.outline.polygons import SIDE_X, SIDE_Y, Polygons, Symbol, Symbols, place_of
from protocol.arrays import Bools, Int32s, Uint8s
from protocol.kernels import kernel
from protocol.packets import MAX_OBJECTS, MAX_VERTICES

Marks = Int32s
"""An approximation as ascending indices into the flat arrays of its contours."""


def repair(previous: Polygons, contours: Polygons) -> Marks:
    """Adapt the last approximation A(t - 1) to the current exact contours P(t), on grids of one shape (section 4.2.1).

    Returns the vertices of A(t) before refinement: all vertices of A(t - 1) that are still contour points, and more for
    objects with fewer than two. An object without vertices gets its first point; an object with one vertex gets the
    contour point farthest from it (the first of equals).

    Packets can address 4096 objects and 4096 vertices per object. Beyond that, the outside objects with the fewest
    contour points are left out, and objects lose the vertices that deviate least from a straight line.
    """
    height, width = contours.shape
    marked = _workspace((height + 2) * (width + 2))
    chosen = _approximated(contours)
    marks = _collect(previous.symbols, contours.symbols, contours.start, chosen, width + 2, marked)
    if len(marks) > MAX_VERTICES:
        marks = _coarsen(contours, marks)
    return marks


@lru_cache(maxsize=1)
def _workspace(cells: int) -> NDArray[np.uint8]:
    """Return the memory that all repairs on grids of one size share: a bit per side and cell, all 0 between repairs."""
    return np.zeros(cells, np.uint8)


def approximation(contours: Polygons, marks: Marks, *, unknown_pairs: bool = True) -> Polygons:
    """Return the polygons that the marked contour points span.

    An edge represents the contour points from its first vertex up to the one before its second. It is occupied only
    if all of them are (section 4.2.2), so that no unknown cell is reported as explored.

    Without `unknown_pairs`, outside objects of two vertices without an occupied edge are left out.
    """
    columns = contours.symbols, contours.start, contours.inside
    return Polygons(contours.shape, *_span(*columns, marks, unknown_pairs))


def _approximated(contours: Polygons) -> NDArray[np.bool_]:
    """Choose the objects to approximate: all, or if there are too many, the inside one and the longest others."""
    chosen = np.ones(contours.objects, np.bool_)
    surplus = contours.objects - MAX_OBJECTS
    if surplus > 0:
        length = np.diff(contours.start)
        length[contours.inside] = np.iinfo(np.int32).max
        chosen[np.argsort(length[::-1], kind="stable")[:surplus]] = False
        return chosen[::-1].copy()
    return chosen


def _coarsen(contours: Polygons, marks: Marks) -> Marks:
    """Drop from objects beyond the vertex limit the vertices nearest to the line between their neighbors."""
    x, y = 4 * contours.x + SIDE_X[contours.side], 4 * contours.y + SIDE_Y[contours.side]
    borders = np.searchsorted(marks, contours.start)
    kept = np.ones(len(marks), np.bool_)
    for first, end in pairwise(borders.tolist()):
        surplus = end - first - MAX_VERTICES
        if surplus > 0:
            at = marks[first:end]
            before, after = np.roll(at, 1), np.roll(at, -1)
            along_x, along_y = x[after] - x[before], y[after] - y[before]
            area = np.abs(along_x * (y[at] - y[before]) - along_y * (x[at] - x[before]))
            height = area / np.hypot(along_x, along_y)
            kept[first + np.argsort(height, kind="stable")[:surplus]] = False
    return marks[kept]


@kernel
def _farthest(points: Symbols, first: int, end: int, point: int) -> int:
    """Return the point of ``first:end`` that is farthest from `point`, the first of equals."""
    farthest, largest = -1, -1
    from_x, from_y = place_of(points[point])
    for i in range(first, end):
        x, y = place_of(points[i])
        distance = (x - from_x) ** 2 + (y - from_y) ** 2
        if distance > largest:
            farthest, largest = i, distance
    return farthest


@kernel
def _place(symbol: Symbol, row: int) -> int:
    """Return the index of the cell of a vertex on the grid with its border, `row` cells per row."""
    return (symbol >> 15) * row + (symbol >> 3 & 0xFFF)


@kernel
def _collect(
    old: Symbols, points: Symbols, start: Int32s, approximated: Bools, row: int, marked: Uint8s
) -> Int32s:
    """Return the marks of `repair`; `row` is the width of the grid plus 2, `marked` the shared memory."""
    for symbol in old:
        marked[_place(symbol, row)] |= 1 << (symbol >> 1 & 3)
    marks = np.empty(len(old) + 2 * len(approximated), np.int32)
    count = 0
    for k in range(len(approximated)):
        if not approximated[k]:
            continue
        first, end, before = start[k], start[k + 1], count
        # Case 1: vertices that are not found here have vanished.
        for i in range(first, end):
            if marked[_place(points[i], row)] >> (points[i] >> 1 & 3) & 1:
                marks[count] = i
                count += 1
        # Case 3: a new object, and a split that left one vertex.
        if count == before:
            marks[count] = first
            count += 1
        if count == before + 1:
            one = marks[before]
            other = _farthest(points, first, end, one)
            marks[before], marks[before + 1] = min(one, other), max(one, other)
            count += 1
    for symbol in old:
        marked[_place(symbol, row)] = 0
    return marks[:count].copy()


@kernel
def _span(
    points: Symbols, start: Int32s, inside: Bools, marks: Int32s, unknown_pairs: bool
) -> tuple[Symbols, Int32s, Bools]:
    """Return the columns of the polygons (`Polygons`)."""
    span = np.empty(len(marks), np.int32)
    span_start = np.zeros(len(start), np.int32)
    span_inside = np.empty(len(inside), np.bool_)
    m, count, objects = 0, 0, 0
    for k in range(len(inside)):
        first, begin = m, count
        while m < len(marks) and marks[m] < start[k + 1]:
            m += 1
        walls = 0
        for e in range(first, m):
            all_occupied = 1
            for i in range(marks[e], marks[e + 1] if e + 1 < m else start[k + 1]):
                all_occupied &= points[i]
            if e + 1 == m:  # points before the first mark belong to the edge from the last one
                for i in range(start[k], marks[first]):
                    all_occupied &= points[i]
            span[count] = points[marks[e]] & ~1 | all_occupied
            walls += all_occupied
            count += 1
        if count == begin:
            continue
        if not unknown_pairs and not inside[k] and count - begin <= 2 and not walls:
            count = begin
            continue
        span_inside[objects] = inside[k]
        objects += 1
        span_start[objects] = count
    return span[:count].copy(), span_start[: objects + 1].copy(), span_inside[:objects].copy()
