"""Who hears whom: everyone within the communication range, a disc (docs/architecture.md, A step)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def in_range(cells: Mapping[int, tuple[int, int]], range_cells: float) -> dict[int, list[int]]:
    """For each robot the teammates at most `range_cells` away (cell centres), in ascending order."""
    robots = sorted(cells)
    x, y = np.array([cells[robot] for robot in robots], np.int64).reshape(-1, 2).T
    near = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2 <= range_cells * range_cells
    return {
        one: [other for other, hears in zip(robots, row, strict=True) if hears and other != one]
        for one, row in zip(robots, near.tolist(), strict=True)
    }
