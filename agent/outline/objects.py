"""Numbered objects in a persistent form: a new version takes time and memory only for the changed objects.

Vertices are in a pool, to which new ones are appended. A version is a table with the place of each object's vertices;
older versions stay valid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from agent.outline.polygons import Polygons
from protocol.arrays import Bools, Int16s, Int32Rows, Int32s, Uint8s
from protocol.kernels import kernel

FIRST, LENGTH, INSIDE, LEFT, TOP, RIGHT, BOTTOM = range(7)
"""Columns of a table: index of the first vertex in the pool (-1: no such object), number of vertices, whether it is the
inside object, and its bounding box with a margin of one cell."""

_COLUMNS = 7

Table = Int32Rows
Symbols = Int32s
Symbol = Annotated[int, "int32"]


@dataclass(frozen=True, eq=False)
class Objects:
    """One version of the numbered objects; versions are compared by identity."""

    shape: tuple[int, int]
    """Height and width of the grid, in cells."""
    table: Table
    """One row for each number, shape (n, 7)."""
    pool: Symbols
    """Vertices as symbols: from the highest bits y + 1, x + 1 (12 bits), side (2), occupancy of the edge (1)."""

    @staticmethod
    def empty(shape: tuple[int, int]) -> Objects:
        """Return no objects."""
        return Objects(shape, np.empty((0, _COLUMNS), np.int32), np.empty(0, np.int32))

    @staticmethod
    def of(polygons: Polygons) -> Objects:
        """Number polygons from 0."""
        table, pool = np.empty((polygons.objects, _COLUMNS), np.int32), symbols(polygons)
        for number, inside in enumerate(polygons.inside.tolist()):
            first, end = polygons.start[number : number + 2].tolist()
            enter(table, number, pool, first, end - first, inside)
        return Objects(polygons.shape, table, pool)

    def polygons(self) -> tuple[NDArray[np.int32], Polygons]:
        """Return the numbers in use, ascending, and the objects in this order."""
        number, x, y, side, occupied, start, inside = _unpack(self.table, self.pool)
        return number, Polygons(self.shape, x, y, side, occupied, start, inside)


def symbols(polygons: Polygons) -> Symbols:
    """Pack each vertex into one number (`Objects.pool`)."""
    packed: Symbols = _pack(polygons.x, polygons.y, polygons.side, polygons.occupied)
    return packed


@kernel
def _pack(x: Int16s, y: Int16s, side: Uint8s, occupied: Uint8s) -> Symbols:
    packed = np.empty(len(x), np.int32)
    for i in range(len(x)):
        packed[i] = (np.int32(y[i]) + 1 << 12 | np.int32(x[i]) + 1) << 3 | side[i] << 1 | occupied[i]
    return packed


@kernel
def cell_of(symbol: Symbol) -> tuple[int, int]:
    """Return the cell (x, y) of a vertex."""
    return (symbol >> 3 & 0xFFF) - 1, (symbol >> 15) - 1


@kernel
def bounds(vertices: Symbols) -> tuple[int, int, int, int]:
    """Return the bounding box (x0, y0, x1, y1) of vertices, at least one, with a margin of one cell."""
    x0 = y0 = 1 << 20
    x1 = y1 = -1
    for symbol in vertices:
        x, y = cell_of(symbol)
        x0, x1 = min(x0, x), max(x1, x)
        y0, y1 = min(y0, y), max(y1, y)
    return x0 - 1, y0 - 1, x1 + 2, y1 + 2


@kernel
def unpack(vertices: Symbols) -> tuple[Int16s, Int16s, Uint8s, Uint8s]:
    """Return x, y, side and occupancy of packed vertices."""
    n = len(vertices)
    x, y = np.empty(n, np.int16), np.empty(n, np.int16)
    side, occupied = np.empty(n, np.uint8), np.empty(n, np.uint8)
    for i in range(n):
        symbol = vertices[i]
        x[i], y[i] = cell_of(symbol)
        side[i] = symbol >> 1 & 3
        occupied[i] = symbol & 1
    return x, y, side, occupied


@kernel
def _unpack(table: Table, pool: Symbols) -> tuple[Int32s, Int16s, Int16s, Uint8s, Uint8s, Int32s, Bools]:
    """Return the numbers in use, and the columns of their polygons."""
    count = 0
    for row in table:
        count += row[FIRST] >= 0
    number, start, inside = (
        np.empty(count, np.int32),
        np.zeros(count + 1, np.int32),
        np.empty(count, np.bool_),
    )
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
    return number, *unpack(vertices), start, inside


@kernel
def enter(table: Table, number: int, pool: Symbols, first: int, length: int, inside: bool) -> None:
    """Write the row of an object whose vertices, at least one, are in ``pool[first : first + length]``."""
    row = table[number]
    row[FIRST], row[LENGTH], row[INSIDE] = first, length, inside
    row[LEFT], row[TOP], row[RIGHT], row[BOTTOM] = bounds(pool[first : first + length])
