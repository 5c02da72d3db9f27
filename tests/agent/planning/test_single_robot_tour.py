"""Tours of a single robot: worked by hand, and never longer than the nearest-neighbor tour."""

from __future__ import annotations

from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.planning.single_robot_tour import single_robot_tour
from protocol.arrays import FloatRows


def on_a_line(goals: list[float]) -> tuple[FloatRows, FloatRows]:
    at = np.array(goals, np.float64)
    return np.abs(at), np.abs(at[:, None] - at)


def test_the_nearer_end_comes_first_though_the_nearest_goal_is_at_the_other() -> None:
    # 4 there and 14 on, instead of 3, 13 back past all to 10, and 14 to the last.
    assert single_robot_tour(*on_a_line([10, 3, -4])) == [2, 1, 0]


@pytest.mark.parametrize(("starts", "tour"), [([], []), ([np.inf], []), ([2.0], [0]), ([np.inf, 2.0], [1])])
def test_unreachable_goals_are_left_out(starts: list[float], tour: list[int]) -> None:
    assert single_robot_tour(np.array(starts), np.zeros((len(starts), len(starts)))) == tour


def length(tour: tuple[int, ...] | list[int], starts: FloatRows, between: FloatRows) -> float:
    return float(starts[tour[0]] + sum(between[one, other] for one, other in pairwise(tour)))


@st.composite
def tasks(draw: st.DrawFn) -> tuple[FloatRows, FloatRows]:
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    places: NDArray[np.float64] = random.uniform(0, 100, (draw(st.integers(2, 8)), 2))
    ways = np.hypot(*(places[:, None] - places).T)
    return ways[0, 1:], ways[1:, 1:]


@given(tasks())
def test_tours_are_hardly_longer_than_the_shortest(task: tuple[FloatRows, FloatRows]) -> None:
    starts, between = task
    tour = single_robot_tour(starts, between)
    assert sorted(tour) == list(range(len(starts)))
    shortest = min(length(order, *task) for order in permutations(range(len(starts)))) if len(tour) < 7 else 0
    nearest: list[int] = []
    while len(nearest) < len(tour):
        ways = between[nearest[-1]] if nearest else starts
        nearest.append(min(set(tour) - set(nearest), key=lambda goal: ways[goal]))
    assert length(tour, *task) <= length(nearest, *task) + 1e-6
    assert shortest == 0 or length(tour, *task) <= 1.25 * shortest
