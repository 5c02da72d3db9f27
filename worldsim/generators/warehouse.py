"""A warehouse: parallel racks, aisles, cross aisles, docks with trailers, and pallets.

The layout is that of Roodbergen and de Koster (Routing methods for warehouses with multiple cross aisles, 2001): racks
in blocks, between them picking aisles, and cross aisles between the blocks.
"""

from __future__ import annotations

import math

import numpy as np

from protocol.grid import OCCUPIED, Grid
from worldsim.generators.clutter import cluttered
from worldsim.generators.drawing import Points, carve, wall_thickness
from worldsim.generators.floorplan import Box, inside

RACK_M, BAY_M = 2.2, 2.7
"""Depth of two racks back to back, and length of a bay of them, in meters."""
AISLE_M = (2.4, 3.4)
"""Range of the drawn width of aisles, in meters; what is left of the hall's width is added to all of them."""
CROSS_M, BLOCK_M = 3.0, 13.0
"""Width of cross aisles, and length of the longest block of racks, in meters."""
STAGING_M = 6.0
"""Depth of the area before the docks, in meters."""
TRAILER_M, DOCK_M = (2.5, 4.0), 4.5
"""Width and depth of a trailer, and distance of docks, in meters."""

PALLET_M = (1.2, 0.8)
"""Sides of a pallet, in meters (EN 13698-1)."""
PALLET_RADIUS_M = math.hypot(*PALLET_M) / 2
"""Distance of a pallet's corners from its center, in meters."""


def _pallet(random: np.random.Generator) -> Points:
    """Return a pallet along one of the axes, with corners on the circle of radius 1."""
    length, width = PALLET_M if random.random() < 0.5 else PALLET_M[::-1]
    corners: Points = np.array([(-length, -width), (length, -width), (length, width), (-length, width)])
    corners /= np.hypot(length, width)
    return corners


@cluttered(
    40.0,
    30.0,
    3.0,
    least_m=20.0,
    objects="pallets",
    radii_m=(PALLET_RADIUS_M, PALLET_RADIUS_M),
    shape=_pallet,
)
def warehouse(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """40 x 30 m: racks between aisles, docks with trailers, pallets (layout of Roodbergen and de Koster)."""
    wall = wall_thickness(resolution)
    whole = inside(cells, wall)
    hall = Box(whole.left, whole.top, whole.right, whole.bottom - round(TRAILER_M[1] / resolution) - wall)
    carve(cells, hall.left, hall.top, hall.right, hall.bottom)
    _docks(cells, random, hall, whole.bottom, resolution)
    _racks(cells, random, hall, resolution)


def _docks(cells: Grid, random: np.random.Generator, hall: Box, bottom: int, resolution: float) -> None:
    """Put trailers, which are open toward the hall, at some docks below it: at least at one."""
    pitch, width = round(DOCK_M / resolution), round(TRAILER_M[0] / resolution)
    count = hall.width // pitch
    first = hall.left + (hall.width - count * pitch + pitch - width) // 2
    taken = random.random(count) < 0.5
    taken[random.integers(count)] = True
    for dock in np.flatnonzero(taken).tolist():
        left = first + dock * pitch
        carve(cells, left, hall.bottom, left + width, bottom)


def _racks(cells: Grid, random: np.random.Generator, hall: Box, resolution: float) -> None:
    """Fill blocks of the hall with racks, some without one of their bays."""
    rack, cross = round(RACK_M / resolution), round(CROSS_M / resolution)
    aisle = random.uniform(*AISLE_M) / resolution
    count = int((hall.width - aisle) / (rack + aisle))
    aisle = (hall.width - count * rack) / (count + 1)
    top, bottom = hall.top + cross, hall.bottom - round(STAGING_M / resolution)
    blocks = -(-(bottom - top + cross) // (round(BLOCK_M / resolution) + cross))
    length = (bottom - top - (blocks - 1) * cross) / blocks
    bays = max(1, int(length * resolution / BAY_M))
    for number in range(count):
        left = hall.left + round(number * rack + (number + 1) * aisle)
        for block in range(blocks):
            ends = [round(top + block * (length + cross) + length * bay / bays) for bay in range(bays + 1)]
            cells[ends[0] : ends[-1], left : left + rack] = OCCUPIED
            if random.random() < 0.3:
                bay = int(random.integers(bays))
                carve(cells, left, ends[bay], left + rack, ends[bay + 1])
