"""The environments of the coordinated exploration experiments (Burgard et al., Figs. 3 to 5, 8, and 11).

Their simulator has cells of 0.15 m (section IV-C). The paper gives the sizes of the environments of Figs. 3 to 5. Of
their walls the text says only where there are rooms, doorways, and a corridor.
"""

from __future__ import annotations

import numpy as np

from protocol.grid import FREE, Grid
from worldsim.generators.drawing import Walls, blob, environment, fill, scatter, wall_thickness, walled
from worldsim.generators.floorplan import Builder, Style, inside


@environment(30.0, 27.0, 0.15, least_m=10.0)
def unstructured(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """30 x 27 m: an irregular outline with objects scattered inside (Burgard et al., section IV-C)."""
    wall = wall_thickness(resolution)
    height, width = cells.shape
    outline = blob(random, corners=16, least=0.75)
    outline = (outline - outline.min(axis=0)) / np.ptp(outline, axis=0)
    fill(cells, wall + outline * (width - 1 - 2 * wall, height - 1 - 2 * wall), FREE)
    count = round(0.08 * int((cells == FREE).sum()) * resolution**2)
    radii = (0.4 / resolution, 1.8 / resolution)
    scatter(cells, random, cells == FREE, count=count, radii=radii, gap=0.9 / resolution)


@environment(36.0, 27.0, 0.15, least_m=20.0)
def office(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """36 x 27 m: an office of two corridors, many rooms with two doorways (Burgard et al., section IV-C)."""
    style = Style(corridor_m=2.25, joined=0.35)
    Builder(cells, random, resolution, style).offices(inside(cells, wall_thickness(resolution)), corridors=2)


@environment(48.0, 15.0, 0.15, least_m=10.0)
def corridor(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """48 x 15 m: a long corridor with rooms on both sides (Burgard et al., section IV-C)."""
    style = Style(corridor_m=2.7, joined=0.2)
    Builder(cells, random, resolution, style).offices(inside(cells, wall_thickness(resolution)), corridors=1)


_FIVE_ROOMS: Walls = (
    (0.0, 5.6, 2.0, 5.6),  # above the corridor; doorways of 0.9 m
    (2.9, 5.6, 9.0, 5.6),
    (9.9, 5.6, 15.1, 5.6),
    (16.0, 5.6, 18.0, 5.6),
    (0.0, 7.9, 3.6, 7.9),  # below it
    (4.5, 7.9, 13.0, 7.9),
    (13.9, 7.9, 18.0, 7.9),
    (5.8, 0.0, 5.8, 5.6),  # between the rooms
    (12.2, 0.0, 12.2, 5.6),
    (9.0, 7.9, 9.0, 14.0),
)

_TWO_ROOMS: Walls = (
    (0.0, 5.6, 1.6, 5.6),  # above the corridor
    (2.5, 5.6, 11.5, 5.6),
    (12.4, 5.6, 14.0, 5.6),
    (7.0, 0.0, 7.0, 2.4),  # between the rooms
    (7.0, 3.3, 7.0, 5.6),
)


def five_rooms(_random: np.random.Generator, *, resolution: float = 0.15) -> Grid:
    """18 x 14 m: five empty rooms along a corridor (Burgard et al., Figs. 3, 11)."""
    return walled(18.0, 14.0, _FIVE_ROOMS, resolution, is_centered=False)


def two_rooms(_random: np.random.Generator, *, resolution: float = 0.15) -> Grid:
    """14 x 8 m: two rooms with a doorway between them, each with one to a corridor (Burgard et al., Figs. 4, 5)."""
    return walled(14.0, 8.0, _TWO_ROOMS, resolution, is_centered=False)
