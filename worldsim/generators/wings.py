"""A multi-wing office: wings of rooms along corridors, on both sides of a main corridor, like the teeth of a comb.

Courts between the wings are not part of the building. Link corridors join the far ends of some neighboring wings, and
so close loops.
"""

from __future__ import annotations

import numpy as np

from protocol.grid import Grid
from worldsim.generators.clutter import cluttered
from worldsim.generators.drawing import box, carve, wall_thickness
from worldsim.generators.floorplan import Box, Builder, Style, inside

MAIN_M, LINK_M = 3.0, 2.0
"""Width of the main corridor and of links, in meters."""
WING_M = (11.0, 14.0)
"""Narrowest and widest wing, in meters."""
COURT_M = (4.0, 8.0)
"""Narrowest and widest court between wings, in meters."""
LENGTH = (0.65, 1.0)
"""Shortest and longest wing, as a share of the space on its side of the main corridor."""
LINKED = 0.5
"""Share of neighboring wings with a link between their far ends."""


@cluttered(56.0, 40.0, 3.0, least_m=30.0, objects="pieces of furniture", radii_m=(0.3, 0.6), shape=box)
def wings(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """56 x 40 m: an office of several wings along a main corridor, with links and furniture (Murmur)."""
    whole = inside(cells, wall_thickness(resolution))
    main = round(MAIN_M / resolution)
    top = whole.top + round(random.uniform(0.45, 0.55) * (whole.height - main))
    carve(cells, whole.left, top, whole.right, top + main)
    below = Box(whole.left, top + main, whole.right, whole.bottom)
    upper = cells[::-1]  # the upper side is drawn upside down
    above = Box(whole.left, cells.shape[0] - top, whole.right, cells.shape[0] - whole.top)
    for drawn, side in ((cells, below), (upper, above)):
        _side(drawn, random, side, resolution)


def _side(cells: Grid, random: np.random.Generator, side: Box, resolution: float) -> None:
    """Draw the wings of one side; the main corridor is above the box."""
    builder = Builder(cells, random, resolution, Style())
    wall, link = builder.wall, builder.cells_in(LINK_M)
    deepest = side.height - link - 2 * wall
    spans = _spans(random, side, resolution)
    depth, before = 0, None
    for left, right in spans:
        linked = before is not None and random.random() < LINKED
        if not linked:
            depth = round(random.uniform(*LENGTH) * deepest)
        wing = Box(left, side.top + wall, right, side.top + wall + depth)
        (lane,), _ = builder.transposed().offices(
            Box(wing.top, wing.left, wing.bottom, wing.right), corridors=1
        )
        carve(cells, lane.top, side.top, lane.bottom, wing.top)  # from the main corridor into the wing's
        if linked and before is not None:
            carve(cells, before.top, wing.bottom + wall, lane.bottom, wing.bottom + wall + link)
            for each in (before, lane):
                carve(cells, each.top, wing.bottom, each.bottom, wing.bottom + wall)
        before = lane


def _spans(random: np.random.Generator, side: Box, resolution: float) -> list[tuple[int, int]]:
    """Return the left and right ends of the wings: at least one, with courts between them."""
    ends: list[tuple[int, int]] = []
    left = side.left + round(random.uniform(0, COURT_M[0]) / resolution)
    while True:
        right = left + round(random.uniform(*WING_M) / resolution)
        if right > side.right:
            return ends
        ends.append((left, right))
        left = right + round(random.uniform(*COURT_M) / resolution)
