"""Tours of the Chained Lin-Kernighan heuristic: those of a plain counterpart, and as short as exact ones."""

from __future__ import annotations

from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.planning.lin_kernighan import chained_tour, kicks
from agent.planning.tour import LONGEST, open_tour
from protocol.arrays import FloatRows, Floats

Task = tuple[Floats, FloatRows, Floats]

LEAST = 1e-7


@st.composite
def tasks(draw: st.DrawFn, least: int, most: int) -> Task:
    """Goals in the plane, a start, and an end or none."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(least, most))
    places = random.uniform(0, 100, (count + 2, 2))
    ways = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
    end = ways[count + 1, :count] if draw(st.booleans()) else np.zeros(count)
    return ways[count, :count], ways[:count, :count], end


def length(order: tuple[int, ...] | list[int], task: Task) -> float:
    start, between, end = task
    return float(start[order[0]] + sum(between[a, b] for a, b in pairwise(order)) + end[order[-1]])


@given(tasks(1, 5))
def test_a_tour_through_a_few_goals_is_the_shortest(task: Task) -> None:
    tour = chained_tour(*task)
    assert sorted(tour) == list(range(len(task[0])))
    shortest = min(length(order, task) for order in permutations(tour))
    assert length(tour, task) == pytest.approx(shortest)


@given(tasks(6, LONGEST))
def test_a_tour_is_hardly_longer_than_the_exact_one(task: Task) -> None:
    tour = chained_tour(*task)
    assert sorted(tour) == list(range(len(task[0])))
    assert length(tour, task) <= 1.02 * length(open_tour(*task), task)


@given(tasks(1, 20))
def test_a_tour_is_that_of_the_plain_counterpart(task: Task) -> None:
    assert chained_tour(*task) == plain_tour(*task)


def test_a_goal_is_visited_on_the_way_to_a_cluster_and_the_far_side_last() -> None:
    # Goals at 1 to 30 to the right and at -2 to the left: left first costs 4 more at the start, and 32 less at the end.
    at = np.array([*range(1, 31), -2.0])
    assert chained_tour(np.abs(at), np.abs(at[:, None] - at), np.zeros(31)) == [30, *range(30)]


def plain_tour(from_start: Floats, between: FloatRows, to_end: Floats) -> list[int]:
    """The same tours with lists and sets: node 0 is the start, the last node the end."""
    count = len(from_start)
    end = count + 1
    most = -(count + 2) * (1.0 + max(from_start.max(), between.max(), to_end.max()))

    def way(one: int, other: int) -> float:
        one, other = min(one, other), max(one, other)
        if one == 0:
            return most if other == end else float(from_start[other - 1])
        return float(to_end[one - 1] if other == end else between[one - 1, other - 1])

    def total(tour: list[int]) -> float:
        return sum((way(*pair) for pair in pairwise(tour)), 0.0)

    def shorter(path: list[int]) -> list[int] | None:
        gain, best, found = way(path[-1], path[0]), LEAST, None
        added: set[frozenset[int]] = set()
        for _ in range(len(path)):
            choices = [
                (gain - way(path[0], path[at]) + way(path[at - 1], path[at]), -at)
                for at in range(2, len(path))
                if gain - way(path[0], path[at]) > LEAST and frozenset(path[at - 1 : at + 1]) not in added
            ]
            if not choices:
                break
            gain, at = max(choices)
            added.add(frozenset((path[0], path[-at])))
            path = path[:-at][::-1] + path[-at:]
            if gain - way(path[-1], path[0]) > best:
                best, found = gain - way(path[-1], path[0]), path
        return found

    def improved(tour: list[int]) -> list[int]:
        while True:
            before = tour
            for edge in range(len(tour)):
                for turned in (False, True):
                    path = tour[edge + 1 :] + tour[: edge + 1]
                    if turned:
                        path = path[::-1]
                    tour = shorter(path) or tour
            if tour is before:
                break
        first = tour.index(0)
        tour = tour[first:] + tour[:first]
        return tour if tour[-1] == end else [tour[0], *tour[:0:-1]]

    left, tour = list(range(1, end)), [0]
    while left:
        # As in the kernel: the nearest node changes places with the first of those that are left.
        nearest = min(range(len(left)), key=lambda at: way(tour[-1], left[at]))
        left[0], left[nearest] = left[nearest], left[0]
        tour.append(left.pop(0))
    tour = improved([*tour, end])
    for one, two, three in kicks(count + 2).tolist():
        kicked = improved(tour[:one] + tour[two:three] + tour[one:two] + tour[three:])
        if total(kicked) <= total(tour):
            tour = kicked
    return [node - 1 for node in tour[1:-1]]
