"""Connectivity: which robots receive each other (docs/radios.md): those within a disc, unless walls are in the way.

All models are symmetric. At range 0 no robot receives another, not even in its own cell. `log_distance` is the disc if
there are no walls and no shadowing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from netshaper.radio_options import Partition, PathLossOptions
from protocol.arrays import FloatRows, Int64Rows
from protocol.grid import OCCUPIED, Cell, Grid
from protocol.kernels import kernel
from protocol.keyed_random import keyed_random

Links = NDArray[np.bool_]
"""Shape (robots, robots), symmetric."""
Places = NDArray[np.int64]
"""Cells (x, y) of robots, shape (robots, 2)."""


def places_of(cells: Mapping[int, Cell]) -> Places:
    """Return the cells of robots, by ascending number."""
    return np.array([cells[robot] for robot in sorted(cells)], np.int64).reshape(-1, 2)


def named(robots: Sequence[int], links: Links) -> dict[int, list[int]]:
    """Return for each robot the others that it receives, in ascending order."""
    others = links & ~np.eye(len(robots), dtype=np.bool_)
    return {
        robot: list(compress(robots, linked)) for robot, linked in zip(robots, others.tolist(), strict=True)
    }


def disc(places: Places, range_cells: float) -> Links:
    """Return the links between robots within the range."""
    x, y = places.T
    near: Links = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2 <= range_cells * range_cells
    return near & (range_cells > 0)


def line_of_sight(places: Places, range_cells: float, walls: Grid) -> Links:
    """Return the links between robots within the range without a wall between them."""
    open_to: Links = walls_crossed(walls, places) == 0
    return disc(places, range_cells) & open_to


def log_distance(
    places: Places,
    range_cells: float,
    walls: Grid,
    cell_m: float,
    options: PathLossOptions,
    extra_db: NDArray[np.float64] | float = 0.0,
) -> Links:
    """Return the links whose path loss is at most that of an open link as long as the range.

    `extra_db` is the shadowing, symmetric, shape (robots, robots); for the other parameters see `margin_db`.
    """
    if math.isinf(range_cells):
        return np.ones((len(places), len(places)), np.bool_)
    if range_cells <= 0:
        return np.zeros((len(places), len(places)), np.bool_)
    x, y = places.T
    away = np.hypot(x[:, None] - x, y[:, None] - y).astype(np.float64)
    loss = (options.db_per_wall * walls_crossed(walls, places) + extra_db).astype(np.float64)
    return margin_db(away, loss, range_cells, cell_m, options) >= 0


def margin_db(
    away: FloatRows, loss_db: FloatRows, range_cells: float, cell_m: float, options: PathLossOptions
) -> FloatRows:
    """Return how much stronger frames are than at the end of an open link as long as the range, in dB.

    The loss over d meters is ``10 exponent log10(d) + db_per_meter d`` dB, which is the site-general model of ITU-R
    P.1238 with N = 10 exponent; each wall on the line adds to it, as in COST 231's multi-wall model. `away` are
    distances in cells, `loss_db` the losses by walls and shadowing, of the same shape.
    """
    near = np.maximum(away, 1e-9)
    reach = max(range_cells, 1e-9)
    margin = 10 * options.exponent * np.log10(reach / near)
    margin += options.db_per_meter * cell_m * (range_cells - away)
    margin -= loss_db
    # Rounded to thousandths of a dB, so that results do not depend on the machine's logarithm.
    return np.where(away == 0, np.inf, np.rint(1000 * margin) / 1000)


def shadowing(places: Places, cell_m: float, seed: int, options: PathLossOptions) -> NDArray[np.float64]:
    """Return the shadowing between any two places, in dB: normal, constant within squares of side `shadowing_m`.

    It depends on the two squares, not on robots or steps: robots that stand still keep their links.
    """
    side_m = options.shadowing_m
    squares = [(int(x * cell_m // side_m), int(y * cell_m // side_m)) for x, y in places.tolist()]
    return np.array(
        [
            [options.shadowing_db * _drawn_between(seed, *sorted((one, other))) for other in squares]
            for one in squares
        ]
    ).reshape(len(squares), len(squares))


@lru_cache(maxsize=1 << 16)
def _drawn_between(seed: int, one: Cell, other: Cell) -> float:
    """Draw the standard normal number of a pair of squares."""
    return float(keyed_random(seed, "shadowing", *one, *other).standard_normal())


def parted(robots: Sequence[int], partitions: Sequence[Partition], step: int) -> Links:
    """Return the pairs that no partition separates in a step."""
    together = np.ones((len(robots), len(robots)), np.bool_)
    for partition in partitions:
        if partition.first <= step <= partition.last:
            group = np.array([partition.group_of(robot) for robot in robots], np.int64)
            together &= group[:, None] == group
    return together


@kernel
def walls_crossed(grid: Grid, places: Int64Rows) -> Int64Rows:
    """Count the walls between any two places: runs of occupied cells on the straight line between the cell centers.

    The line visits 4-neighbors only, from the smaller cell to the larger, so it is the same from both ends.
    """
    count = len(places)
    walls = np.zeros((count, count), np.int64)
    for one in range(count):
        for other in range(one):
            crossed = _walls_between(grid, places[one, 0], places[one, 1], places[other, 0], places[other, 1])
            walls[one, other] = walls[other, one] = crossed
    return walls


@kernel
def walls_from(grid: Grid, x: int, y: int) -> Int64Rows:
    """Count the walls between cell (x, y) and each cell, as `walls_crossed` does; shape of `grid`."""
    walls = np.zeros(grid.shape, np.int64)
    for end_y in range(grid.shape[0]):
        for end_x in range(grid.shape[1]):
            walls[end_y, end_x] = _walls_between(grid, x, y, end_x, end_y)
    return walls


@kernel
def _walls_between(grid: Grid, x: int, y: int, end_x: int, end_y: int) -> int:
    if (end_x, end_y) < (x, y):
        x, y, end_x, end_y = end_x, end_y, x, y
    along_x, along_y = abs(end_x - x), abs(end_y - y)
    step_x, step_y = (1 if end_x > x else -1), (1 if end_y > y else -1)
    inside = grid[y, x] == OCCUPIED
    gone_x = gone_y = 0
    crossed = 1 if inside else 0
    while gone_x < along_x or gone_y < along_y:
        if (2 * gone_x + 1) * along_y <= (2 * gone_y + 1) * along_x:
            gone_x += 1
        else:
            gone_y += 1
        wall = grid[y + step_y * gone_y, x + step_x * gone_x] == OCCUPIED
        if wall and not inside:
            crossed += 1
        inside = wall
    return crossed
