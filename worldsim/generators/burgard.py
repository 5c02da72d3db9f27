"""The three kinds of environment of the coordinated exploration experiments (Burgard et al., Fig. 8).

Their simulator has cells of 0.15 m (section IV-C).
"""

from __future__ import annotations

import numpy as np

from protocol.grid import FREE, Grid
from worldsim.generators.drawing import blob, canvas, enclose, fill, scatter, wall_thickness
from worldsim.generators.floorplan import Builder, Style, inside


def unstructured(
    random: np.random.Generator, *, width_m: float = 30.0, height_m: float = 27.0, resolution: float = 0.15
) -> Grid:
    """Draw a cave: an irregular outline with objects scattered inside."""
    cells = canvas(width_m, height_m, resolution, least_m=10.0)
    wall = wall_thickness(resolution)
    height, width = cells.shape
    outline = blob(random, corners=16, least=0.75)
    outline = (outline - outline.min(axis=0)) / np.ptp(outline, axis=0)
    fill(cells, wall + outline * (width - 1 - 2 * wall, height - 1 - 2 * wall), FREE)
    count = round(0.08 * int((cells == FREE).sum()) * resolution**2)
    radii = (0.4 / resolution, 1.8 / resolution)
    scatter(cells, random, cells == FREE, count=count, radii=radii, gap=0.9 / resolution)
    enclose(cells, wall)
    return cells


def office(
    random: np.random.Generator, *, width_m: float = 36.0, height_m: float = 27.0, resolution: float = 0.15
) -> Grid:
    """Draw an office floor of two corridors; many rooms have a second doorway, into the next room."""
    return _floor(random, (width_m, height_m), resolution, 2, Style(corridor_m=2.25, joined=0.35))


def corridor(
    random: np.random.Generator, *, width_m: float = 48.0, height_m: float = 15.0, resolution: float = 0.15
) -> Grid:
    """Draw one long corridor with rooms on both sides."""
    return _floor(random, (width_m, height_m), resolution, 1, Style(corridor_m=2.7, joined=0.2))


def _floor(
    random: np.random.Generator, size_m: tuple[float, float], resolution: float, corridors: int, style: Style
) -> Grid:
    cells = canvas(*size_m, resolution, least_m=10.0 * corridors)
    wall = wall_thickness(resolution)
    floor = inside(cells, wall)
    Builder(cells, random, resolution, style).offices(floor, corridors)
    enclose(cells, wall)
    return cells
