"""The three kinds of environment of the coordinated exploration experiments (Burgard et al., Fig. 8).

Their simulator has cells of 0.15 m (section IV-C).
"""

from __future__ import annotations

import numpy as np

from protocol.grid import FREE, Grid
from worldsim.generators.drawing import blob, environment, fill, scatter, wall_thickness
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
