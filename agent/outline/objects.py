"""Numbered objects in a persistent form: a new version takes time and memory only for the changed objects.

Vertices are in a pool, to which new ones are appended. A version is a table with the place of each object's vertices;
older versions stay valid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.outline.polygons import Polygons, Symbols, vertex_cell
from protocol.arrays import Bools, Int32Rows, Int32s
from protocol.kernels import kernel

FIRST, LENGTH, INSIDE, LEFT, TOP, RIGHT, BOTTOM = range(7)
"""Columns of a table: index of the first vertex in the pool (-1: no such object), number of vertices, whether it is the
inside object, and its bounding box with a margin of one cell."""

_COLUMNS = 7

Table = Int32Rows


@dataclass(frozen=True, eq=False)
class Objects:
    """One version of the numbered objects; versions are compared by identity."""

    shape: tuple[int, int]
    """Height and width of the grid, in cells."""
    table: Table
    """One row for each number, shape (n, 7)."""
    pool: Symbols
    """The vertices."""

    @staticmethod
    def empty(shape: tuple[int, int]) -> Objects:
        """Return no objects."""
        return Objects(shape, np.empty((0, _COLUMNS), np.int32), np.empty(0, np.int32))

    @staticmethod
    def of(polygons: Polygons) -> Objects:
        """Number polygons from 0."""
        table, pool = np.empty((polygons.objects, _COLUMNS), np.int32), polygons.symbols
        for number, inside in enumerate(polygons.inside.tolist()):
            first, end = polygons.start[number : number + 2].tolist()
            enter(table, number, pool, first, end - first, inside)
        return Objects(polygons.shape, table, pool)

    def polygons(self) -> tuple[NDArray[np.int32], Polygons]:
        """Return the numbers in use, ascending, and the objects in this order."""
        number, vertices, start, inside = _in_order(self.table, self.pool)
        return number, Polygons(self.shape, vertices, start, inside)


@kernel
def bounds(vertices: Symbols) -> tuple[int, int, int, int]:
    """Return the bounding box (x0, y0, x1, y1) of vertices, at least one, with a margin of one cell."""
    x0 = y0 = 1 << 20
    x1 = y1 = -1
    for symbol in vertices:
        x, y = vertex_cell(symbol)
        x0, x1 = min(x0, x), max(x1, x)
        y0, y1 = min(y0, y), max(y1, y)
    return x0 - 1, y0 - 1, x1 + 2, y1 + 2


@kernel
def _in_order(table: Table, pool: Symbols) -> tuple[Int32s, Symbols, Int32s, Bools]:
    """Return the numbers in use, and the columns of their polygons."""
    count = 0
    for row in table:
        count += row[FIRST] >= 0
    number, start = np.empty(count, np.int32), np.zeros(count + 1, np.int32)
    inside = np.empty(count, np.bool_)
    count = 0
    for k in range(len(table)):
        if table[k, FIRST] >= 0:
            number[count], inside[count] = k, table[k, INSIDE] != 0
            start[count + 1] = start[count] + table[k, LENGTH]
            count += 1
    vertices = np.empty(start[-1], np.int32)
    for k in range(count):
        first = table[number[k], FIRST]
        vertices[start[k] : start[k + 1]] = pool[first : first + start[k + 1] - start[k]]
    return number, vertices, start, inside


@kernel
def enter(table: Table, number: int, pool: Symbols, first: int, length: int, inside: bool) -> None:
    """Write the row of an object whose vertices, at least one, are in ``pool[first : first + length]``."""
    row = table[number]
    row[FIRST], row[LENGTH], row[INSIDE] = first, length, inside
    row[LEFT], row[TOP], row[RIGHT], row[BOTTOM] = bounds(pool[first : first + length])
