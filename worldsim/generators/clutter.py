"""Clutter: objects that stand free on the floor, by their number per 100 square meters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from protocol.grid import Grid
from worldsim.generators.drawing import Shape, scatter
from worldsim.map_error import MapError

MOST_CLUTTER = 20.0
"""Maximum number of objects per 100 square meters."""

PASSAGE_M = 0.7
"""Free distance around every object, in meters."""


def check_clutter(clutter: float, objects: str) -> None:
    """Raise MapError unless `clutter` is from 0 to `MOST_CLUTTER`; `objects` names them in the message."""
    if not 0 <= clutter <= MOST_CLUTTER:
        raise MapError(
            f"clutter is {clutter}; it must be 0 to {MOST_CLUTTER:g} {objects} per 100 square meters"
        )


def add_clutter(
    cells: Grid,
    random: np.random.Generator,
    floor: NDArray[np.bool_],
    clutter: float,
    *,
    resolution: float,
    radii_m: tuple[float, float],
    shapes: tuple[Shape, ...],
) -> None:
    """Place `clutter` objects per 100 square meters of `floor` (bool, shape of `cells`), fewer if there is no place.

    Their radii are between those of `radii_m`, in meters; `resolution` is in meters per cell.
    """
    count = round(clutter / 100 * int(floor.sum()) * resolution**2)
    radii = radii_m[0] / resolution, radii_m[1] / resolution
    scatter(cells, random, floor, count=count, radii=radii, gap=PASSAGE_M / resolution, shapes=shapes)
