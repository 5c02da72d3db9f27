"""Random spanning trees of rectangular lattices: the passages of mazes and caves."""

from __future__ import annotations

import numpy as np


def spanning_tree(
    random: np.random.Generator, columns: int, rows: int
) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Draw a spanning tree of a lattice by a randomized depth-first search, which makes long winding passages.

    Returns the pairs of neighbors that the tree joins, and all other pairs. A place is the number row * columns +
    column; the lower number comes first in a pair.
    """
    joined: dict[tuple[int, int], None] = {}
    first = int(random.integers(columns * rows))
    visited, path = {first}, [first]
    while path:
        here = path[-1]
        ahead = [place for place in _neighbors(here, columns, rows) if place not in visited]
        if not ahead:
            path.pop()
            continue
        there = ahead[int(random.integers(len(ahead)))]
        joined[min(here, there), max(here, there)] = None
        visited.add(there)
        path.append(there)
    pairs = (
        (here, there)
        for here in range(columns * rows)
        for there in _neighbors(here, columns, rows)
        if here < there
    )
    return list(joined), [pair for pair in pairs if pair not in joined]


def _neighbors(place: int, columns: int, rows: int) -> list[int]:
    """Return the places left, right, above, and below."""
    row, column = divmod(place, columns)
    found = []
    if column > 0:
        found.append(place - 1)
    if column < columns - 1:
        found.append(place + 1)
    if row > 0:
        found.append(place - columns)
    if row < rows - 1:
        found.append(place + columns)
    return found
