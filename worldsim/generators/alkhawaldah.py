"""The environments of the rotating scanner experiments (Al-khawaldah and Nüchter, sections 4.1 to 4.3)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from worldsim.generators.drawing import (
    box,
    carve,
    disc,
    enclose,
    environment,
    field,
    length,
    rock,
    scatter,
    wall_thickness,
)
from worldsim.generators.floorplan import Box, Builder, Style, inside


@environment(22.0, 16.0, 0.1, least_m=10.0)
def office_plain(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """22 x 16 m: an office of wide rooms without obstacles (Al-khawaldah and Nüchter, section 4.1)."""
    _office(cells, random, resolution)


@environment(22.0, 16.0, 0.1, least_m=10.0)
def office_obstacles(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """22 x 16 m: the same office with obstacles (Al-khawaldah and Nüchter, section 4.1)."""
    _office(cells, random, resolution)
    count = round(0.12 * cells.size * resolution**2)
    radii = (0.3 / resolution, 0.8 / resolution)
    shapes = (box, box, disc, rock)
    scatter(cells, random, cells == FREE, count=count, radii=radii, gap=0.7 / resolution, shapes=shapes)


def _office(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    style = Style(corridor_m=2.4, room_m=(3.6, 6.5), door_m=(1.0, 1.4))
    Builder(cells, random, resolution, style).offices(inside(cells, wall_thickness(resolution)), corridors=1)


@environment(120.0, 90.0, 0.25, least_m=40.0)
def campus(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """Outdoors, 120 x 90 m: buildings, courtyards, roads, trees (Al-khawaldah and Nüchter, section 4.2)."""
    wall = wall_thickness(resolution)
    field(cells, wall)
    road = round(7.0 / resolution)
    most = round(40.0 / resolution)
    floor = inside(cells, wall + road // 2)
    for block in blocks(random, floor, most, road):
        _building(cells, random, block.shrunk(round(random.uniform(1.0, 3.0) / resolution)), resolution)
    count = round(0.01 * int((cells == FREE).sum()) * resolution**2)
    radii = (0.5 / resolution, 1.2 / resolution)
    scatter(cells, random, cells == FREE, count=count, radii=radii, gap=2.0 / resolution, shapes=(disc,))


@environment(120.0, 90.0, 0.25, least_m=40.0)
def campus_roads(cells: Grid, random: np.random.Generator, resolution: float) -> None:
    """Outdoors, 120 x 90 m: roads around closed blocks, some with a yard (Al-khawaldah and Nüchter, section 4.2)."""
    wall = wall_thickness(resolution)
    field(cells, wall)
    road, deep, gate = (round(side_m / resolution) for side_m in (7.0, 8.0, 4.0))
    most = round(40.0 / resolution)
    for block in blocks(random, inside(cells, wall + road), most, road):
        ground = cells[block.top : block.bottom, block.left : block.right]
        ground[:] = UNKNOWN
        if random.random() < 0.4 and min(ground.shape) > 2 * deep:
            ground = ground[:: 1 - 2 * int(random.integers(2))]
            ground[deep:-deep, deep:-deep] = FREE
            left = (ground.shape[1] - gate) // 2
            ground[:deep, left : left + gate] = FREE


def blocks(random: np.random.Generator, area: Box, most: int, road: int) -> list[Box]:
    """Divide an area by roads until no side of a block is longer than `most`."""
    if max(area.width, area.height) <= most:
        return [area]
    along = round(max(area.width, area.height) * random.uniform(0.36, 0.64)) - road // 2
    if area.width >= area.height:
        first = Box(area.left, area.top, area.left + along, area.bottom)
        second = Box(first.right + road, area.top, area.right, area.bottom)
    else:
        first = Box(area.left, area.top, area.right, area.top + along)
        second = Box(area.left, first.bottom + road, area.right, area.bottom)
    return blocks(random, first, most, road) + blocks(random, second, most, road)


def _building(cells: Grid, random: np.random.Generator, plot: Box, resolution: float) -> None:
    """Put a building on its plot: a bar, an L, a U, or four wings around a court with a gate."""
    ground = cells[plot.top : plot.bottom, plot.left : plot.right]
    deep = round(random.uniform(7.0, 9.0) / resolution)
    ground = ground[:: 1 - 2 * int(random.integers(2)), :: 1 - 2 * int(random.integers(2))]
    if random.random() < 0.5:
        ground = ground.T
    height, width = ground.shape
    if min(height, width) < 2.5 * deep:
        ground[:deep, :] = UNKNOWN
        if min(height, width) > 1.6 * deep:
            ground[:, :deep] = UNKNOWN
        return
    kind = random.integers(3)
    ground[:deep, :] = UNKNOWN
    ground[:, :deep] = UNKNOWN
    if kind >= 1:
        ground[-deep:, :] = UNKNOWN
    if kind == 2:
        ground[:, -deep:] = UNKNOWN
        gate = round(4.0 / resolution)
        ground[:deep, (width - gate) // 2 : (width + gate) // 2] = FREE


def hilbert(
    order: int, _random: np.random.Generator, *, side_m: float = 25.6, resolution: float = 0.1
) -> Grid:
    """26 x 26 m: a corridor along the Hilbert curve of this order (Al-khawaldah and Nüchter, 4.3)."""
    cells, pitch = _square(order, side_m, resolution)
    wall = wall_thickness(resolution)
    for (x0, y0), (x1, y1) in pairwise(hilbert_curve(order)):
        left, top = wall + min(x0, x1) * pitch, wall + min(y0, y1) * pitch
        carve(cells, left, top, (max(x0, x1) + 1) * pitch, (max(y0, y1) + 1) * pitch)
    enclose(cells, wall)
    return cells


def hilbert_walls(
    order: int, _random: np.random.Generator, *, side_m: float = 25.6, resolution: float = 0.1
) -> Grid:
    """26 x 26 m: one wall along the Hilbert curve of this order (Al-khawaldah and Nüchter, 4.3)."""
    cells, pitch = _square(order, side_m, resolution)
    wall = wall_thickness(resolution)
    field(cells, wall)
    for (x0, y0), (x1, y1) in pairwise(hilbert_curve(order)):
        left, top = (min(side) * pitch + pitch // 2 for side in ((x0, x1), (y0, y1)))
        right, bottom = (max(side) * pitch + pitch // 2 + wall for side in ((x0, x1), (y0, y1)))
        cells[top:bottom, left:right] = OCCUPIED
    enclose(cells, wall)
    return cells


def hilbert_curve(order: int) -> list[tuple[int, int]]:
    """Return the squares of a 2^order by 2^order board in the order in which the Hilbert curve visits them.

    It enters at the lower left and leaves at the lower right; order 1 is a cup that opens downwards.
    """
    if order == 0:
        return [(0, 0)]
    half = 2 ** (order - 1)
    last = half - 1
    cup = hilbert_curve(order - 1)
    return [
        *((last - y, 2 * half - 1 - x) for x, y in cup),
        *((x, y) for x, y in cup),
        *((x + half, y) for x, y in cup),
        *((y + half, half + x) for x, y in cup),
    ]


def _square(order: int, side_m: float, resolution: float) -> tuple[Grid, int]:
    """Return an unknown grid of 2^order squares per side, and the side of a square in cells."""
    pitch = length("side_m", side_m, resolution, least_m=4 * 2**order * resolution) // 2**order
    side = 2**order * pitch + wall_thickness(resolution)
    return np.full((side, side), UNKNOWN, np.uint8), pitch
