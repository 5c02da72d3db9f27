"""Tours through any number of goals by the Chained Lin-Kernighan heuristic (Applegate, Cook and Rohe 2003).

A step of Lin and Kernighan (1973) removes an edge of the tour, which leaves a path. It then repeatedly adds an edge
from the first node of the path to a later one, and removes the edge before that node, as long as the removed edges are
longer than the added ones in sum. The tour closes where it is shortest. If no step makes the tour shorter, a kick, a
double bridge at random places, changes it, and the steps start again. The result stays unless the tour becomes longer.

Faigl and Vanek 2014 use this heuristic (section 3.1). Here it has no backtracking, and equal inputs give equal tours:
the kicks are the same for all tours of the same number of goals.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from protocol.arrays import FloatRows, Floats, Int64Rows, Int64s
from protocol.kernels import kernel

KICKS_PER_GOAL = 3
"""Number of kicks for each goal of a tour."""

_LEAST = 1e-7
"""Least improvement that counts; less may be rounding."""


def chained_tour(from_start: Floats, between: FloatRows, to_end: Floats) -> list[int]:
    """Order goals by a short path from a start through all of them; return the goals in the order of the path.

    Parameters and result are those of `agent.planning.tour.open_tour`, for any number of goals.
    """
    count = len(from_start)
    ways = np.zeros((count + 2, count + 2))
    ways[0, 1:-1] = ways[1:-1, 0] = from_start
    ways[1:-1, 1:-1] = between
    ways[-1, 1:-1] = ways[1:-1, -1] = to_end
    # No step removes the way from the end to the start: all others together do not make up for it.
    ways[0, -1] = ways[-1, 0] = -(count + 2) * (1.0 + ways.max())
    tour = np.arange(count + 2)
    _chain(tour, ways, kicks(count + 2))
    order: list[int] = (tour[1:-1] - 1).tolist()
    return order


@lru_cache(maxsize=256)
def kicks(nodes: int) -> Int64Rows:
    """Return three places of each kick, ascending, shape (k, 3): the first nodes of the parts after the first part."""
    if nodes < 5:
        return np.empty((0, 3), np.int64)
    random = np.random.default_rng(0)
    places = random.random((KICKS_PER_GOAL * (nodes - 2), nodes - 1)).argsort(axis=1, kind="stable")
    return np.sort(places[:, :3] + 1, axis=1)


@kernel
def _step(path: Int64s, ways: FloatRows) -> bool:
    """Make the tour shorter that a path forms with the edge from its last to its first node; return whether it is."""
    nodes = len(path)
    last = path[nodes - 1]
    gain = ways[last, path[0]]
    best, shortest = _LEAST, path.copy()
    added = np.empty((nodes, 2), np.int64)
    for depth in range(nodes):
        next_gain, chosen = -np.inf, 0
        for place in range(2, nodes):
            left = gain - ways[path[0], path[place]]
            then = left + ways[path[place - 1], path[place]]
            if left <= _LEAST or then <= next_gain:
                continue
            is_new = False
            for one, other in added[:depth]:
                is_new |= one == path[place - 1] and other == path[place]
                is_new |= other == path[place - 1] and one == path[place]
            if not is_new:
                next_gain, chosen = then, place
        if not chosen:
            break
        added[depth, 0], added[depth, 1] = path[0], path[chosen]
        path[:chosen] = path[:chosen][::-1].copy()
        gain = next_gain
        if gain - ways[last, path[0]] > best:
            best = gain - ways[last, path[0]]
            shortest[:] = path
    path[:] = shortest
    return best > _LEAST


@kernel
def _improve(tour: Int64s, ways: FloatRows) -> None:
    """Take steps from either end of each edge until none makes the tour shorter; node 0 stays first."""
    nodes = len(tour)
    path = np.empty(nodes, np.int64)
    improved = True
    while improved:
        improved = False
        for edge in range(nodes):
            for turned in (False, True):
                for place in range(nodes):
                    path[place] = tour[(edge - place) % nodes] if turned else tour[(edge + 1 + place) % nodes]
                if _step(path, ways):
                    tour[:] = path
                    improved = True
    first = 0
    while tour[first] != 0:
        first += 1
    turned = tour[first - 1] != nodes - 1
    for place in range(nodes):
        path[place] = tour[(first - place) % nodes] if turned else tour[(first + place) % nodes]
    tour[:] = path


@kernel
def _length(tour: Int64s, ways: FloatRows) -> float:
    """Return the length of the path from the first to the last node."""
    total = 0.0
    for place in range(1, len(tour)):
        total += ways[tour[place - 1], tour[place]]
    return total


@kernel
def by_nearest_neighbors(tour: Int64s, ways: FloatRows) -> None:
    """Order the nodes of a path behind the first one such that each is followed by the nearest of those left."""
    for place in range(1, len(tour) - 1):
        nearest = place
        for other in range(place + 1, len(tour)):
            if ways[tour[place - 1], tour[other]] < ways[tour[place - 1], tour[nearest]]:
                nearest = other
        tour[place], tour[nearest] = tour[nearest], tour[place]


@kernel
def _chain(tour: Int64s, ways: FloatRows, cuts: Int64Rows) -> None:
    """Order the nodes between the first and the last by nearest neighbors, then improve; kick, and improve again."""
    by_nearest_neighbors(tour[:-1], ways)
    _improve(tour, ways)
    length = _length(tour, ways)
    for number in range(len(cuts)):
        one, two, three = cuts[number]
        kicked = np.concatenate((tour[:one], tour[two:three], tour[one:two], tour[three:]))
        _improve(kicked, ways)
        new_length = _length(kicked, ways)
        if new_length <= length:
            length = new_length
            tour[:] = kicked
