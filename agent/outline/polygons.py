"""Polygons: the geometric model of an explored environment (thesis, section 3.4).

One form serves the exact contours of a grid and all approximations of them. A polygon is called an object: the one
*inside* object encloses the free space and all other objects; each *outside* object encloses occupied or unknown cells
within the free space. Along its vertices the object lies on the left (counterclockwise around an outside object on a
picture with y down).

A vertex is a contour point: a non-free cell, and the side on which its free neighbor lies. It is a quarter of a cell
off the cell's center towards that neighbor, so contours that share a cell do not touch. Cell coordinates start at -1,
because the grid has a border of one unknown cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Int32s
from protocol.grid import Cell
from protocol.kernels import kernel

BELOW, RIGHT, ABOVE, LEFT = 0, 1, 2, 3
"""Sides of a cell, in the order of a contour around it; each next side is reached by a turn to the left."""

SIDE_X = np.array([0, 1, 0, -1], np.int64)
SIDE_Y = np.array([1, 0, -1, 0], np.int64)
"""Direction of the neighbor on each side; also a vertex' offset from the center of its cell, in quarters of a cell."""

Symbol = Annotated[int, "int32"]
"""A vertex as a number: from the highest bits y + 1 and x + 1 of its cell (12 bits), side (2), whether occupied (1)."""
Symbols = Int32s


@dataclass(frozen=True, eq=False)
class Polygons:
    """A set of closed polygons, whose vertices are concatenated in flat arrays."""

    shape: tuple[int, int]
    """Height and width of the grid, in cells."""
    symbols: Symbols
    """The vertices, shape (n,), each as a number (`Symbol`). A vertex of an exact contour is occupied if its cell is,
    else the cell is unknown. That of an approximation is occupied if the edge to the next vertex is, else the edge is
    free (inside object) or unknown (outside object)."""
    start: NDArray[np.int32]
    """Object ``k`` has the vertices ``start[k]:start[k + 1]``; shape (objects + 1,)."""
    inside: NDArray[np.bool_]
    """Whether the object encloses the free space, shape (objects,)."""

    @staticmethod
    def empty(shape: tuple[int, int]) -> Polygons:
        """Return no objects: an unexplored environment."""
        return Polygons(shape, np.empty(0, np.int32), np.zeros(1, np.int32), np.empty(0, np.bool_))

    @property
    def objects(self) -> int:
        """Number of polygons."""
        return len(self.inside)

    @property
    def x(self) -> NDArray[np.int32]:
        """Column of the cell of each vertex, shape (n,)."""
        return (self.symbols >> 3 & 0xFFF) - 1

    @property
    def y(self) -> NDArray[np.int32]:
        """Row of the cell of each vertex, shape (n,)."""
        return (self.symbols >> 15) - 1

    @property
    def side(self) -> NDArray[np.int32]:
        """Side of its cell, shape (n,): `BELOW`, `RIGHT`, `ABOVE` or `LEFT`."""
        return self.symbols >> 1 & 3

    @property
    def occupied(self) -> NDArray[np.int32]:
        """1 for occupied vertices, else 0, shape (n,)."""
        return self.symbols & 1


@kernel
def vertex_cell(symbol: Symbol) -> Cell:
    """Return the cell (x, y) of a vertex."""
    return (symbol >> 3 & 0xFFF) - 1, (symbol >> 15) - 1


@kernel
def place_of(symbol: Symbol) -> tuple[int, int]:
    """Return the position of a vertex, in quarters of a cell."""
    (x, y), side = vertex_cell(symbol), symbol >> 1 & 3
    return 4 * x + SIDE_X[side], 4 * y + SIDE_Y[side]
