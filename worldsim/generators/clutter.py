"""Environments with clutter: objects that stand free on the floor, by their number per 100 square meters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from protocol.grid import FREE, Grid, Mask
from worldsim.generators.drawing import Environment, Shape, canvas, enclose, scatter, wall_thickness
from worldsim.maps import MapError

MOST_CLUTTER = 20.0
"""Maximum number of objects per 100 square meters."""

PASSAGE_M = 0.7
"""Free distance around every object, in meters."""

Building = Callable[[Grid, np.random.Generator, float], Mask | None]
"""Draws on an unknown grid with cells of so many meters; returns where objects may stand, None: on all free cells."""


def cluttered(
    width_m: float,
    height_m: float,
    clutter: float,
    *,
    least_m: float,
    objects: str,
    radii_m: tuple[float, float],
    shape: Shape,
) -> Callable[[Building], Environment]:
    """Make an environment of a function that draws a building, put objects on its floor, and enclose it with walls.

    The size and the number of objects per 100 square meters are the defaults of its parameters; no side may be shorter
    than `least_m`. Objects have radii between those of `radii_m`, in meters; where there is no place, fewer are drawn.
    `objects` names them in error messages.
    """
    defaults = width_m, height_m, clutter

    def decorate(build: Building) -> Environment:
        def drawn(
            random: np.random.Generator,
            *,
            width_m: float = defaults[0],
            height_m: float = defaults[1],
            resolution: float = 0.1,
            clutter: float = defaults[2],
        ) -> Grid:
            cells = canvas(width_m, height_m, resolution, least_m)
            if not 0 <= clutter <= MOST_CLUTTER:
                raise MapError(
                    f"clutter is {clutter}; it must be 0 to {MOST_CLUTTER:g} {objects} per 100 square meters"
                )
            place = build(cells, random, resolution)
            floor = cells == FREE if place is None else place
            count = round(clutter / 100 * int(floor.sum()) * resolution**2)
            radii, gap = (radii_m[0] / resolution, radii_m[1] / resolution), PASSAGE_M / resolution
            scatter(cells, random, floor, count=count, radii=radii, gap=gap, shapes=(shape,))
            enclose(cells, wall_thickness(resolution))
            return cells

        drawn.__doc__ = build.__doc__
        return drawn

    return decorate
