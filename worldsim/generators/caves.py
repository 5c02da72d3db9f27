"""Caves: chambers joined by winding halls of uneven width, with loops and rocks.

Chambers lie near the points of a lattice. A random spanning tree joins neighbors by halls, so that all chambers are
connected; some further halls close loops. A hall is a row of irregular blobs along a bent curve.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FREE, UNKNOWN, Grid
from worldsim.generators.clutter import cluttered
from worldsim.generators.drawing import blob, fill, rock, wall_thickness
from worldsim.generators.spanning_tree import spanning_tree

PITCH_M = 6.5
"""Approximate distance of neighboring chambers, in meters."""
JITTER = 0.22
"""Largest distance of a chamber from its lattice point along each axis, as a share of the lattice's pitch."""
CHAMBER_M = (1.2, 2.6)
"""Smallest and largest radius of a chamber, in meters."""
HALL_M = (0.9, 1.6)
"""Smallest and largest half of a hall's width, in meters."""
BEND_M = 2.5
"""Largest distance of a hall's control point from the straight line, in meters."""
LOOPS = 0.35
"""Share of the halls outside the spanning tree that are dug as well."""

_BLOB_STEP_M = 0.4
"""Distance of neighboring blobs of a hall, in meters."""

Point = NDArray[np.float64]
"""A position in cells: float64 array of x and y."""


@cluttered(40.0, 30.0, 2.0, least_m=15.0, objects="rocks", radii_m=(0.2, 0.6), shape=rock)
def caves(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """40 x 30 m: chambers and winding halls with loops, rocks on the floor (Murmur)."""
    wall = wall_thickness(resolution)
    sides_m = (round(side * resolution, 3) for side in reversed(cells.shape))
    columns, rows = (max(2, round(side_m / PITCH_M)) for side_m in sides_m)
    chambers = _chambers(random, cells.shape, columns, rows)
    for center in chambers.reshape(-1, 2):
        _dig(cells, random, center, random.uniform(*CHAMBER_M) / resolution, corners=12)
    inside = np.array(cells.shape[::-1]) - (2 * wall + 1)
    tree, others = spanning_tree(random, columns, rows)
    for one, other in tree + [pair for pair in others if random.random() < LOOPS]:
        for center in _curve(random, chambers[one], chambers[other], inside, resolution):
            _dig(cells, random, center, random.uniform(*HALL_M) / resolution, corners=9)
    for border in (cells[:wall], cells[-wall:], cells[:, :wall], cells[:, -wall:]):
        border[:] = UNKNOWN


def _chambers(
    random: np.random.Generator, shape: tuple[int, ...], columns: int, rows: int
) -> NDArray[np.float64]:
    """Return the centers of the chambers in cells, shape (rows * columns, 2)."""
    lattice = np.stack(np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5), axis=-1)
    lattice += random.uniform(-JITTER, JITTER, lattice.shape)
    return lattice.reshape(-1, 2) * (shape[1] / columns, shape[0] / rows)


def _curve(
    random: np.random.Generator, start: Point, end: Point, inside: Point, resolution: float
) -> Iterator[Point]:
    """Yield positions along a quadratic Bezier curve, whose control point lies beside the middle of the line."""
    along = end - start
    length = max(float(np.abs(along).max()), 1.0)
    beside = np.array((-along[1], along[0])) / length * random.uniform(-BEND_M, BEND_M) / resolution
    control = np.clip((start + end) / 2 + beside, 0, inside)
    count = 1 + int(1.5 * length * resolution / _BLOB_STEP_M)
    for part in (np.arange(count + 1) / count).tolist():
        yield (1 - part) ** 2 * start + 2 * part * (1 - part) * control + part**2 * end


def _dig(cells: Grid, random: np.random.Generator, center: Point, radius: float, corners: int) -> None:
    fill(cells, blob(random, corners, least=0.75) * radius + center, FREE)
