"""Goal candidates: which cells are worth going to.

cells          every frontier cell that can be reached
rfe            representatives of free edges (Faigl and Vanek, section 3.2)
anr            the same, but no fewer than there are robots (section 4.3)
breadth-first  one: the frontier cell nearest to the robot that no teammate is headed for (Al-khawaldah
               and Nuechter, Algorithm 1, steps 4 to 7)
hops           the same to the letter: steps of eight directions count one each, and so do neighbours
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent.planning.clusters import medoids
from agent.planning.path_planner import PathPlanner
from agent.planning.utility import sees
from protocol.grid import Grid
from protocol.kernels import kernel

CANDIDATES = ("cells", "rfe", "anr", "breadth-first", "hops")

SEARCHED = ("breadth-first", "hops")
"""Those that a search from the robot's own cell finds, one each."""

Edges = tuple[NDArray[np.int32], NDArray[np.int64]]
"""Cells, edge after edge, and how many each edge has."""

LEAST_CELLS = 3
"""A free edge of fewer cells has no representative while there is one of as many (n_f = 2 in the paper)."""


def goal_candidates(
    kind: str, frontier: NDArray[np.int32], range_cells: float, robots: int
) -> NDArray[np.int32]:
    """The goals that a robot, or its team, may choose from.

    Parameters
    ----------
    kind : str
        One of `CANDIDATES` that is none of `SEARCHED`.
    frontier : int32 array, shape (n, 2)
        Frontier cells (x, y) that can be reached, row by row.
    range_cells : float
        Sensor range of those for whom they are.
    robots : int
        How many robots the goals are for.

    Returns
    -------
    int32 array, shape (m, 2)
        Cells (x, y) of the frontier; empty only if that is.
    """
    if kind == "cells" or not len(frontier):
        return frontier
    return representatives(frontier, range_cells, robots if kind == "anr" else 0)


def searched_candidate(
    kind: str,
    planner: PathPlanner,
    here: tuple[int, int],
    targets: Sequence[tuple[int, int]],
    ranges: ArrayLike,
) -> NDArray[np.int32]:
    """The goal that a search from the robot's cell finds, one of `SEARCHED`.

    Parameters
    ----------
    here : (x, y)
        The robot's cell.
    targets : sequence of (x, y)
        Where teammates are headed.
    ranges : float, or one for each of targets
        Sensor range of these teammates.

    Returns
    -------
    int32 array, shape (1, 2) or (0, 2)
        Empty only if no frontier cell can be reached.
    """
    taken = np.array(targets, np.int32).reshape(-1, 2)
    search = planner.first_by_hops if kind == "hops" else planner.first_frontier
    found = search(*here, taken, np.broadcast_to(np.asarray(ranges, np.float64), len(taken)))
    return np.array([found] if found is not None else [], np.int32).reshape(-1, 2)


def free_edges(cells: NDArray[np.int32]) -> Edges:
    """Part frontier cells as `components`.

    Edges of fewer than `LEAST_CELLS` cells are left out, unless all are that small: they are taken up last,
    so that nothing which can be reached stays unexplored.
    """
    cells, sizes = components(cells)
    large = sizes >= LEAST_CELLS
    return (cells[np.repeat(large, sizes)], sizes[large]) if large.any() else (cells, sizes)


def components(cells: NDArray[np.int32]) -> Edges:
    """Part frontier cells, at least one, into 8-connected components, in the order of their first cells.

    Returns
    -------
    cells : int32 array, shape (n, 2)
        The same, those of a component on end, in their order.
    sizes : int64 array, shape (k,)
        How many each has.
    """
    owner = np.full(len(cells), -1)
    _part(cells, owner)
    return cells[np.argsort(owner, kind="stable")], np.bincount(owner)


def count_representatives(cells: ArrayLike, range_cells: float) -> NDArray[np.int64]:
    """Eq. (1): n_r = 1 + floor(|F| / (1.8 rho) + 0.5)."""
    share = np.asarray(cells) / (1.8 * range_cells)
    return 1 + np.floor(share + 0.5).astype(np.int64)


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
    edges, sizes = free_edges(cells)
    counts = np.minimum(sizes, count_representatives(sizes, range_cells))
    while counts.sum() < min(at_least, len(cells)):
        shares = np.where(counts < sizes, sizes / counts, 0.0)
        if not shares.any():
            break
        counts[np.argmax(shares)] += 1
    return medoids(edges, sizes, counts)[0]


def thin_out(
    grid: Grid, cells: NDArray[np.int32], lengths: NDArray[np.int64], gap: float
) -> NDArray[np.int64]:
    """Leave out representatives that lie nearer than `gap` to one of a longer edge, and in its predictive.

    Parameters
    ----------
    grid : uint8 array, shape (h, w)
        The planning grid; occupied cells on it hide cells from each other.
    cells : int32 array, shape (n, 2)
        Representatives (x, y).
    lengths : int64 array, shape (n,)
        How many cells the edge of each has; of equally long ones the first counts.
    gap : float
        In cells.

    Returns
    -------
    int64 array, shape (m,)
        The numbers of those that stay, the longest edge's first.
    """
    order = np.argsort(-lengths, kind="stable")
    return order[: _thin_out(grid, cells, gap, order)]


@kernel("int64(uint8[:,::1], int32[:,::1], float64, int64[::1])")
def _thin_out(grid: Grid, cells: NDArray[np.int32], gap: float, order: NDArray[np.int64]) -> int:
    """Move those that stay to the front of `order`; return how many they are."""
    kept = 0
    for number in order:
        stays = True
        for other in order[:kept]:
            dx, dy = cells[number, 0] - cells[other, 0], cells[number, 1] - cells[other, 1]
            if dx * dx + dy * dy < gap * gap and sees(grid, cells[number], cells[other], gap) > 0.0:
                stays = False
                break
        if stays:
            order[kept] = number
            kept += 1
    return kept


@kernel("void(int32[:,::1], int64[::1])")
def _part(cells: NDArray[np.int32], owner: NDArray[np.int64]) -> None:
    """Number the 8-connected components of cells in the order of their first cells; `owner` is -1 before."""
    left, top = cells[:, 0].min() - 1, cells[:, 1].min() - 1
    at = np.full((cells[:, 1].max() - top + 2, cells[:, 0].max() - left + 2), -1, np.int32)
    for index in range(len(cells)):
        at[cells[index, 1] - top, cells[index, 0] - left] = index
    waiting = np.empty(len(cells), np.int64)
    count = 0
    for first in range(len(cells)):
        if owner[first] >= 0:
            continue
        owner[first] = count
        waiting[0], left_over = first, 1
        while left_over:
            left_over -= 1
            x, y = cells[waiting[left_over], 0] - left, cells[waiting[left_over], 1] - top
            for ny in range(y - 1, y + 2):
                for nx in range(x - 1, x + 2):
                    index = at[ny, nx]
                    if index >= 0 and owner[index] < 0:
                        owner[index] = count
                        waiting[left_over] = index
                        left_over += 1
        count += 1
