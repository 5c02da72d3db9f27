"""The tour of a single robot: the traveling salesman's open path through all goals.

No teammate visits the goals that this robot leaves behind, so only the length of the tour counts. The first tour
follows the nearest neighbor. Then parts of it are reversed (2-opt), and up to three consecutive goals are moved in
either direction (Or-opt), as long as the tour becomes shorter.
"""

from __future__ import annotations

import numpy as np

from agent.planning.lin_kernighan import by_nearest_neighbors
from protocol.arrays import FloatRows, Floats, Int64s
from protocol.kernels import kernel

ROUNDS = 100
"""Largest number of improvement rounds; the search ends earlier if a round changes nothing."""

MOST_MOVED = 3
"""Largest number of consecutive goals that are moved together."""

_LEAST = 1e-7
"""Least improvement that counts; less may be rounding."""


def single_robot_tour(starts: Floats, between: FloatRows) -> list[int]:
    """Order goals by a short path from a start through all of them; unreachable goals are left out.

    `starts`, shape (n,), has the distance from the robot to each goal, infinite without a way; `between`, shape (n, n),
    the distances between goals, symmetric.
    """
    goals = np.flatnonzero(np.isfinite(starts))
    count = len(goals)
    ways = np.zeros((count + 1, count + 1))
    ways[0, 1:] = ways[1:, 0] = starts[goals]
    ways[1:, 1:] = between[np.ix_(goals, goals)]
    tour = np.arange(count + 1)
    _shorten(tour, ways)
    order: list[int] = goals[tour[1:] - 1].tolist()
    return order


@kernel
def _step(tour: Int64s, place: int, after: int, ways: FloatRows) -> float:
    """Return the distance between the goals at two places; 0 beyond the end of the tour."""
    return float(ways[tour[place], tour[after]]) if after < len(tour) else 0.0


@kernel
def _reverse_parts(tour: Int64s, ways: FloatRows) -> bool:
    """Reverse each part whose reversal makes the tour shorter; return whether there was one."""
    improved = False
    for first in range(1, len(tour) - 1):
        for end in range(first + 1, len(tour)):
            before = _step(tour, first - 1, first, ways) + _step(tour, end, end + 1, ways)
            then = _step(tour, first - 1, end, ways) + _step(tour, first, end + 1, ways)
            if then < before - _LEAST:
                tour[first : end + 1] = tour[first : end + 1][::-1].copy()
                improved = True
    return improved


@kernel
def _move(tour: Int64s, first: int, length: int, ways: FloatRows) -> bool:
    """Move consecutive goals to their best place, in either direction; return whether that is another place."""
    part = tour[first : first + length].copy()
    rest = np.concatenate((tour[:first], tour[first + length :]))
    gain = _step(tour, first - 1, first, ways) + _step(tour, first + length - 1, first + length, ways)
    least, best = gain - _step(rest, first - 1, first, ways) - _LEAST, 0
    turned = False
    for place in range(1, len(rest) + 1):
        if place == first:
            continue
        before = rest[place - 1]
        for turn in (False, True):
            head, tail = (part[-1], part[0]) if turn else (part[0], part[-1])
            cost = ways[before, head] - _step(rest, place - 1, place, ways)
            if place < len(rest):
                cost += ways[tail, rest[place]]
            if cost < least:
                least, best, turned = cost, place, turn
    if best:
        tour[:best] = rest[:best]
        tour[best : best + length] = part[::-1] if turned else part
        tour[best + length :] = rest[best:]
    return best > 0


@kernel
def _shorten(tour: Int64s, ways: FloatRows) -> None:
    """Order a tour by nearest neighbors, then improve it; its first place is the robot itself."""
    by_nearest_neighbors(tour, ways)
    for _ in range(ROUNDS):
        improved = _reverse_parts(tour, ways)
        for length in range(1, MOST_MOVED + 1):
            for first in range(1, len(tour) - length + 1):
                improved |= _move(tour, first, length, ways)
        if not improved:
            break
