"""The four environments of the study of task allocation (Faigl and Vanek, section 5), with its cells of 0.05 m.

The paper gives names and sizes. The environments drawn here resemble them, but their walls differ.
"""

from __future__ import annotations

import numpy as np

from protocol.grid import FREE, OCCUPIED, Grid
from worldsim.generators.drawing import carve, environment, field, rock, scatter, wall_thickness
from worldsim.generators.floorplan import Builder, Style, inside


@environment(21.0, 24.0, 0.05, least_m=2.0)
def em(cells: Grid, _random: np.random.Generator, resolution: float) -> None:
    """21 x 24 m without any obstacle (Faigl and Vanek, section 5)."""
    field(cells, wall_thickness(resolution))


@environment(30.0, 30.0, 0.05, least_m=20.0)
def autolab(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """30 x 30 m: a research hall with screens, rooms on two sides, a wing (Faigl and Vanek, section 5)."""
    wall = wall_thickness(resolution)
    drawn = cells[:: 1 - 2 * int(random.integers(2)), :: 1 - 2 * int(random.integers(2))]
    height, width = drawn.shape

    def place(share: float, side: int) -> int:
        return round((share + random.uniform(-0.025, 0.025)) * side)

    x1, x2, x3 = (place(share, width) for share in (0.25, 0.5, 0.75))
    y1, y2, y3 = (place(share, height) for share in (0.17, 0.28, 0.46))
    wing_top, hall_bottom = place(0.56, height), place(0.74, height)
    builder = Builder(drawn, random, resolution, Style(door_m=(1.2, 1.8)))
    sideways = builder.transposed()

    carve(drawn, wall, y1, x2 - wall, hall_bottom)  # the hall
    carve(drawn, x2 - wall, y3, x3, hall_bottom)
    for left, right in ((wall, x1 - wall), (x1, x2 - wall)):  # two rooms above it
        carve(drawn, left, wall, right, y1 - wall)
        builder.door(left, right, y1 - wall)
    carve(drawn, x2, wall, x3, y2 - wall)  # two rooms beside it
    sideways.door(y1, y2 - wall, x2 - wall)
    carve(drawn, x2, y2, x3, y3 - wall)
    builder.door(x2, x3, y3 - wall)
    carve(drawn, x3, wing_top, width - wall, hall_bottom)  # the wing
    carve(drawn, x2, hall_bottom + wall, place(0.67, width), height - wall)  # the annex
    builder.door(x2, x2 + (x3 - x2) // 2, hall_bottom)

    bar = round(0.05 * width)
    top, bottom = y1 + round(2.0 / resolution), hall_bottom - round(3.5 / resolution)
    drawn[top:bottom, x1 - wall : x1] = OCCUPIED  # the screens, like an I
    for y in (top, bottom):
        drawn[y : y + wall, x1 - wall - bar : x1 + bar] = OCCUPIED


@environment(21.0, 24.0, 0.05, least_m=18.0)
def jh(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """21 x 24 m: an office building with small rooms along a corridor (Faigl and Vanek, section 5)."""
    floor = inside(cells, wall_thickness(resolution))
    style = Style(corridor_m=1.8, room_m=(2.4, 4.2), door_m=(0.8, 1.0), joined=0.08, merged=0.05)
    depth = round(random.uniform(3.8, 4.6) / resolution)
    Builder(cells, random, resolution, style).ring(floor, depth)


@environment(40.0, 40.0, 0.05, least_m=10.0)
def potholes(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """40 x 40 m with many small obstacles (Faigl and Vanek, section 5)."""
    field(cells, wall_thickness(resolution))
    count = round(0.035 * cells.size * resolution**2)
    radii = (0.5 / resolution, 1.8 / resolution)
    scatter(cells, random, cells == FREE, count=count, radii=radii, gap=1.0 / resolution, shapes=(rock,))
