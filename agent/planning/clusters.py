"""K-means with given seeds, so that all robots compute the same clusters of the same cells (Lloyd 1982)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from protocol.arrays import Cells, FloatRows, Int64s
from protocol.kernels import kernel

_ROUNDS = 30
"""Largest number of iterations; k-means ends earlier if no mean moves."""

Points = FloatRows


def k_means(points: Points, seeds: Points) -> tuple[Points, Int64s]:
    """Cluster points around as many means as there are seeds, the initial means; shapes (n, 2) and (k, 2).

    An empty cluster keeps its mean; of equally near means the first counts. Returns the means, and the cluster of each
    point.
    """
    means = seeds.copy()
    owner = np.zeros(len(points), np.int64)
    _lloyd(points, means, owner)
    return means, owner


class Clusters(NamedTuple):
    """Clusters of the points of several groups."""

    medoids: Cells
    """The point of each cluster that is nearest to its mean, shape (n, 2)."""
    groups: Int64s
    """The group of each cluster, shape (n,)."""
    means: Points
    """The mean of each cluster, shape (n, 2)."""


def cluster_groups(points: Cells, sizes: Int64s, counts: Int64s) -> Clusters:
    """Cluster the points of each group around means; empty clusters are left out.

    The initial means are far apart: the first point, then always the point farthest from all means so far. `points`,
    shape (n, 2), follow group after group, different within a group; of equally near points the first counts. `sizes`
    and `counts`, shape (k,), are the points of each group, at least one, and the number of its clusters, at most as
    many.
    """
    found = np.empty((counts.sum(), 2), np.int32)
    groups = np.empty(len(found), np.int64)
    means = np.empty((len(found), 2))
    total = _cluster_each(points, sizes, counts, found, groups, means)
    return Clusters(found[:total], groups[:total], means[:total])


@kernel
def _lloyd(points: Points, means: Points, owner: Int64s) -> None:
    count = len(means)
    total = np.empty((count, 3))
    for _ in range(_ROUNDS):
        total[:] = 0.0
        for at in range(len(points)):
            best = np.inf
            for number in range(count):
                dx, dy = points[at, 0] - means[number, 0], points[at, 1] - means[number, 1]
                distance = dx * dx + dy * dy
                if distance < best:
                    best, owner[at] = distance, number
            total[owner[at], 0] += points[at, 0]
            total[owner[at], 1] += points[at, 1]
            total[owner[at], 2] += 1.0
        moved = False
        for number in range(count):
            if total[number, 2] > 0.0:
                x, y = total[number, 0] / total[number, 2], total[number, 1] / total[number, 2]
                if x != means[number, 0] or y != means[number, 1]:
                    means[number, 0], means[number, 1] = x, y
                    moved = True
        if not moved:
            break


@kernel
def _cluster(points: Points, count: int, out: Cells, means: Points) -> int:
    """Write medoids and means to the first rows of `out` and `means`; return the number of clusters."""
    gap = np.full(len(points), np.inf)
    means = means[:count]
    chosen = 0
    for number in range(count):
        means[number] = points[chosen]
        farthest = -1.0
        for at in range(len(points)):
            dx, dy = points[at, 0] - means[number, 0], points[at, 1] - means[number, 1]
            gap[at] = min(gap[at], dx * dx + dy * dy)
            if gap[at] > farthest:
                farthest, chosen = gap[at], at
    owner = np.zeros(len(points), np.int64)
    _lloyd(points, means, owner)
    best = np.full(count, np.inf)
    nearest = np.full(count, -1)
    for at in range(len(points)):
        number = owner[at]
        dx, dy = points[at, 0] - means[number, 0], points[at, 1] - means[number, 1]
        if dx * dx + dy * dy < best[number]:
            best[number], nearest[number] = dx * dx + dy * dy, at
    found = 0
    for number in range(count):
        if nearest[number] >= 0:
            out[found] = points[nearest[number]].astype(np.int32)
            means[found] = means[number]
            found += 1
    return found


@kernel
def _cluster_each(
    points: Cells, sizes: Int64s, counts: Int64s, found: Cells, groups: Int64s, means: Points
) -> int:
    first, total = 0, 0
    for group in range(len(sizes)):
        size = sizes[group]
        if size == 1:
            found[total] = points[first]
            means[total] = points[first]
            more = 1
        else:
            part = points[first : first + size].astype(np.float64)
            more = _cluster(part, counts[group], found[total:], means[total:])
        groups[total : total + more] = group
        first += size
        total += more
    return total
