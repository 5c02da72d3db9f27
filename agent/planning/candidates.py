"""Goal candidates: which cells are worth going to.

cells          every frontier cell that can be reached
rfe            representatives of free edges (Faigl and Vanek, section 3.2)
anr            the same, but no fewer than there are robots (section 4.3)
breadth-first  one: the frontier cell nearest to the robot that no teammate is headed for (Al-khawaldah
               and Nuechter, Algorithm 1, steps 4 to 7)
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from agent.planning.clusters import medoids
from agent.planning.ways import Ways

CANDIDATES = ("cells", "rfe", "anr", "breadth-first")

LEAST_CELLS = 3
"""A free edge of fewer cells has no representative while there is one of as many (n_f = 2 in the paper)."""


def goal_candidates(
    kind: str,
    ways: Ways,
    here: tuple[int, int],
    range_cells: float,
    robots: int,
    targets: Sequence[tuple[int, int]],
) -> NDArray[np.int32]:
    """The goals that a robot, or its team, may choose from.

    Parameters
    ----------
    kind : str
        One of `CANDIDATES`.
    here : (x, y)
        The robot's cell: only what it can reach counts.
    range_cells : float
        Its sensor range.
    robots : int
        How many robots the goals are for.
    targets : sequence of (x, y)
        Where teammates are headed.

    Returns
    -------
    int32 array, shape (n, 2)
        Cells (x, y) of the frontier; empty only if no frontier cell can be reached.
    """
    if kind == "breadth-first":
        taken = np.array(targets, np.int32).reshape(-1, 2)
        found = ways.first_frontier(*here, taken, range_cells)
        return np.array([found] if found is not None else [], np.int32).reshape(-1, 2)
    cells = ways.frontier(*here)
    if kind == "cells" or not len(cells):
        return cells
    return representatives(cells, range_cells, robots if kind == "anr" else 0)


def free_edges(cells: NDArray[np.int32]) -> list[NDArray[np.int32]]:
    """Part frontier cells into 8-connected components, in the order of their first cells.

    Edges of fewer than `LEAST_CELLS` cells are left out, unless all are that small: they are taken up last,
    so that nothing which can be reached stays unexplored.
    """
    x0, y0 = cells.min(axis=0)
    x1, y1 = cells.max(axis=0)
    mask = np.zeros((y1 - y0 + 1, x1 - x0 + 1), np.bool_)
    mask[cells[:, 1] - y0, cells[:, 0] - x0] = True
    labels, count = ndimage.label(mask, np.ones((3, 3)))
    owner = labels[cells[:, 1] - y0, cells[:, 0] - x0]
    order = np.argsort(owner, kind="stable")
    edges = np.split(cells[order], np.flatnonzero(np.diff(owner[order])) + 1)
    assert len(edges) == count
    return [edge for edge in edges if len(edge) >= LEAST_CELLS] or edges


def count_representatives(cells: int, range_cells: float) -> int:
    """Eq. (1): n_r = 1 + floor(|F| / (1.8 rho) + 0.5)."""
    return 1 + math.floor(cells / (1.8 * range_cells) + 0.5)


def representatives(cells: NDArray[np.int32], range_cells: float, at_least: int = 0) -> NDArray[np.int32]:
    """Represent each free edge by the means of its clusters, each put on the cluster's cell nearest to it.

    Parameters
    ----------
    cells : int32 array, shape (n, 2)
        Frontier cells (x, y), row by row; at least one.
    range_cells : float
        Sensor range rho in cells.
    at_least : int
        How many goals there shall be (ANR): the edge with the most cells a representative gets one more
        until there are that many, or every cell is one.

    Returns
    -------
    int32 array, shape (m, 2)
        Cells of the frontier, no two alike.
    """
    edges = free_edges(cells)
    counts = [min(len(edge), count_representatives(len(edge), range_cells)) for edge in edges]
    while sum(counts) < min(at_least, len(cells)):
        shares = [
            len(edge) / count if count < len(edge) else 0.0 for edge, count in zip(edges, counts, strict=True)
        ]
        if not any(shares):
            break
        counts[int(np.argmax(shares))] += 1
    return np.concatenate([medoids(edge, count) for edge, count in zip(edges, counts, strict=True)])
