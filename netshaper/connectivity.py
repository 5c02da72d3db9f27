"""Who hears whom: everyone within the communication range, a disc (docs/architecture.md, A step)."""

from __future__ import annotations

from collections.abc import Mapping


def in_range(cells: Mapping[int, tuple[int, int]], range_cells: float) -> dict[int, list[int]]:
    """For each robot the teammates at most `range_cells` away (cell centres), in ascending order."""
    limit = range_cells * range_cells
    return {
        one: [
            other
            for other, (other_x, other_y) in sorted(cells.items())
            if other != one and (x - other_x) ** 2 + (y - other_y) ** 2 <= limit
        ]
        for one, (x, y) in sorted(cells.items())
    }
