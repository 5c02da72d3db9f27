"""Slow, plain counterparts of the planning kernels, and small maps to try them on."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.settings import EncodingSettings, MediumSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid

Cell = tuple[int, int]

ONE = 1 << 42
ROOT = round(math.sqrt(2) * ONE)
"""Lengths of a straight and of a diagonal step, in whole numbers."""


def drawn(*rows: str) -> Grid:
    """A grid drawn with `.` for free, `#` for occupied and `?` for unknown cells."""
    meaning = {".": FREE, "#": OCCUPIED, "?": UNKNOWN}
    return np.array([[meaning[sign] for sign in row] for row in rows], np.uint8)


@st.composite
def grids(draw: st.DrawFn, most: int = 14) -> Grid:
    """Small grids, from open to cluttered."""
    height, width = draw(st.integers(1, most)), draw(st.integers(1, most))
    walls = draw(st.sampled_from([0.0, 0.1, 0.3]))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return random.choice(
        np.array([UNKNOWN, FREE, OCCUPIED], np.uint8), (height, width), p=[walls / 2, 1 - 1.5 * walls, walls]
    )


@st.composite
def floors(draw: st.DrawFn) -> tuple[Grid, int, int]:
    """Open floors, clutter, mazes and comb-like corridors; and a cell, sometimes not a free one."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    height, width = rng.integers(1, 31, 2)
    grid = np.full((height, width), FREE, np.uint8)
    kind = draw(st.sampled_from(("clutter", "maze", "blocks", "comb")))
    if kind == "clutter":
        grid[rng.random((height, width)) < draw(st.sampled_from((0.02, 0.1, 0.3, 0.45)))] = OCCUPIED
    elif kind == "maze":
        grid[1::2, 1::2] = OCCUPIED
        for y, x in np.argwhere(grid == OCCUPIED):
            dy, dx = [(0, 1), (1, 0), (0, -1), (-1, 0)][rng.integers(4)]
            grid[max(0, min(y + dy, height - 1)), max(0, min(x + dx, width - 1))] = OCCUPIED
    elif kind == "blocks":
        for _ in range(rng.integers(1, 9)):
            y, x = rng.integers(height), rng.integers(width)
            grid[y : y + rng.integers(1, 9), x : x + rng.integers(1, 9)] = rng.choice([OCCUPIED, UNKNOWN])
    else:
        grid[:, 1::3] = OCCUPIED
        grid[rng.integers(0, height, width), np.arange(width)] = FREE
    grid[rng.random((height, width)) < 0.02] = UNKNOWN
    return grid, int(rng.integers(width)), int(rng.integers(height))


def steps_from(grid: Grid, x: int, y: int) -> Iterator[tuple[int, int, float]]:
    """Cells that a robot can enter next, with the lengths of the steps."""
    height, width = grid.shape
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            nx, ny = x + dx, y + dy
            if (dx, dy) == (0, 0) or not (0 <= nx < width and 0 <= ny < height) or grid[ny, nx] != FREE:
                continue
            if dx and dy and (grid[y, nx] != FREE or grid[ny, x] != FREE):
                continue
            yield nx, ny, math.hypot(dx, dy)


def dijkstra(grid: Grid, x: int, y: int, weights: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """Cost of the best way from (x, y) to every cell."""
    field = np.full(grid.shape, np.inf)
    field[y, x] = 0.0
    queue = [(0.0, x, y)]
    while queue:
        base, cx, cy = heapq.heappop(queue)
        for nx, ny, length in steps_from(grid, cx, cy):
            new = base + length * (1.0 if weights is None else weights[ny, nx])
            if new < field[ny, nx] - 1e-12:
                field[ny, nx] = new
                heapq.heappush(queue, (new, nx, ny))
    return field


def whole_lengths(grid: Grid, x: int, y: int) -> NDArray[np.float64]:
    """Dijkstra's search with lengths in whole numbers, and no trick at all."""
    lengths = {(x, y): 0}
    queue = [(0, x, y)]
    while queue:
        base, cx, cy = heapq.heappop(queue)
        if base > lengths[cx, cy]:
            continue
        for nx, ny, step in steps_from(grid, cx, cy):
            new = base + (ONE if step == 1 else ROOT)
            if new < lengths.get((nx, ny), 1 << 62):
                lengths[nx, ny] = new
                heapq.heappush(queue, (new, nx, ny))
    field = np.full(grid.shape, np.inf)
    for (cx, cy), length in lengths.items():
        field[cy, cx] = length / ONE
    return field


def settings_for(
    grid: Grid,
    robot: int = 0,
    robots: int = 2,
    *,
    ranges_cells: Sequence[float] = (),
    radii_cells: Sequence[float] = (),
    speed_cells: float = 3.0,
    field_of_view: float = 360.0,
    scanner_turn: float = 0.0,
    map_encoding: str = "none",
    dissemination: str = "backoff",
    **others: Any,
) -> Settings:
    """A robot's task on a small grid; without ranges and radii, all robots are points that see 5 cells far."""
    ranges, radii = ranges_cells or [5.0] * robots, radii_cells or [0.0] * robots
    bodies = [
        Body(cells, field_of_view, speed_cells, scanner_turn, radius)
        for cells, radius in zip(ranges, radii, strict=True)
    ]
    given: dict[str, Any] = {
        "robot": robot, "bodies": tuple(bodies), "width": grid.shape[1], "height": grid.shape[0], "beams": 360,
        "seed": 0, "strategy": "meier", "encoding": EncodingSettings(map_encoding),
        "replication": ReplicationSettings(dissemination), "medium": MediumSettings(reach_cells=100.0),
    }  # fmt: skip
    return Settings(**(given | others))
