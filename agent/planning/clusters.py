"""K-means with given seeds: no draw decides anything, so all robots cluster the same cells alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from protocol.kernels import kernel

_ROUNDS = 100
"""K-means ends when nothing moves, or after so many rounds."""

Points = NDArray[np.float64]


def k_means(points: Points, seeds: Points) -> tuple[Points, NDArray[np.int64]]:
    """Cluster points around as many means as there are seeds (Lloyd).

    A cluster that runs empty keeps its mean; of equally near means the first counts.

    Parameters
    ----------
    points : float64 array, shape (n, 2)
    seeds : float64 array, shape (k, 2)
        Where the means begin.

    Returns
    -------
    means : float64 array, shape (k, 2)
    owner : int64 array, shape (n,)
        The cluster of each point.
    """
    means = seeds.copy()
    owner = np.zeros(len(points), np.int64)
    _lloyd(points, means, owner)
    return means, owner


def evenly(points: Points, count: int) -> Points:
    """Seeds that lie apart: the first point, then always the one farthest from all before.

    Returns
    -------
    float64 array, shape (count, 2)
        Points; `count` is at most their number.
    """
    chosen = [0]
    gap = ((points - points[0]) ** 2).sum(axis=1)
    for _ in range(count - 1):
        chosen.append(int(np.argmax(gap)))
        gap = np.minimum(gap, ((points - points[chosen[-1]]) ** 2).sum(axis=1))
    return points[chosen].copy()


@kernel("void(float64[:,::1], float64[:,::1], int64[::1])")
def _lloyd(points: Points, means: Points, owner: NDArray[np.int64]) -> None:
    count = len(means)
    total = np.empty((count, 3))
    for _ in range(_ROUNDS):
        total[:] = 0.0
        for at in range(len(points)):
            best = np.inf
            for number in range(count):
                dx = points[at, 0] - means[number, 0]
                dy = points[at, 1] - means[number, 1]
                distance = dx * dx + dy * dy
                if distance < best:
                    best = distance
                    owner[at] = number
            total[owner[at], 0] += points[at, 0]
            total[owner[at], 1] += points[at, 1]
            total[owner[at], 2] += 1.0
        moved = False
        for number in range(count):
            if total[number, 2] > 0.0:
                x = total[number, 0] / total[number, 2]
                y = total[number, 1] / total[number, 2]
                if x != means[number, 0] or y != means[number, 1]:
                    means[number, 0] = x
                    means[number, 1] = y
                    moved = True
        if not moved:
            break
