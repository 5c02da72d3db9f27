"""Cells, way points and grids as bytes, in messages and files."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from protocol.errors import ProtocolError
from protocol.grid import Grid


def cells_to_bytes(cells: NDArray[np.int32]) -> bytes:
    """Write cells, shape (n, 2), as little-endian int16 pairs x, y."""
    return cells.astype("<i2").tobytes()


def cells_from_bytes(data: bytes) -> NDArray[np.int32]:
    """Read the output of `cells_to_bytes`."""
    return np.frombuffer(data, "<i2").astype(np.int32).reshape(-1, 2)


def grid_to_bytes(grid: Grid) -> bytes:
    """Write a grid, two bits per cell, the first cell in the highest bits; each row is padded to a whole byte."""
    padded = np.zeros((grid.shape[0], -(-grid.shape[1] // 4) * 4), np.uint8)
    padded[:, : grid.shape[1]] = grid
    return (padded[:, ::4] << 6 | padded[:, 1::4] << 4 | padded[:, 2::4] << 2 | padded[:, 3::4]).tobytes()


def grid_from_bytes(data: bytes, width: int, height: int) -> Grid:
    """Read the output of `grid_to_bytes`; ProtocolError if the length does not fit that size."""
    row = -(-width // 4)
    if width < 1 or height < 1 or len(data) != row * height:
        raise ProtocolError("grid", 0, f"{len(data)} bytes are not {width} x {height} cells")
    packed = np.frombuffer(data, np.uint8).reshape(height, row)
    grid = np.stack([packed >> 6, packed >> 4 & 3, packed >> 2 & 3, packed & 3], axis=2)
    return np.ascontiguousarray(grid.reshape(height, -1)[:, :width])


def points_to_bytes(points: NDArray[np.int32]) -> bytes:
    """Write way points, shape (n, 2), in thousandths of a cell, as little-endian int32 pairs x, y."""
    return points.astype("<i4").tobytes()


def points_from_bytes(data: bytes) -> NDArray[np.int32]:
    """Read the output of `points_to_bytes`."""
    return np.frombuffer(data, "<i4").astype(np.int32).reshape(-1, 2)
