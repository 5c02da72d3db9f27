"""A maze: corridors of one width, dead ends, and some loops (a partly braided maze)."""

from __future__ import annotations

import numpy as np

from protocol.grid import Grid
from worldsim.generators.clutter import cluttered
from worldsim.generators.drawing import box, carve, wall_thickness
from worldsim.generators.floorplan import inside
from worldsim.generators.spanning_tree import spanning_tree

CORRIDOR_M = 2.0
"""Least width of the corridors, in meters; what is left of the maze's side is added to all of them."""
LOOPS = 0.06
"""Share of the walls between neighboring squares, outside the spanning tree, that are open as well."""


@cluttered(30.0, 24.0, 0.0, least_m=8.0, objects="crates", radii_m=(0.15, 0.3), shape=box)
def maze(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """30 x 24 m: a maze of corridors with dead ends and a few loops (Murmur)."""
    wall = wall_thickness(resolution)
    whole = inside(cells, wall)
    lefts, tops = (_edges(side, wall, resolution) for side in (whole.width, whole.height))
    columns, rows = len(lefts) - 1, len(tops) - 1
    tree, others = spanning_tree(random, columns, rows)
    for place in range(columns * rows):
        _open(cells, lefts, tops, place, place)
    for one, other in tree + [pair for pair in others if random.random() < LOOPS]:
        _open(cells, lefts, tops, one, other)


def _edges(side: int, wall: int, resolution: float) -> list[int]:
    """Return the first cell of each square along a side, then the one behind the last square's wall."""
    count = max(2, (side + wall) // (round(CORRIDOR_M / resolution) + wall))
    return [wall + at * (side + wall) // count for at in range(count + 1)]


def _open(cells: Grid, lefts: list[int], tops: list[int], one: int, other: int) -> None:
    """Free the box from one square to another square right of it or below it."""
    wall = lefts[0]
    (top, left), (bottom, right) = (divmod(place, len(lefts) - 1) for place in (one, other))
    carve(cells, lefts[left], tops[top], lefts[right + 1] - wall, tops[bottom + 1] - wall)
