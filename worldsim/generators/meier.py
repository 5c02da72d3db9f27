"""The three environments of the thesis' experiments (Meier, Fig. 6.1), as described in section 6."""

from __future__ import annotations

import numpy as np

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, Mask
from worldsim.generators.drawing import carve, environment, field, scatter, wall_thickness
from worldsim.generators.floorplan import Box, Builder, Style, inside

_OBJECTS_PER_M2 = 0.11
_PASSAGE_M = 0.7
"""Free distance between any two objects."""


@environment(25.0, 25.0, 0.1, least_m=5.0)
def unstructured(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """Outdoors, 25 x 25 m: objects of many shapes scattered over an enclosed field (Meier, Fig. 6.1a)."""
    field(cells, wall_thickness(resolution))
    _scatter_outdoors(cells, random, resolution, cells == FREE)


@environment(25.0, 25.0, 0.1, least_m=18.0)
def mixed(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """Outdoors and indoors, 25 x 25 m: a building with rooms, objects around it (Meier, Fig. 6.1b)."""
    wall = wall_thickness(resolution)
    field(cells, wall)
    drawn = cells.T if random.random() < 0.5 else cells
    house = _site(random, drawn, round(3.0 / resolution))
    drawn[house.top : house.bottom, house.left : house.right] = UNKNOWN
    outdoors = cells == FREE
    builder = Builder(drawn, random, resolution, Style(room_m=(2.8, 4.6), joined=0.2, merged=0.0))
    (corridor,), rooms = builder.offices(house.shrunk(wall), corridors=1)
    for left in (house.left, house.right - wall):
        builder.transposed().door(corridor.top, corridor.bottom, left)
    _open_porch(drawn, house, (rooms[0], rooms[-1])[random.integers(2)])
    _scatter_outdoors(cells, random, resolution, outdoors)


@environment(25.0, 25.0, 0.1, least_m=10.0)
def office(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """Indoors, 25 x 25 m: rooms along corridors, no obstacles (Meier, Fig. 6.1c)."""
    drawn = cells.T if random.random() < 0.5 else cells
    floor = inside(drawn, wall_thickness(resolution))
    corridors = max(1, round(floor.height * resolution / 12.5))
    Builder(drawn, random, resolution, Style()).offices(floor, corridors)


@environment(20.0, 20.0, 0.1, least_m=5.0)
def two_circles(cells: Grid, _random: np.random.Generator, resolution: float) -> None:
    """20 x 20 m: an empty field with two big discs in it (Meier, Fig. A.1).

    The thesis does not give its dimensions.
    """
    field(cells, wall_thickness(resolution))
    height, width = cells.shape
    rows, columns = np.ogrid[:height, :width]
    radius = min(width, height) / 6
    for x, y in ((0.32 * width, 0.35 * height), (0.66 * width, 0.64 * height)):
        cells[(columns - x) ** 2 + (rows - y) ** 2 < radius**2] = OCCUPIED


def _site(random: np.random.Generator, cells: Grid, margin: int) -> Box:
    """Choose the site of the building: roughly half as wide and as deep as the field."""
    height, width = cells.shape
    wide, deep = round(width * random.uniform(0.54, 0.66)), round(height * random.uniform(0.42, 0.5))
    left = int(random.integers(margin, width - margin - wide + 1))
    top = int(random.integers(margin, height - margin - deep + 1))
    return Box(left, top, left + wide, top + deep)


def _open_porch(cells: Grid, house: Box, room: Box) -> None:
    """Remove a corner room, so that its door leads outdoors."""
    left = house.left if room.left < (house.left + house.right) // 2 else room.left
    right = room.right if left == house.left else house.right
    top = house.top if room.top < (house.top + house.bottom) // 2 else room.top
    bottom = room.bottom if top == house.top else house.bottom
    carve(cells, left, top, right, bottom)


def _scatter_outdoors(cells: Grid, random: np.random.Generator, resolution: float, where: Mask) -> None:
    count = round(_OBJECTS_PER_M2 * int(where.sum()) * resolution**2)
    radii = (0.35 / resolution, 1.4 / resolution)
    scatter(cells, random, where, count=count, radii=radii, gap=_PASSAGE_M / resolution)
