"""Exact tours through a few goals: the traveling salesman's open path.

The solution is that of Held and Karp (1962), in fast-tsp. `agent.planning.lin_kernighan` has tours through more goals.
"""

from __future__ import annotations

from itertools import permutations

import fast_tsp
import numpy as np

from protocol.arrays import FloatRows, Floats

LONGEST = 12
"""Largest number of goals; the exact solution then takes less than a millisecond."""

_LARGEST = 65535
"""Largest distance of the solver, which takes integers."""


def open_tour(from_start: Floats, between: FloatRows, to_end: Floats) -> list[int]:
    """Order goals by the shortest path from a start through all of them; return the goals in the order of the path.

    `from_start` and `to_end`, shape (n,), have the cost of the way from the start to each goal, and from each goal to
    the end of the path: zeros for a path that ends at its last goal. `between`, shape (n, n), has the costs between
    goals, symmetric. n is at most `LONGEST`.
    """
    count = len(from_start)
    if count <= 2:
        orders = [list(order) for order in permutations(range(count))]
        return min(orders, key=lambda it: from_start[it[0]] + between[it[0], it[-1]] + to_end[it[-1]])
    # A closed tour with two more nodes: the start, node n, and a way back, node n + 1. The way back costs nothing
    # to the start and much to a goal, so the tour uses it once, and the goals form one path.
    most = (count + 2) * max(from_start.max(), between.max(), to_end.max(), 1e-9)
    distance = np.zeros((count + 2, count + 2))
    distance[:count, :count] = between
    distance[:count, count] = distance[count, :count] = from_start
    distance[:count, count + 1] = distance[count + 1, :count] = most + to_end
    scale = _LARGEST / distance.max()
    tour = fast_tsp.solve_tsp_exact(np.rint(distance * scale).astype(np.int64).tolist())
    at = tour.index(count)
    ring = tour[at + 1 :] + tour[:at]
    return ring[:0:-1] if ring[0] == count + 1 else ring[:-1]
