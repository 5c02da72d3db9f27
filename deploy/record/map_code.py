"""The context code of a map: about the fewest bytes that describe it without prior knowledge of the building.

A cell is coded with the probability that its state had so far after the same states of six neighbors, as in JBIG
(ITU-T T.82) and with the estimator of Krichevsky and Trofimov (1981). The length of such a code does not depend on the
order of the cells, only on how often each state follows each context.
"""

from __future__ import annotations

import math

import numpy as np

from protocol.grid import Grid

NEIGHBORS = ((0, -1), (-1, 0), (-1, -1), (-1, 1), (0, -2), (-2, 0))
"""Cells before a cell (row, column) whose states are its context. More of them shorten no code of a real building."""

STATES = 3

PRIOR = 0.1
"""Occurrences of each state that a context has from the beginning: most contexts determine the state."""

_REACH = 2


def map_code_figures(grid: Grid | None, sent: int) -> dict[str, float | None]:
    """Return the length of the context code of a map, and by how many times a team's `sent` bytes exceed it.

    Both are None if there is no map, or nothing on it.
    """
    if grid is None or not grid.any():
        return {"map_code_bytes": None, "map_code_multiple": None}
    code = map_code_bytes(grid)
    return {"map_code_bytes": round(code, 1), "map_code_multiple": round(sent / code, 3)}


def map_code_bytes(grid: Grid) -> float:
    """Return the length in bytes of the context code of a grid, uint8 of shape (h, w); cells outside are unknown."""
    height, width = grid.shape
    around = np.pad(grid.astype(np.int64), _REACH)
    context = np.zeros(grid.shape, np.int64)
    for y, x in NEIGHBORS:
        shifted = around[_REACH + y : _REACH + y + height, _REACH + x : _REACH + x + width]
        context = STATES * context + shifted
    contexts = STATES ** len(NEIGHBORS)
    counts = np.bincount((STATES * context + grid).ravel(), minlength=STATES * contexts).reshape(-1, STATES)
    nats = sum(map(_length, counts[counts.any(axis=1)].tolist()))
    return nats / math.log(2) / 8


def _length(counts: list[int]) -> float:
    """Return the length in nats of the code of all states after one context."""
    of_states = sum(math.lgamma(PRIOR) - math.lgamma(count + PRIOR) for count in counts)
    return math.lgamma(sum(counts) + STATES * PRIOR) - math.lgamma(STATES * PRIOR) + of_states
