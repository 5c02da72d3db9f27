"""Test input for polygons: random grids, real maps, and explorations that grow a map step by step."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, ray_table

REAL_MAPS = Path(os.environ.get("MURMUR_MAPS", Path(__file__).parents[3] / "shared" / "maps"))

Cell = tuple[int, int]


@cache
def real_map(name: str) -> Grid:
    """Read one of the real maps as cells; skip the test where they are not at hand."""
    path = REAL_MAPS / f"{name}.png"
    if not path.exists():
        pytest.skip(f"no {path}: set MURMUR_MAPS to the folder of the real maps")
    picture = np.asarray(Image.open(path))
    grid = np.full(picture.shape, UNKNOWN, np.uint8)
    grid[picture > 250] = FREE
    grid[picture < 90] = OCCUPIED
    grid.flags.writeable = False
    return grid


@st.composite
def grids(draw: st.DrawFn, max_side: int = 14) -> tuple[Grid, Cell]:
    """Random cells, from nearly empty to diagonals, pockets and one-cell corridors; and a free cell."""
    sides = st.integers(1, max_side) | st.just(max_side)
    height, width = draw(sides), draw(sides)
    free = draw(st.sampled_from((0.7, 0.8, 0.6, 0.9)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    chances = (free, (1 - free) / 2, (1 - free) / 2)
    grid = rng.choice(np.array([FREE, OCCUPIED, UNKNOWN], np.uint8), (height, width), p=chances)
    x, y = int(rng.integers(width)), int(rng.integers(height))
    grid[y, x] = FREE
    return grid, (x, y)


@st.composite
def growing_maps(draw: st.DrawFn, max_side: int = 14) -> list[tuple[Grid, Cell]]:
    """A world that is uncovered patch by patch, in any order, also where the robot cannot see it yet.

    Now and then a known cell changes. Objects are born, vanish, split and join.
    """
    world, robot = draw(grids(max_side))
    height, width = world.shape
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    known = np.full(world.shape, UNKNOWN, np.uint8)
    known[robot[1], robot[0]] = FREE
    steps = [(known, robot)]
    for _ in range(draw(st.integers(3, 16))):
        known = known.copy()
        y, x = int(rng.integers(-5, height)), int(rng.integers(-5, width))
        patch = slice(max(0, y), y + 8), slice(max(0, x), x + 8)
        known[patch] = world[patch]
        if rng.random() < 0.3:
            known[rng.integers(height), rng.integers(width)] = rng.choice([FREE, OCCUPIED])
        known[robot[1], robot[0]] = FREE
        steps.append((known, robot))
    return steps


def real_fragment(name: str, rng: np.random.Generator, side: int) -> tuple[Grid, Cell]:
    """Cut a square with a free cell out of a real map."""
    world = real_map(name)
    while True:
        y, x = (int(rng.integers(0, max(1, length - side))) for length in world.shape)
        part = world[y : y + side, x : x + side].copy()
        free = np.argwhere(part == FREE)
        if len(free):
            row, column = free[rng.integers(len(free))].tolist()
            return part, (column, row)


def exploration(
    world: Grid, rng: np.random.Generator, steps: int, range_cells: float
) -> Iterator[tuple[Grid, Cell]]:
    """Let a robot wander through a world and see; yield its map and cell after each step.

    It heads for a random free cell of its map, moves some cells towards it and sees again.
    """
    free = np.argwhere(world == FREE)
    y, x = free[rng.integers(len(free))].tolist()
    known = np.full(world.shape, UNKNOWN, np.uint8)
    way: list[Cell] = []
    for _ in range(steps):
        for _ in range(5):
            if not way:
                way = _way(known, (x, y), rng)
            if way:
                x, y = way.pop()
        see(world, known, (x, y), range_cells)
        yield known.copy(), (x, y)


def see(world: Grid, known: Grid, robot: Cell, range_cells: float) -> None:
    """Cast all beams from the robot's cell and enter what they meet."""
    beams = ray_table(range_cells)
    x, y = beams.cells[:, 0] + robot[0], beams.cells[:, 1] + robot[1]
    height, width = world.shape
    on_map = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    truth = np.where(on_map, world[y.clip(0, height - 1), x.clip(0, width - 1)], UNKNOWN)
    stops = np.cumsum(truth != FREE)
    before = np.concatenate(([0], stops))[beams.start[:-1]]
    behind = stops - np.repeat(before, np.diff(beams.start))
    seen = (behind == 0) | ((behind == 1) & (truth == OCCUPIED))
    known[y[seen], x[seen]] = truth[seen]
    known[robot[1], robot[0]] = FREE


def _way(known: Grid, robot: Cell, rng: np.random.Generator) -> list[Cell]:
    """Cells to a random known free cell, the last one first."""
    if known[robot[1], robot[0]] != FREE:
        return []
    distance = np.full(known.shape, -1, np.int32)
    distance[robot[1], robot[0]] = 0
    wave = [robot]
    reached = [robot]
    while wave:
        ahead = []
        for x, y in wave:
            for to_x, to_y in _around(known, x, y):
                if distance[to_y, to_x] < 0:
                    distance[to_y, to_x] = distance[y, x] + 1
                    ahead.append((to_x, to_y))
        wave = ahead
        reached += ahead
    x, y = reached[int(len(reached) * (1 - rng.random() ** 4))]
    way = []
    while distance[y, x] > 0:
        way.append((x, y))
        x, y = next(cell for cell in _around(known, x, y) if distance[cell[1], cell[0]] == distance[y, x] - 1)
    return way


def _around(known: NDArray[np.uint8], x: int, y: int) -> list[Cell]:
    height, width = known.shape
    around = ((x + 1, y), (x, y + 1), (x - 1, y), (x, y - 1))
    return [(a, b) for a, b in around if 0 <= a < width and 0 <= b < height and known[b, a] == FREE]
