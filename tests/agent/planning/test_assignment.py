"""Assignments, worked out by hand and against brute force; tours against all orders."""

from __future__ import annotations

from itertools import pairwise, permutations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.planning.assignment import best_of_all, greedy, hungarian, in_turn, iterative, total_value
from agent.planning.tour import open_tour
from protocol.grid import FREE, OCCUPIED

TABLE = np.array([[2.0, 3.0, 9.0], [1.0, 4.0, 9.0]])


def test_greedy_serves_robots_in_the_order_given() -> None:
    assert greedy(TABLE, np.array([0, 1])).tolist() == [0, 1]
    assert greedy(TABLE, np.array([1, 0])).tolist() == [1, 0]


def test_iterative_takes_the_cheapest_pair_first() -> None:
    assert iterative(TABLE).tolist() == [1, 0]
    assert iterative(np.array([[5.0], [4.0], [np.inf]])).tolist() == [-1, 0, -1]


@given(st.integers(1, 4), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_hungarian_is_the_assignment_of_least_total_cost(robots: int, more: int, seed: int) -> None:
    costs = np.random.default_rng(seed).uniform(0, 100, (robots, robots + more))
    given_to = hungarian(costs)
    assert sorted(set(given_to.tolist())) == sorted(given_to.tolist())
    least = min(
        sum(costs[robot, goal] for robot, goal in enumerate(goals))
        for goals in permutations(range(robots + more), robots)
    )
    assert costs[np.arange(robots), given_to].sum() == pytest.approx(least)


def test_hungarian_with_fewer_goals_than_robots_takes_the_cheapest_pair_first() -> None:
    # In all, robot 0 to goal 1 and robot 1 to goal 0 would cost 4.
    costs = np.array([[1.0, 2.0], [2.0, 10.0], [50.0, 60.0]])
    assert hungarian(costs).tolist() == [0, 1, -1]


def test_hungarian_assigns_all_reachable_goals_and_no_other() -> None:
    far = np.inf
    assert hungarian(np.array([[far, far], [3.0, far]])).tolist() == [-1, 0]
    assert hungarian(np.array([[1.0, far], [1.0, 50.0]])).tolist() == [0, 1]


def open_floor() -> NDArray[np.uint8]:
    return np.full((20, 40), FREE, np.uint8)


def test_algorithm_1_sends_the_second_robot_elsewhere() -> None:
    goals = np.array([(10, 10), (12, 10), (30, 10)], np.int32)
    # Range 10: the first goal lowers its neighbor to 0.2 and leaves the third at 1.
    costs = np.array([[0.1, 0.2, 0.9], [0.2, 0.1, 0.85]])
    assert in_turn(open_floor(), goals, np.ones(3), costs, np.full(2, 10.0)).tolist() == [0, 2]
    assert in_turn(open_floor(), goals, np.ones(3), 10 * costs, np.full(2, 10.0)).tolist() == [0, 1]


def test_a_wall_between_two_goals_keeps_their_utilities() -> None:
    goals = np.array([(10, 10), (12, 10), (30, 10)], np.int32)
    costs = np.array([[0.1, 0.2, 0.9], [0.2, 0.1, 0.85]])
    grid = open_floor()
    grid[:, 11] = OCCUPIED
    assert in_turn(grid, goals, np.ones(3), costs, np.full(2, 10.0)).tolist() == [0, 1]


def test_algorithm_2_is_no_worse_than_algorithm_1_where_that_is_short_sighted() -> None:
    # Fig. 7 of the paper: robot 1 is nearest to both rooms, and the other would have all the way to drive.
    goals = np.array([(0, 0), (39, 19)], np.int32)
    way = np.array([[0.9, 1.8], [0.5, 0.9]])
    assert in_turn(open_floor(), goals, np.ones(2), way, np.full(2, 5.0)).tolist() == [1, 0]
    random = np.random.default_rng(0)
    assert best_of_all(open_floor(), goals, np.ones(2), way**2, np.full(2, 5.0), random).tolist() == [0, 1]


@given(st.integers(1, 3), st.integers(2, 6), st.integers(0, 2**32 - 1))
def test_algorithm_2_finds_what_brute_force_finds(robots: int, count: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    goals = np.stack([random.integers(0, 40, count), random.integers(0, 20, count)], axis=1).astype(np.int32)
    costs = random.uniform(0, 2, (robots, count))
    utility = random.uniform(0.5, 1, count)
    ranges = random.choice([12.0, 30.0], robots)
    found = best_of_all(open_floor(), goals, utility, costs, ranges, random)
    best = max(
        total_value(open_floor(), goals, utility, costs, ranges, np.array(some))
        for some in product(range(count), repeat=robots)
    )
    assert total_value(open_floor(), goals, utility, costs, ranges, found) == pytest.approx(best, abs=1e-6)


@given(st.integers(1, 6), st.booleans(), st.integers(0, 2**32 - 1))
def test_a_tour_is_the_shortest_path_through_all_goals(count: int, closed: bool, seed: int) -> None:
    points = np.random.default_rng(seed).uniform(0, 100, (count + 2, 2))
    distance = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    start, between = distance[count, :count], distance[:count, :count]
    end = distance[count + 1, :count] if closed else np.zeros(count)

    def length(order: tuple[int, ...] | list[int]) -> float:
        return float(start[order[0]] + sum(between[a, b] for a, b in pairwise(order)) + end[order[-1]])

    tour = open_tour(start, between, end)
    assert sorted(tour) == list(range(count))
    # The solver's distances are rounded to a few thousandths of the longest.
    assert length(tour) <= min(map(length, permutations(range(count)))) + 1.0
