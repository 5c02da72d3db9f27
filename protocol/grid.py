"""Grids, and the cells that the beams of a laser cross.

Grids are ``uint8`` arrays of shape (height, width), indexed ``grid[y, x]``: x to the right, y down, row 0
on top, cell centers at integers. A cell is unknown, free or occupied (thesis, section 3.2).

A beam is a sequence of cells. `ray_table` computes those of all beams once, in exact integer arithmetic, as offsets
from the robot's cell. The laser that casts a scan and the robot that draws it use the same table, so a reading means
the same cells to both, on every machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Int32Rows, Int32s, Int64Rows, Int64s
from protocol.errors import ProtocolError
from protocol.kernels import kernel

UNKNOWN = 0
FREE = 1
OCCUPIED = 2

FINE = 1000
"""Units per cell of positions finer than cells: way points, and offsets from the center of a cell."""

HEADINGS = 8
"""Headings per full turn; heading 0 points along +x, 2 along +y."""

MAX_SIDE = 2048
"""The longest side of a grid, in cells; packets cannot represent a longer one."""

MAX_ROBOTS = 256
"""The largest team. Offers can name the maps of fewer robots (`protocol.packets.MAX_MAPS`)."""

Grid = Annotated[NDArray[np.uint8], "uint8[:,::1]"]
"""States of cells, or other small numbers, indexed ``grid[y, x]``."""

ReadOnlyGrid = Annotated[NDArray[np.uint8], "Array(uint8, 2, 'C', readonly=True)"]
"""A grid that a kernel does not write, so that read-only arrays fit."""

Mask = NDArray[np.bool_]
"""A flag for each cell of a grid, indexed ``mask[y, x]``."""

Cell = tuple[int, int]
"""Column and row of a cell."""

Point = tuple[int, int]
"""A position (x, y) in 1 / `FINE` cell; the center of cell (0, 0) is at (0, 0)."""

_REACH = 0.5
"""Half the side of a cell, in cells."""

_DIRECTION_UNIT = 1 << 20
"""Length of the integer vectors that stand for beam directions; rounding hides differences between platforms."""


@dataclass(frozen=True, eq=False)
class RayTable:
    """The cells that each beam crosses, nearest first, relative to the robot's cell."""

    cells: NDArray[np.int32]
    """Offsets (dx, dy) in cells, shape (n, 2): all beams concatenated, without the robot's cell."""
    start: NDArray[np.int32]
    """Shape (beams + 1,): beam ``b`` crosses ``cells[start[b]:start[b + 1]]``."""

    def flat(self, width: int) -> NDArray[np.int32]:
        """Return the same offsets as index differences in a flattened grid of `width` columns; int32 of shape (n,)."""
        return _flat(self, width)

    @cached_property
    def shared(self) -> NDArray[np.int32]:
        """Number of cells that each beam shares with the beam before it, from the robot on; shape (beams,)."""
        return _count_shared(self.cells, self.start)

    @property
    def beams(self) -> int:
        """Number of beams in a full turn."""
        return len(self.start) - 1


@lru_cache(maxsize=16)
def _flat(beams: RayTable, width: int) -> NDArray[np.int32]:
    return beams.cells[:, 1] * np.int32(width) + beams.cells[:, 0]


@kernel
def _count_shared(cells: Int32Rows, start: Int32s) -> Int32s:
    """Count the cells that each beam shares with the beam before it, from the robot on."""
    shared = np.zeros(len(start) - 1, np.int32)
    for beam in range(1, len(shared)):
        before, here, end = start[beam - 1], start[beam], start[beam + 1]
        both = min(here - before, end - here)
        while (
            shared[beam] < both
            and cells[before + shared[beam], 0] == cells[here + shared[beam], 0]
            and cells[before + shared[beam], 1] == cells[here + shared[beam], 1]
        ):
            shared[beam] += 1
    return shared


@lru_cache(maxsize=16)
def ray_table(range_cells: float, beams: int = 360) -> RayTable:
    """Compute the cells of `beams` beams, evenly spaced over a full turn, over the grid.

    Beam 0 points along +x, angles grow towards +y (clockwise on a picture). A beam ends before the first cell whose
    center lies beyond `range_cells`, the sensor range in cells, or at a distance of the diagonal of the largest grid.
    It moves between 4-neighbors only, so it does not pass between two cells that touch at a corner; exactly through a
    corner it crosses the neighbor in x first.

    Raises ValueError for a range below one cell, or a number of beams that is no positive multiple of 4.
    """
    if not range_cells >= 1:
        raise ValueError(f"sensor range of {range_cells:g} cells: a robot must see at least its neighbors")
    if beams < 4 or beams % 4:
        raise ValueError(f"{beams} beams: give a multiple of 4, so that the four neighbors are always seen")
    reach = min(range_cells, math.hypot(MAX_SIDE, MAX_SIDE))
    angles = [2 * math.pi * beam / beams for beam in range(beams)]
    directions = [
        (round(math.cos(angle) * _DIRECTION_UNIT), round(math.sin(angle) * _DIRECTION_UNIT))
        for angle in angles
    ]
    return RayTable(*_walk(np.array(directions, np.int64), reach))


@kernel
def _walk(directions: Int64Rows, range_cells: float) -> tuple[Int32Rows, Int32s]:
    """Walk from cell (0, 0) along each direction; return the crossed cells, and the first index of each direction."""
    most = int(math.sqrt(2) * range_cells) + 2
    cells = np.empty((len(directions) * most, 2), np.int32)
    start = np.zeros(len(directions) + 1, np.int32)
    for beam in range(len(directions)):
        along_x, along_y = abs(directions[beam, 0]), abs(directions[beam, 1])
        step_x, step_y = (1 if directions[beam, 0] > 0 else -1), (1 if directions[beam, 1] > 0 else -1)
        x = y = 0
        end = start[beam]
        while True:
            # The beam crosses the next border in x at (2 |x| + 1) / (2 along_x), in y likewise: cross-multiplied.
            if along_y == 0 or (along_x > 0 and (2 * abs(x) + 1) * along_y <= (2 * abs(y) + 1) * along_x):
                x += step_x
            else:
                y += step_y
            if x * x + y * y > range_cells * range_cells:
                break
            cells[end] = x, y
            end += 1
        start[beam + 1] = end
    return cells[: start[-1]].copy(), start


def cell_of(point: Point) -> Cell:
    """Return the cell of a point; a border belongs to the cell on its right, or below."""
    return (point[0] + FINE // 2) // FINE, (point[1] + FINE // 2) // FINE


def disc(radius_cells: float) -> Mask:
    """Return the cells that a disc-shaped robot in the middle cell touches, as a square mask."""
    side = np.arange(-int(radius_cells + _REACH), int(radius_cells + _REACH) + 1)
    return side[:, None] ** 2 + side[None, :] ** 2 < (radius_cells + _REACH) ** 2


def enlarge(grid: Grid, radius_cells: float) -> Grid:
    """Return the grid with obstacles enlarged by a robot's radius: free cells are those where its center may be.

    With a radius of at most half a cell, or without obstacles, the grid itself is returned.
    """
    if radius_cells <= _REACH or not (grid == OCCUPIED).any():
        return grid
    grown = np.array(grid, order="C")
    widths = (np.count_nonzero(disc(radius_cells), axis=1) - 1) // 2
    _grow(np.ascontiguousarray(grid), widths, grown)
    return grown


@kernel
def _grow(grid: ReadOnlyGrid, widths: Int64s, out: Grid) -> None:
    """Turn free cells of `out` within a disc around an occupied cell of `grid` into occupied ones.

    `widths`: for each row of the disc, how many cells it extends to either side; -1: the row has none. Only cells at
    the border of obstacles are visited: they are nearest to the cells around.
    """
    height, width = grid.shape
    reach = len(widths) // 2
    for y in range(height):
        for x in range(width):
            if grid[y, x] != OCCUPIED or (
                0 < x < width - 1
                and 0 < y < height - 1
                and grid[y, x - 1] == grid[y, x + 1] == grid[y - 1, x] == grid[y + 1, x] == OCCUPIED
            ):
                continue
            for row in range(max(0, y - reach), min(height, y + reach + 1)):
                side = widths[row - y + reach]
                for column in range(max(0, x - side), min(width, x + side + 1)):
                    if out[row, column] == FREE:
                        out[row, column] = OCCUPIED


def check_cell(what: str, x: int, y: int, grid: Grid) -> None:
    """Raise ProtocolError, which names `what` was received, if a cell lies outside a grid."""
    height, width = grid.shape
    if not (0 <= x < width and 0 <= y < height):
        raise ProtocolError(what, 0, f"cell ({x}, {y}) is outside the {width} x {height} grid")
