"""Baselines of the kernels: the same results from numpy, OpenCV and skimage."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.outline.polygons import Polygons
from protocol.grid import FREE, OCCUPIED, Grid, RayTable

Cell = tuple[int, int]


def optional_module(module: str, package: str) -> Any:
    """Import a module that only benchmarks need; ValueError names the missing package."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise ValueError(
            f"the benchmark compares with {package}, which is not installed: "
            "install it, or murmur-robots with its extra bench"
        ) from None


def scan_in_numpy(truth: Grid, beams: RayTable, cell: Cell, known: Grid) -> None:
    """Cast a scan without teammates in view, and draw it: all beams at once."""
    height, width = truth.shape
    x, y = beams.cells[:, 0] + cell[0], beams.cells[:, 1] + cell[1]
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    solid = ~inside
    solid[inside] = truth[y[inside], x[inside]] != FREE
    stops = np.cumsum(solid)
    behind = stops - np.repeat(np.concatenate(([0], stops))[beams.start[:-1]], np.diff(beams.start))
    wall, floor = inside & solid & (behind == 1), behind == 0
    known[y[wall], x[wall]] = OCCUPIED
    known[y[floor], x[floor]] = FREE
    known[cell[1], cell[0]] = FREE


def trace_by_opencv(cv2: Any, grid: Grid, solid: Grid) -> Sequence[NDArray[np.int32]]:
    """Find the contours of a grid; `solid` is a work array of ones with a border around the grid."""
    np.not_equal(grid, FREE, out=solid[1:-1, 1:-1].view(np.bool_))
    found: Sequence[NDArray[np.int32]]
    found, _ = cv2.findContours(solid, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    return found


def cells_along(polygons: Polygons) -> list[list[Cell]]:
    """The cells along each contour, in OpenCV's form."""
    cycles = []
    for first, end in zip(polygons.start[:-1].tolist(), polygons.start[1:].tolist(), strict=True):
        along = list(zip(polygons.x[first:end].tolist(), polygons.y[first:end].tolist(), strict=True))
        cycle = [cell for before, cell in zip([along[-1], *along], along, strict=False) if cell != before]
        cycles.append(_rotated(cycle or along[:1]))
    return sorted(cycles)


def without_frame(found: Sequence[NDArray[np.int32]]) -> list[list[Cell]]:
    """OpenCV's contours without the border of the picture."""
    cycles = [[(x - 1, y - 1) for x, y in contour[:, 0].tolist()] for contour in found]
    return sorted(_rotated(cycle) for cycle in cycles if (-1, -1) not in cycle)


def _rotated(cycle: list[Cell]) -> list[Cell]:
    """The same cycle, rotated to its lexicographically smallest form."""
    first = min(cycle)
    return min(cycle[i:] + cycle[:i] for i, cell in enumerate(cycle) if cell == first)


def costs_by_skimage(graph: Any, grid: Grid, cell: Cell) -> NDArray[np.float64]:
    """Lengths of shortest paths whose diagonal steps need both adjacent cells free, by skimage.

    Layer 0 has the cells at even positions and the midpoints between straight neighbors. Layer 1, at distance 0 above,
    has the corners whose four cells are all free. Diagonal steps change layers, straight steps do not.
    """
    free = grid == FREE
    open_ = np.zeros((2, 2 * grid.shape[0] - 1, 2 * grid.shape[1] - 1), np.bool_)
    open_[0, ::2, ::2] = free
    open_[0, 1::2, ::2] = free[1:] & free[:-1]
    open_[0, ::2, 1::2] = free[:, 1:] & free[:, :-1]
    open_[1, 1::2, 1::2] = free[1:, 1:] & free[:-1, 1:] & free[1:, :-1] & free[:-1, :-1]
    steps = [(0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    steps += [(up, dy, dx) for up in (-1, 1) for dy in (-1, 1) for dx in (-1, 1)]
    paths = graph.MCP_Geometric(np.where(open_, 1.0, -1.0), offsets=steps, sampling=(1e-12, 0.5, 0.5))
    found: NDArray[np.float64] = paths.find_costs([(0, 2 * cell[1], 2 * cell[0])])[0][0, ::2, ::2]
    return found
