"""Goal candidates: a selection of the frontier cells.

cells          every reachable frontier cell
rfe            representatives of frontier segments ("free edges" in Faigl and Vanek 2014, section 3.2)
anr            the same, at least as many as robots (section 4.3)
breadth-first  one cell: the nearest frontier cell that no teammate drives to (Al-khawaldah and Nuechter 2014,
               Algorithm 1, steps 4 to 7)
hops           the same exactly as in the paper: steps and frontier cells use all eight neighbors
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from agent.planning.clusters import Clusters, cluster_groups
from agent.planning.path_planner import PathPlanner
from agent.planning.utility import sees
from protocol.arrays import Bools, Cells, Int64s
from protocol.grid import Cell, Grid
from protocol.kernels import kernel

CANDIDATES = ("cells", "rfe", "anr", "breadth-first", "hops")

SEARCHED = ("breadth-first", "hops")
"""Candidates that a search from the robot's cell finds, one cell each."""

Segments = tuple[Cells, Int64s]
"""Cells, segment after segment, and the number of cells of each segment."""

LEAST_CELLS = 3
"""Shorter frontier segments have no representative unless all are shorter (n_f = 2 in the paper)."""


def goal_candidates(kind: str, frontier: Cells, range_cells: float, robots: int) -> Cells:
    """Return the goals that a robot or its team chooses from: cells of the frontier, empty only for an empty frontier.

    `kind` is one of `CANDIDATES`, but none of `SEARCHED`; `frontier` has the reachable frontier cells, row by row;
    `range_cells` is the sensor range; `robots` robots choose.
    """
    if kind == "cells" or not len(frontier):
        return frontier
    return representatives(frontier, range_cells, robots if kind == "anr" else 0)


def searched_candidate(
    kind: str,
    planner: PathPlanner,
    here: Cell,
    targets: Sequence[Cell],
    ranges: ArrayLike,
) -> Cells:
    """Return the goal that a search from the robot's cell `here` finds; no cell only if no frontier cell is reachable.

    `kind` is one of `SEARCHED`; `targets` are those of teammates, `ranges` the sensor range of each of them in cells.
    """
    search = planner.first_by_hops if kind == "hops" else planner.first_frontier
    found = search(*here, np.array(targets, np.int32).reshape(-1, 2), ranges)
    return np.array([found] if found is not None else [], np.int32).reshape(-1, 2)


def frontier_segments(cells: Cells) -> Segments:
    """Split frontier cells into segments, as `components` does, without those of fewer than `LEAST_CELLS` cells.

    If all segments are that small, all stay: robots visit them last, so that no reachable cell stays unexplored.
    """
    cells, sizes = components(cells)
    large = sizes >= LEAST_CELLS
    return (cells[np.repeat(large, sizes)], sizes[large]) if large.any() else (cells, sizes)


def large_segments(cells: Cells) -> Cells:
    """Return the frontier cells, row by row, that are not in segments of fewer than `LEAST_CELLS` cells."""
    if not len(cells):
        return cells
    owner = np.full(len(cells), -1)
    _label(cells, owner)
    large: Cells = cells[np.bincount(owner)[owner] >= LEAST_CELLS]
    return large


def components(cells: Cells) -> Segments:
    """Split frontier cells, at least one, into 8-connected components, in the order of their first cells.

    `scipy.ndimage.label` gives the same, but takes up to 100 times as long on large grids, which it scans in full.

    Returns the same cells, component after component, and the number of cells of each component.
    """
    owner = np.full(len(cells), -1)
    _label(cells, owner)
    return cells[np.argsort(owner, kind="stable")], np.bincount(owner)


def count_representatives(cells: ArrayLike, range_cells: float) -> Int64s:
    """Return the number of representatives of segments: Eq. (1), n_r = 1 + floor(|F| / (1.8 rho) + 0.5)."""
    share = np.asarray(cells) / (1.8 * range_cells)
    return 1 + np.floor(share + 0.5).astype(np.int64)


def representatives(cells: Cells, range_cells: float, at_least: int = 0) -> Cells:
    """Represent each frontier segment by the medoids of its clusters, which are cells of the frontier.

    Parameters are those of `segment_clusters`.
    """
    return segment_clusters(cells, range_cells, at_least).medoids


def segment_clusters(cells: Cells, range_cells: float, at_least: int) -> Clusters:
    """Divide each frontier segment into clusters; its number of cells and the sensor range give their number.

    `cells` are frontier cells, shape (n, 2), row by row, at least one; `range_cells` is the sensor range rho in cells.
    Until there are `at_least` clusters (ANR), or every cell is one, the segment with the most cells per cluster gets
    another one.
    """
    segments, sizes = frontier_segments(cells)
    counts = np.minimum(sizes, count_representatives(sizes, range_cells))
    while counts.sum() < min(at_least, len(cells)):
        shares = np.where(counts < sizes, sizes / counts, 0.0)
        if not shares.any():
            break
        counts[np.argmax(shares)] += 1
    return cluster_groups(segments, sizes, counts)


def mean_goals(grid: Grid, clusters: Clusters, is_reached: Bools, robots: Cells, range_cells: float) -> Cells:
    """Return the goal of each cluster: its mean, rounded to a cell, or its medoid if the mean would show nothing new.

    The mean is the goal if a robot reaches it (`is_reached`, shape (n,)), and if its medoid is in sight within the
    sensor range, on the planning grid. It is not if a robot is there already, as its scanner has left the frontier. No
    two goals are equal. `robots` are the cells of the robots, shape (m, 2).
    """
    goals = clusters.medoids.copy()
    taken = {(x, y) for x, y in [*goals.tolist(), *robots.tolist()]}
    for number in np.flatnonzero(is_reached):
        mean = np.rint(clusters.means[number]).astype(np.int32)
        if (int(mean[0]), int(mean[1])) not in taken and sees(grid, mean, goals[number], range_cells) > 0.0:
            goals[number] = mean
            taken.add((int(mean[0]), int(mean[1])))
    return goals


def thin_out(grid: Grid, cells: Cells, lengths: Int64s, gap: float) -> Int64s:
    """Remove representatives that are in sight of a representative of a longer segment, nearer to it than `gap` cells.

    Occupied cells of the planning grid block the line of sight. `lengths`, shape (n,), has the number of cells of each
    segment; of equally long segments the first counts. Returns the indices of the representatives that stay, the
    longest segment first.
    """
    order = np.argsort(-lengths, kind="stable")
    return order[: _thin_out(grid, cells, gap, order)]


@kernel
def _thin_out(grid: Grid, cells: Cells, gap: float, order: Int64s) -> int:
    """Move the representatives that stay to the front of `order`; return their number."""
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


@kernel
def _label(cells: Cells, owner: Int64s) -> None:
    """Write the component of each cell to `owner`, which is -1 before; components are numbered by their first cells."""
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
