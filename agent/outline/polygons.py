"""Polygons: the geometric model of an explored environment (thesis, section 3.4).

One form serves the exact contours of a grid and every approximation of them, a robot's own and its
teammates'. A polygon is an object: the one *inside* object encloses the free space and all else, each
*outside* object stands in it and encloses what is occupied or unknown. Vertices run with the object on
the left as one moves along (counterclockwise around an outside object on a picture with y down).

A vertex is a contour point: a non-free cell and the side on which its free neighbour lies. It stands a
quarter of a cell off the cell's centre towards that neighbour, so that contours which share a cell do not
touch. Cells run from -1, for one unknown cell is thought around the grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BELOW, RIGHT, ABOVE, LEFT = 0, 1, 2, 3
"""Sides of a cell, in the order in which a contour goes around it; the next one lies to the left."""

SIDE_X = np.array([0, 1, 0, -1], np.int64)
SIDE_Y = np.array([1, 0, -1, 0], np.int64)
"""Where the free neighbour on each side lies; also a vertex's offset from its centre, in quarter cells."""


@dataclass(frozen=True, eq=False)
class Polygons:
    """A set of closed polygons, all vertices in flat arrays behind each other.

    Attributes
    ----------
    shape : (int, int)
        Height and width of the grid that they speak of, in cells.
    x, y : int16 arrays of shape (n,)
        Cell of each vertex.
    side : uint8 array of shape (n,)
        Side of the cell on which the vertex stands: `BELOW`, `RIGHT`, `ABOVE` or `LEFT`.
    occupied : uint8 array of shape (n,)
        Of exact contours: 1 where the vertex' cell is occupied, 0 where it is unknown. Of approximations: 1
        where the edge from this vertex to the next is occupied, else it is free (inside object) or unknown.
    start : int32 array of shape (objects + 1,)
        Object ``k`` has the vertices ``start[k]:start[k + 1]``.
    inside : bool array of shape (objects,)
        Whether the object encloses the free space.
    """

    shape: tuple[int, int]
    x: NDArray[np.int16]
    y: NDArray[np.int16]
    side: NDArray[np.uint8]
    occupied: NDArray[np.uint8]
    start: NDArray[np.int32]
    inside: NDArray[np.bool_]

    @staticmethod
    def nothing(shape: tuple[int, int]) -> Polygons:
        """Return the model in which nothing is explored: no objects."""
        none16, none8 = np.empty(0, np.int16), np.empty(0, np.uint8)
        return Polygons(shape, none16, none16, none8, none8, np.zeros(1, np.int32), np.empty(0, np.bool_))

    @property
    def objects(self) -> int:
        """How many polygons there are."""
        return len(self.inside)

    def canonical(self) -> list[tuple[bool, tuple[tuple[int, int, int, int], ...]]]:
        """Return the polygons in a form that is equal for equal models.

        Each object is (inside, cycle of (x, y, side, occupied)) with the smallest vertex first, the objects
        sorted: neither their order nor where their lists begin carries meaning.
        """
        cycles = []
        for k in range(self.objects):
            part = slice(self.start[k], self.start[k + 1])
            columns = (self.x[part], self.y[part], self.side[part], self.occupied[part])
            cycle = list(zip(*(column.tolist() for column in columns), strict=True))
            first = cycle.index(min(cycle)) if cycle else 0
            cycles.append((bool(self.inside[k]), tuple(cycle[first:] + cycle[:first])))
        return sorted(cycles)
