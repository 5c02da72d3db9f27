"""A campus of offices: buildings that robots enter, between roads and lawns with trees.

Buildings have rooms along corridors, and a door at each end of every corridor, so that ways lead through them as well
as around them.
"""

from __future__ import annotations

import numpy as np

from protocol.grid import FREE, UNKNOWN, Grid
from worldsim.generators.alkhawaldah import blocks
from worldsim.generators.clutter import add_clutter, check_clutter
from worldsim.generators.drawing import canvas, disc, enclose, field, wall_thickness
from worldsim.generators.floorplan import Box, Builder, Style, inside

LEAST_M = 30.0
"""Shortest side of a campus, in meters."""

ROAD_M, PLOT_M = 4.0, 26.0
"""Width of roads, and longest side of a plot, in meters."""
BUILDING_M = 7.5
"""Shortest side of a building, in meters; smaller plots are lawns."""
CORRIDOR_M = 15.0
"""Depth from which a building has two corridors, in meters."""
LAWN_M = (0.5, 1.5)
"""Range of the strip of lawn around a building, in meters."""
TREE_M = (0.2, 0.6)
"""Smallest and largest radius of a tree, in meters."""


def office_campus(
    random: np.random.Generator,
    *,
    width_m: float = 60.0,
    height_m: float = 45.0,
    resolution: float = 0.1,
    clutter: float = 1.5,
) -> Grid:
    """60 x 45 m: a campus of office buildings that robots enter, roads, lawns with trees (Murmur).

    `clutter` is the number of trees per 100 square meters outdoors; fewer are drawn where there is no place.
    """
    cells = canvas(width_m, height_m, resolution, LEAST_M)
    check_clutter(clutter, "trees")
    wall = wall_thickness(resolution)
    road = round(ROAD_M / resolution)
    field(cells, wall)
    site = inside(cells, wall + road // 2)
    buildings = [
        plot.shrunk(round(random.uniform(*LAWN_M) / resolution))
        for plot in blocks(random, site, round(PLOT_M / resolution), road)
    ]
    buildings = [each for each in buildings if min(each.width, each.height) * resolution >= BUILDING_M]
    for each in buildings:
        cells[each.top : each.bottom, each.left : each.right] = UNKNOWN
    outdoors = cells == FREE
    for each in buildings:
        _building(cells, random, each, resolution)
    add_clutter(cells, random, outdoors, clutter, resolution=resolution, radii_m=TREE_M, shapes=(disc,))
    enclose(cells, wall)
    return cells


def _building(cells: Grid, random: np.random.Generator, outline: Box, resolution: float) -> None:
    """Draw rooms along corridors that run along the longer side, with a door at each end of every corridor."""
    builder = Builder(cells, random, resolution, Style(joined=0.15))
    if outline.height > outline.width:
        builder = builder.transposed()
        outline = Box(outline.top, outline.left, outline.bottom, outline.right)
    corridors = 2 if outline.height * resolution >= CORRIDOR_M else 1
    lanes, _ = builder.offices(outline.shrunk(builder.wall), corridors)
    for lane in lanes:
        for left in (outline.left, outline.right - builder.wall):
            builder.transposed().door(lane.top, lane.bottom, left)
