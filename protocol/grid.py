"""The shared definitions of cells, frames and beams.

Grids are ``uint8`` arrays of shape (height, width), indexed ``grid[y, x]``: x to the right, y down, row 0
on top, cell centres at integers. A cell is unknown, free or occupied (thesis, section 3.2).

A beam is a sequence of cells. `ray_table` computes the sequences of all beams once, in exact integer arithmetic, as
offsets from the robot's cell; the laser that casts a scan and the robot that draws it use the same table, so
that a reading stands for the same cells to both, on every machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from protocol.kernels import kernel

UNKNOWN = 0
FREE = 1
OCCUPIED = 2

MAX_SIDE = 2048
"""The largest side of a grid, in cells, that the packets can represent."""

MAX_ROBOTS = 256
"""The largest team. Packets can name the maps of fewer (`protocol.packets.MAX_MAPS`)."""

Grid = NDArray[np.uint8]

_REACH = 0.5
"""A cell extends half a cell from its centre."""

_DIRECTION_UNIT = 1 << 20
"""Beam directions are integer vectors of this length, so that no platform's cosine affects a cell."""


@dataclass(frozen=True, eq=False)
class RayTable:
    """The cells that each beam crosses, nearest first, relative to the robot's own cell.

    Attributes
    ----------
    cells : int32 array of shape (n, 2)
        Offsets (dx, dy) in cells, all beams concatenated; the robot's own cell is left out.
    start : int32 array of shape (beams + 1,)
        Beam ``b`` crosses ``cells[start[b]:start[b + 1]]``.
    """

    cells: NDArray[np.int32]
    start: NDArray[np.int32]

    def flat(self, width: int) -> NDArray[np.int32]:
        """The same cells as steps in a grid of so many columns that lies flat, row after row."""
        return _flat(self, width)

    @property
    def shared(self) -> NDArray[np.int32]:
        """How many cells each beam has in common with the one before it, from the robot on; shape (beams,)."""
        return _shared(self)

    @property
    def beams(self) -> int:
        """Number of beams in a full turn."""
        return len(self.start) - 1


@lru_cache(maxsize=16)
def _flat(beams: RayTable, width: int) -> NDArray[np.int32]:
    steps: NDArray[np.int32] = beams.cells[:, 1] * np.int32(width) + beams.cells[:, 0]
    return steps


@lru_cache(maxsize=16)
def _shared(beams: RayTable) -> NDArray[np.int32]:
    shared: NDArray[np.int32] = _count_shared(beams.cells, beams.start)
    return shared


@kernel("int32[::1](int32[:,::1], int32[::1])")
def _count_shared(cells: NDArray[np.int32], start: NDArray[np.int32]) -> NDArray[np.int32]:
    """How many cells each beam's walk has in common with the one before it, from its begin on."""
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
    """Compute the cells of `beams` beams over the grid.

    Parameters
    ----------
    range_cells : float
        Sensor range in cells; a beam ends before the first cell whose centre lies beyond it, and at the
        latest at the border of the largest grid.
    beams : int
        Beams a full turn. Beam 0 points along +x, the angle grows towards +y (clockwise on a picture).

    Notes
    -----
    A beam moves between 4-neighbours only, so that it does not pass between two cells that touch at a corner. A beam
    that runs exactly through a corner crosses the neighbour in x first.
    """
    if not range_cells >= 1:
        raise ValueError(f"sensor range of {range_cells:g} cells: a robot must see at least its neighbours")
    if beams < 4 or beams % 4:
        raise ValueError(f"{beams} beams: give a multiple of 4, so that the four neighbours are always seen")
    reach = min(range_cells, math.hypot(MAX_SIDE, MAX_SIDE))
    angles = [2 * math.pi * beam / beams for beam in range(beams)]
    directions = [
        (round(math.cos(angle) * _DIRECTION_UNIT), round(math.sin(angle) * _DIRECTION_UNIT))
        for angle in angles
    ]
    return RayTable(*_walk(np.array(directions, np.int64), reach))


@kernel("Tuple((int32[:,::1], int32[::1]))(int64[:,::1], float64)")
def _walk(directions: NDArray[np.int64], range_cells: float) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Cells along each direction from the centre of (0, 0), that cell left out; and where those of each begin."""
    most = int(math.sqrt(2) * range_cells) + 2
    cells = np.empty((len(directions) * most, 2), np.int32)
    start = np.zeros(len(directions) + 1, np.int32)
    for beam in range(len(directions)):
        along_x, along_y = abs(directions[beam, 0]), abs(directions[beam, 1])
        step_x, step_y = (1 if directions[beam, 0] > 0 else -1), (1 if directions[beam, 1] > 0 else -1)
        x = y = 0
        end = start[beam]
        while True:
            # The next border in x is crossed at (2 |x| + 1) / (2 along_x), in y likewise: cross-multiplied.
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


def disc(radius_cells: float) -> NDArray[np.bool_]:
    """Return the cells that a disc-shaped robot touches when it stands on the middle one, as a square mask."""
    side = np.arange(-int(radius_cells + _REACH), int(radius_cells + _REACH) + 1)
    touched: NDArray[np.bool_] = side[:, None] ** 2 + side[None, :] ** 2 < (radius_cells + _REACH) ** 2
    return touched


def enlarge(grid: Grid, radius_cells: float) -> Grid:
    """Return the grid with obstacles enlarged by a robot's radius: cells where its centre may be are free.

    With a radius of half a cell or less, or without obstacles, nothing changes, and the grid itself is returned.
    """
    if radius_cells <= _REACH:
        return grid
    from scipy import ndimage  # noqa: PLC0415  slow to import, and few need it

    solid = grid == OCCUPIED
    if not solid.any():
        return grid
    away = np.rint(ndimage.distance_transform_edt(~solid) ** 2)
    grown = grid.copy()
    grown[(away < (radius_cells + _REACH) ** 2) & (grid == FREE)] = OCCUPIED
    return grown
