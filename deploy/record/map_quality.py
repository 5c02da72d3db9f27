"""How well robots' maps fit the true map: false cells, precision and recall of walls, and F1 within one cell."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid

Mask = NDArray[np.bool_]

AROUND = np.ones((3, 3), np.bool_)
"""A cell and its eight neighbors: the cells within a distance of one cell (Chebyshev)."""

NOISE_CELLS = 4
"""Distance within which noisy lasers and poses displace cells of an honest map."""

FALSE_SHARE = 0.1
"""Share of the known cells of an honest map of a noisy laser that may be false even so."""


def share_false(own: Grid, truth: Grid, *, noisy: bool) -> float:
    """Return the share of the known cells of a robot's own map that are false.

    Without noise, a cell is false if its state is not the true one. With noise, it is false if no cell within
    `NOISE_CELLS` has its state.
    """
    solid, known = truth != FREE, own != UNKNOWN
    if noisy:
        near_solid = binary_dilation(solid, AROUND, NOISE_CELLS, border_value=1)
        near_free = binary_dilation(~solid, AROUND, NOISE_CELLS)
    else:
        near_solid, near_free = solid, ~solid
    false = ((own == OCCUPIED) & ~near_solid) | ((own == FREE) & ~near_free)
    return float(false.sum() / max(known.sum(), 1))


def is_refuted(own: Grid, truth: Grid, reachable: Mask, seen: int, *, noisy: bool) -> bool:
    """Return whether an own map is false, or has more free cells than the `seen` ones of the whole team."""
    if noisy:
        return share_false(own, truth, noisy=True) > FALSE_SHARE
    return share_false(own, truth, noisy=False) > 0 or bool(((own == FREE) & reachable).sum() > seen)


def wall_f1(grid: Grid, truth: Grid, reachable: Mask, *, recorded: bool = False) -> float | None:
    """Return the F1 score of the walls of a map, within one cell; None if it or the true map has none.

    Precision is the share of its walls with a true wall within one cell; recall is the share of the true walls beside
    reachable cells that have one of its walls within one cell. Unknown cells of the true map are walls, unless the map
    was made of recorded scans.
    """
    found, solid = grid == OCCUPIED, truth == OCCUPIED if recorded else truth != FREE
    walls = solid & binary_dilation(reachable)
    if not (found.any() and walls.any()):
        return None
    precision = float(binary_dilation(solid, AROUND, border_value=1)[found].mean())
    recall = float(binary_dilation(found, AROUND)[walls].mean())
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0


def wall_quality(
    planning: Mapping[int, Grid], first: int, truth: Grid, reachable: Mask, *, recorded: bool = False
) -> dict[str, float | None]:
    """Return precision, recall and F1 of the walls on the first robot's planning grid, and the minima of all robots.

    Precision is the share of its occupied cells that are truly occupied; cells of unknown truth do not count. Recall is
    the share of the true walls, occupied 4-neighbors of reachable cells, that it has as occupied. Without any cells
    a value is None.
    """
    walls = (truth == OCCUPIED) & binary_dilation(reachable)
    precision, recall, f1 = {}, {}, {}
    for robot, grid in planning.items():
        occupied = (grid == OCCUPIED) & (truth != UNKNOWN)
        precision[robot] = float((truth[occupied] == OCCUPIED).mean()) if occupied.any() else None
        recall[robot] = float((grid[walls] == OCCUPIED).mean()) if walls.any() else None
        f1[robot] = wall_f1(grid, truth, reachable, recorded=recorded)
    found: dict[str, float | None] = {}
    for name, values in (("wall_precision", precision), ("wall_recall", recall), ("wall_f1", f1)):
        found[f"claimed_{name}"] = values.get(first)
        found[f"claimed_worst_{name}"] = min(
            (value for value in values.values() if value is not None), default=None
        )
    return found
