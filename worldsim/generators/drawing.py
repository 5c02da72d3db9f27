"""Drawing tools of all environments.

Free space is carved out of unknown space, and objects are placed in it. Walls are drawn last, between free and unknown
space. Lengths are in cells unless a name ends in ``_m``. Corners of shapes are rounded to sixteenths of a cell
and filled in integer arithmetic, so that a seed gives the same cells on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FREE, MAX_SIDE, OCCUPIED, UNKNOWN, Grid, Mask
from worldsim.maps import MapError
from worldsim.regions import largest_part

_SIXTEENTHS = 16

_COARSEST = 0.4
"""Maximum of meters per cell: larger cells do not resolve doors and walls."""

Points = NDArray[np.float64]
"""Corners of a shape: float64 array of shape (n, 2), x and y."""

Walls = tuple[tuple[float, float, float, float], ...]
"""Walls along an axis, in meters from the upper left corner: each a line from (x, y) to (x, y)."""

Environment = Callable[..., Grid]
"""Draws an environment from a random generator, and parameters by name. Its docstring describes the environment."""


def environment(
    width_m: float, height_m: float, resolution: float, *, least_m: float
) -> Callable[[Callable[[Grid, np.random.Generator, float], None]], Environment]:
    """Make an environment of a function that draws on an unknown grid, and enclose it with walls.

    The size and the resolution are the defaults of its parameters; no side may be shorter than `least_m`.
    """
    defaults = width_m, height_m, resolution

    def decorate(draw: Callable[[Grid, np.random.Generator, float], None]) -> Environment:
        def drawn(
            random: np.random.Generator,
            *,
            width_m: float = defaults[0],
            height_m: float = defaults[1],
            resolution: float = defaults[2],
        ) -> Grid:
            cells = canvas(width_m, height_m, resolution, least_m)
            draw(cells, random, resolution)
            enclose(cells, wall_thickness(resolution))
            return cells

        drawn.__doc__ = draw.__doc__
        return drawn

    return decorate


def canvas(width_m: float, height_m: float, resolution: float, least_m: float) -> Grid:
    """Return an unknown grid for a world of this size, walls included.

    Raises MapError if the resolution is not above 0 or too coarse for doors, or a side is shorter than `least_m` or too
    long for a map.
    """
    width = length("width_m", width_m, resolution, least_m)
    height = length("height_m", height_m, resolution, least_m)
    return np.full((height, width), UNKNOWN, np.uint8)


def length(name: str, side_m: float, resolution: float, least_m: float) -> int:
    """Return the side of a world in cells; `name` is its parameter's. Raises MapError as `canvas` does."""
    if not 0 < resolution <= _COARSEST:
        raise MapError(f"resolution is {resolution}; it must be above 0 and at most {_COARSEST} m per cell")
    most_m = MAX_SIDE * resolution
    if most_m < least_m:
        raise MapError(
            f"{name} is {side_m} m; with cells of {resolution:g} m it could be at most {most_m:g} m, {MAX_SIDE} cells, "
            f"but it must be at least {least_m:g} m: use larger cells, of up to {_COARSEST} m (resolution)"
        )
    if not least_m <= side_m <= most_m:
        raise MapError(
            f"{name} is {side_m} m; with cells of {resolution:g} m it must be at least {least_m:g} m and "
            f"at most {most_m:g} m, {MAX_SIDE} cells"
        )
    return round(side_m / resolution)


def wall_thickness(resolution: float) -> int:
    """Return the thickness of walls: 0.2 m, but at least one cell and at most two."""
    return min(max(round(0.2 / resolution), 1), 2)


def walled(width_m: float, height_m: float, walls: Walls, resolution: float, *, is_centered: bool) -> Grid:
    """Draw a field with walls, and enclose it; MapError as `canvas`.

    `is_centered`: whether the lines are the middle of the walls; else they are their left or upper side.
    """
    cells = canvas(width_m, height_m, resolution, least_m=0.0)
    thickness = wall_thickness(resolution)
    before = thickness // 2 if is_centered else 0
    field(cells, thickness)
    for wall in walls:
        left, top, right, bottom = (round(end / resolution) - before for end in wall)
        cells[max(top, 0) : bottom + thickness, max(left, 0) : right + thickness] = OCCUPIED
    enclose(cells, thickness)
    return cells


def carve(cells: Grid, left: int, top: int, right: int, bottom: int) -> None:
    """Free the cells from (left, top) to before (right, bottom)."""
    cells[top:bottom, left:right] = FREE


def field(cells: Grid, wall: int) -> None:
    """Free everything but a wall around the grid."""
    height, width = cells.shape
    carve(cells, wall, wall, width - wall, height - wall)


def enclose(cells: Grid, wall: int) -> None:
    """Turn unknown cells next to free ones into walls, and fill all free areas but the largest 4-connected one.

    Walls are `wall` cells thick, without diagonal gaps.
    """
    from scipy import ndimage  # noqa: PLC0415  slow to import, and listing names needs none

    near = ndimage.maximum_filter(cells == FREE, 2 * wall + 1, mode="constant")
    cells[near & (cells == UNKNOWN)] = OCCUPIED
    free = cells == FREE
    cells[free & ~largest_part(free)] = OCCUPIED


def fill(cells: Grid, corners: Points, state: int) -> None:
    """Set the cells whose centers lie inside a polygon (even-odd)."""
    corner_x, corner_y = np.round(corners * _SIXTEENTHS).astype(np.int64).T
    low_x, low_y = (max(int(side.min()) // _SIXTEENTHS, 0) for side in (corner_x, corner_y))
    high_x, high_y = (int(side.max()) // _SIXTEENTHS + 1 for side in (corner_x, corner_y))
    window = cells[low_y:high_y, low_x:high_x]
    y, x = np.ogrid[: window.shape[0], : window.shape[1]]
    y, x = (y + low_y) * _SIXTEENTHS, (x + low_x) * _SIXTEENTHS
    inside = np.zeros(window.shape, bool)
    for i in range(len(corner_x)):
        x0, y0, x1, y1 = corner_x[i - 1], corner_y[i - 1], corner_x[i], corner_y[i]
        if y0 > y1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        inside ^= (y0 <= y) & (y < y1) & ((x - x0) * (y1 - y0) < (y - y0) * (x1 - x0))
    window[inside] = state


def disc(_random: np.random.Generator) -> Points:
    """Return a circle, of 32 corners."""
    return _around(np.arange(32) / 32, np.ones(32))


def box(random: np.random.Generator) -> Points:
    """Return a rectangle with an aspect ratio from 1 to 4."""
    half = math.atan(random.uniform(0.25, 1.0)) / (2 * math.pi)
    return _around(np.array([half, 0.5 - half, 0.5 + half, 1 - half]) + random.random(), np.ones(4))


def rock(random: np.random.Generator) -> Points:
    """Return an irregular polygon of 5 to 9 corners."""
    return blob(random, int(random.integers(5, 10)), 0.6)


def blob(random: np.random.Generator, corners: int, least: float) -> Points:
    """Return a star-shaped polygon, with corners at distances from `least` to 1."""
    turns = (np.arange(corners) + random.uniform(-0.3, 0.3, corners)) / corners + random.random()
    return _around(turns, random.uniform(least, 1.0, corners))


def angle(random: np.random.Generator) -> Points:
    """Return an L of two arms."""
    thick = random.uniform(0.35, 0.6)
    corners = np.array([(0, 0), (1.4, 0), (1.4, thick), (thick, thick), (thick, 1.2), (0, 1.2)]) - (0.5, 0.5)
    corners /= np.hypot(*corners.T).max()
    turn = 2 * math.pi * random.random()
    x, y = corners.T
    return np.stack(
        [math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y], axis=1
    )


Shape = Callable[[np.random.Generator], Points]
"""Draws the corners of a shape inside the circle of radius 1."""

SHAPES: tuple[Shape, ...] = (disc, box, rock, angle)


def scatter(
    cells: Grid,
    random: np.random.Generator,
    where: Mask,
    *,
    count: int,
    radii: tuple[float, float],
    gap: float,
    shapes: tuple[Shape, ...] = SHAPES,
) -> None:
    """Place `count` objects in free space, at least `gap` cells from each other and from existing obstacles.

    Their centers lie where `where` (bool, shape of `cells`) is true, their radii between those of `radii`, in cells;
    small objects are more common, all `shapes` equally likely. An object for which no place is found is omitted.
    """
    from scipy import ndimage  # noqa: PLC0415  slow to import, and listing names needs none

    clearance = ndimage.distance_transform_edt(cells == FREE)
    rows, columns = np.nonzero(where & (clearance > radii[0] + gap))
    placed: list[tuple[int, int, float]] = []
    for _ in range(count):
        shape = shapes[random.integers(len(shapes))]
        radius = radii[0] + (radii[1] - radii[0]) * random.random() ** 1.5
        for place in random.integers(max(len(rows), 1), size=40 if len(rows) else 0):
            x, y = int(columns[place]), int(rows[place])
            if clearance[y, x] > radius + gap and all(
                (x - other_x) ** 2 + (y - other_y) ** 2 > (radius + other + gap) ** 2
                for other_x, other_y, other in placed
            ):
                placed.append((x, y, radius))
                fill(cells, shape(random) * radius + (x, y), OCCUPIED)
                break


def _around(turns: NDArray[np.float64], radii: NDArray[np.float64]) -> Points:
    return np.stack([np.cos(2 * np.pi * turns) * radii, np.sin(2 * np.pi * turns) * radii], axis=1)
