"""A campus of offices: buildings that robots enter, between roads and lawns with trees.

Buildings have rooms along corridors, and a door at each end of every corridor, so that ways lead through them as well
as around them.
"""

from __future__ import annotations

import numpy as np

from protocol.grid import FREE, UNKNOWN, Grid, Mask
from worldsim.generators.alkhawaldah import blocks
from worldsim.generators.clutter import cluttered
from worldsim.generators.drawing import disc, field, wall_thickness
from worldsim.generators.floorplan import Box, Builder, Style, inside

ROAD_M, PLOT_M = 4.0, 26.0
"""Width of roads, and longest side of a plot, in meters."""
BUILDING_M = 7.5
"""Shortest side of a building, in meters; smaller plots are lawns."""
CORRIDOR_M = 15.0
"""Depth from which a building has two corridors, in meters."""
LAWN_M = (0.5, 1.5)
"""Range of the strip of lawn around a building, in meters."""


@cluttered(60.0, 45.0, 1.5, least_m=30.0, objects="trees", radii_m=(0.2, 0.6), shape=disc)
def office_campus(cells: Grid, random: np.random.Generator, resolution: float) -> Mask:
    """60 x 45 m: a campus of office buildings that robots enter, roads, lawns with trees (Murmur)."""
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
    outdoors: Mask = cells == FREE
    for each in buildings:
        _building(cells, random, each, resolution)
    return outdoors


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
