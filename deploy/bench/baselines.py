"""Baselines of the kernels: numpy, OpenCV and skimage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.bench.measurement import timed
from protocol.grid import FREE, OCCUPIED, Cell, Grid, RayTable


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


def skimage_costs_ms(graph: Any, grid: Grid, cell: Cell) -> float:
    """Processor time of skimage's paths from a cell to all free cells, in milliseconds."""
    prices = np.where(grid == FREE, 1.0, -1.0)
    return timed(lambda: graph.MCP_Geometric(prices).find_costs([cell[::-1]]))[1]
