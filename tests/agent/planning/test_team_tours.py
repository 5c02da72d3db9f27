"""Tours of a team by weighted arrivals: worked by hand, and against the same search done the slow way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.planning.team_tours import ROUNDS, Task, team_tours


def tours_cost(tours: list[list[int]], task: Task) -> float:
    """Return the cost of tours, which `team_tours` minimizes."""
    starts, between, weights, latency_weight, last, way, loads = task
    total, longest = 0.0, 0.0
    for robot, tour in enumerate(tours):
        arrival = 0.0
        for place, goal in enumerate(tour):
            arrival += starts[robot, goal] if place == 0 else between[tour[place - 1], goal]
            total += float(weights[goal] * arrival + latency_weight[goal] * arrival**2)
        end = float(arrival + loads[tour].sum())
        longest = max(longest, end)
        total += way * end
    return total + last * longest


def on_a_line(
    robots: list[float],
    goals: list[float],
    weights: list[float],
    latency_weight: float = 0.0,
    way: float = 0.0,
) -> Task:
    at = np.array(goals, np.float64)
    return Task(
        np.abs(np.array(robots, np.float64)[:, None] - at),
        np.abs(at[:, None] - at),
        np.array(weights),
        np.full(len(goals), latency_weight),
        0.0,
        way,
        np.zeros(len(goals)),
    )


def test_a_small_goal_on_the_way_is_visited_first_and_one_behind_is_not() -> None:
    assert team_tours(on_a_line([0], [10, 1], [1.0, 0.1])) == [[1, 0]]
    assert team_tours(on_a_line([0], [10, -3], [1.0, 0.1])) == [[0, 1]]


@pytest.mark.parametrize(("latency_weight", "tour"), [(0.0, [0, 1]), (0.010, [0, 1]), (0.012, [1, 0])])
def test_a_small_goal_behind_is_visited_first_with_latency_weight(
    latency_weight: float, tour: list[int]
) -> None:
    # There and on: 0.1 x 3 + 16 + (9 + 256) l. On and back: 10 + 0.1 x 23 + (100 + 529) l. Alike at l = 1 / 91.
    assert team_tours(on_a_line([0], [10, -3], [1.0, 0.1], latency_weight)) == [tour]


@pytest.mark.parametrize(("way", "tour"), [(0.0, [0, 1]), (0.56, [0, 1]), (0.58, [1, 0])])
def test_a_small_goal_behind_is_visited_first_if_total_length_counts(way: float, tour: list[int]) -> None:
    # There and on: 0.1 x 3 + 16 + 16 w. On and back: 10 + 0.1 x 23 + 23 w. Alike at w = 4 / 7.
    assert team_tours(on_a_line([0], [10, -3], [1.0, 0.1], way=way)) == [tour]


@pytest.mark.parametrize(("last", "tours"), [(0.0, [[0, 1], []]), (2.0, [[0], [1]])])
def test_a_far_robot_helps_if_the_longest_tour_counts(last: float, tours: list[list[int]]) -> None:
    # Alone robot 0 is at the second goal at 22, robot 1 would be there at 23, but done with both only then; the
    # arrival costs one more, the end 22 instead of 21 the other way round.
    starts = np.array([[20.0, 22.0], [30.0, 21.0]]) if last else np.array([[20.0, 22.0], [30.0, 23.0]])
    between = np.array([[0.0, 2.0], [2.0, 0.0]])
    assert team_tours(Task(starts, between, np.full(2, 0.1), np.zeros(2), last, 0.0, np.zeros(2))) == tours


def test_a_robot_with_a_large_load_gets_fewer_other_goals() -> None:
    # The second goal lies a little nearer to robot 0, which has the first to see to.
    starts = np.array([[10.0, 12.0], [40.0, 13.0]])
    between = np.array([[0.0, 2.0], [2.0, 0.0]])
    task = Task(starts, between, np.full(2, 0.1), np.zeros(2), 1.0, 0.0, np.zeros(2))
    assert team_tours(task) == [[0, 1], []]
    assert team_tours(task._replace(loads=np.array([30.0, 0.0]))) == [[0], [1]]


def test_unreachable_goals_are_in_no_tour_and_enclosed_robots_have_none() -> None:
    starts = np.array([[3.0, np.inf, 1.0], [np.inf, np.inf, np.inf]])
    between = np.array([[0.0, np.inf, 2.0], [np.inf, 0.0, np.inf], [2.0, np.inf, 0.0]])
    assert team_tours(Task(starts, between, np.ones(3), np.ones(3), 1.0, 1.0, np.zeros(3))) == [[2, 0], []]
    none = np.empty(0)
    assert team_tours(Task(np.empty((2, 0)), np.empty((0, 0)), none, none, 1.0, 1.0, none)) == [[], []]


@st.composite
def tasks(draw: st.DrawFn) -> Task:
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    robots, goals = draw(st.integers(1, 4)), draw(st.integers(1, 9))
    places = random.uniform(0, 100, (robots + goals, 2))
    ways = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    return Task(
        ways[:robots, robots:].copy(),
        ways[robots:, robots:].copy(),
        random.uniform(0.1, 1.1, goals),
        np.full(goals, draw(st.sampled_from([0.0, 0.001, 0.02]))),
        draw(st.sampled_from([0.0, 2.0])),
        draw(st.sampled_from([0.0, 4.0])),
        draw(st.sampled_from([0.0, 50.0])) * random.uniform(0, 1, goals),
    )


@given(tasks())
def test_the_search_equals_one_that_evaluates_whole_tours(task: Task) -> None:
    found = team_tours(task)
    assert sorted(goal for tour in found for goal in tour) == list(range(len(task[2])))
    assert tours_cost(found, task) == pytest.approx(tours_cost(slow(task), task))


def slow(task: Task) -> list[list[int]]:
    """Insertion, then moves of a goal, swaps of two ends and turns of a part, by the cost of all tours."""
    tours: list[list[int]] = [[] for _ in task.starts]
    order: NDArray[np.int64] = np.lexsort((task.starts.min(axis=0), -task.weights))
    for goal in order.tolist():
        tours = min(with_goal(tours, goal), key=lambda each: tours_cost(each, task))
    for _ in range(ROUNDS):
        before = tours_cost(tours, task)
        for goal in order.tolist():
            others = [[each for each in tour if each != goal] for tour in tours]
            tours = min([tours, *with_goal(others, goal)], key=lambda each: tours_cost(each, task))
        for one in range(len(tours)):
            for other in range(one):
                tours = min([tours, *swapped(tours, one, other)], key=lambda each: tours_cost(each, task))
        for robot in range(len(tours)):
            tours = min([tours, *turned(tours, robot)], key=lambda each: tours_cost(each, task))
        if tours_cost(tours, task) > before - 1e-7:
            break
    return tours


def with_goal(tours: list[list[int]], goal: int) -> list[list[list[int]]]:
    return [
        [*tours[:robot], [*tour[:place], goal, *tour[place:]], *tours[robot + 1 :]]
        for robot, tour in enumerate(tours)
        for place in range(len(tour) + 1)
    ]


def swapped(tours: list[list[int]], one: int, other: int) -> list[list[list[int]]]:
    found = []
    for place in range(len(tours[one]) + 1):
        for at in range(len(tours[other]) + 1):
            new = list(tours)
            new[one] = tours[one][:place] + tours[other][at:]
            new[other] = tours[other][:at] + tours[one][place:]
            found.append(new)
    return found


def turned(tours: list[list[int]], robot: int) -> list[list[list[int]]]:
    tour = tours[robot]
    return [
        [*tours[:robot], [*tour[:first], *tour[first : end + 1][::-1], *tour[end + 1 :]], *tours[robot + 1 :]]
        for first in range(len(tour) - 1)
        for end in range(first + 1, len(tour))
    ]
