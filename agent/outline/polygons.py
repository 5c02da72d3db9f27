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

import numpy as np
from numpy.typing import NDArray

BELOW, RIGHT, ABOVE, LEFT = 0, 1, 2, 3
"""Sides of a cell, in the order of a contour around it; each next side is reached by a turn to the left."""

SIDE_X = np.array([0, 1, 0, -1], np.int64)
SIDE_Y = np.array([1, 0, -1, 0], np.int64)
"""Direction of the neighbor on each side; also a vertex' offset from the center of its cell, in quarters of a cell."""


@dataclass(frozen=True, eq=False)
class Polygons:
    """A set of closed polygons, whose vertices are concatenated in flat arrays."""

    shape: tuple[int, int]
    """Height and width of the grid, in cells."""
    x: NDArray[np.int16]
    y: NDArray[np.int16]
    """`x`, `y`, shape (n,): cell of each vertex."""
    side: NDArray[np.uint8]
    """Side of the cell, shape (n,): `BELOW`, `RIGHT`, `ABOVE` or `LEFT`."""
    occupied: NDArray[np.uint8]
    """In exact contours, shape (n,): 1 if the vertex' cell is occupied, 0 if it is unknown. In approximations: 1 if the
    edge from this vertex to the next is occupied, 0 if it is free (inside object) or unknown (outside object)."""
    start: NDArray[np.int32]
    """Object ``k`` has the vertices ``start[k]:start[k + 1]``; shape (objects + 1,)."""
    inside: NDArray[np.bool_]
    """Whether the object encloses the free space, shape (objects,)."""

    @staticmethod
    def empty(shape: tuple[int, int]) -> Polygons:
        """Return no objects: an unexplored environment."""
        none16, none8 = np.empty(0, np.int16), np.empty(0, np.uint8)
        return Polygons(shape, none16, none16, none8, none8, np.zeros(1, np.int32), np.empty(0, np.bool_))

    @property
    def objects(self) -> int:
        """Number of polygons."""
        return len(self.inside)
