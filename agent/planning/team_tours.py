"""Tours of a whole team through all goals: who serves which, and in which order.

The problem is the k-traveling repairmen's: it counts how late each goal is reached. A goal costs its weight times
its arrival and its lateness times the square of that, so that small goals may wait for a while but not for long.
On top counts when the last robot is done, and how far all of them drive, as for traveling salesmen: what is left
for later has to be shared out again, so the run ends the sooner the less there is to drive in all. A robot is done
when it has also driven what is expected behind its goals, its load: who has much of that gets less else. Goals are
inserted one by one where they cost least; then a goal moves elsewhere, two robots swap the ends of their tours,
or a part of a tour is turned around, for as long as that helps. What a goal's move or a swap costs is known from
sums over the rest of a tour, without driving along it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.kernels import kernel

ROUNDS = 10
"""The search ends when no move helps, or after so many rounds of all."""

Numbers = NDArray[np.float64]

_LEAST = 1e-7
"""What a move must gain: less is rounding."""


class Task(NamedTuple):
    """What there is to plan.

    Attributes
    ----------
    starts : float64 array, shape (m, n)
        Way from each robot to each goal; infinite where none leads.
    between : float64 array, shape (n, n)
        Way from goal to goal, symmetric.
    weights : float64 array, shape (n,)
        Cost of each goal a unit of way at its arrival.
    lateness : float64 array, shape (n,)
        The same of the arrival's square.
    last : float
        Cost of the longest tour, a unit of way.
    way : float
        Cost of every tour, a unit of way.
    loads : float64 array, shape (n,)
        By how much later a robot is done for each goal that it serves.
    """

    starts: Numbers
    between: Numbers
    weights: Numbers
    latency_weight: Numbers
    last: float
    way: float
    loads: Numbers


def team_tours(task: Task) -> list[list[int]]:
    """Plan one tour a robot, so that goals of weight are reached soon and none very late.

    Returns
    -------
    list of lists of int
        The numbers of each robot's goals, in its order; goals that no robot can reach are in none.
    """
    robots, goals = task.starts.shape
    tours = np.full((robots, goals), -1)
    counts = np.zeros(robots, np.int64)
    order = np.lexsort((task.starts.min(axis=0), -task.weights)) if goals else np.empty(0, np.int64)
    _plan((*task,), order, tours, counts)
    return [tour[:count].tolist() for tour, count in zip(tours, counts, strict=True)]


def tours_cost(tours: list[list[int]], task: Task) -> float:
    """What `team_tours` makes small."""
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


_Task = tuple[Numbers, Numbers, Numbers, Numbers, float, float, Numbers]
_Plan = tuple[NDArray[np.int64], NDArray[np.int64], Numbers]
"""Tours by robot and place, how many places each has, and what `_drive` notes of each."""

_TASK = "Tuple((float64[:,::1], float64[:,::1], float64[::1], float64[::1], float64, float64, float64[::1]))"
_PLAN = "Tuple((int64[:,::1], int64[::1], float64[:,:,::1]))"


@kernel(f"float64(int64, {_TASK}, {_PLAN})")
def _drive(robot: int, task: _Task, plan: _Plan) -> float:
    """Note the arrival at each place of a robot's tour, and sums over the goals from there on; return the tour's cost.

    `book[k]` has the arrival, the sums of weight, of lateness, of lateness times arrival, and of load.
    """
    starts, between, weights, latency_weight, _, _, loads = task
    tours, counts, books = plan
    tour, count, book = tours[robot], counts[robot], books[robot]
    arrival = 0.0
    total = 0.0
    for place in range(count):
        goal = tour[place]
        arrival += starts[robot, goal] if place == 0 else between[tour[place - 1], goal]
        book[place, 0] = arrival
        total += weights[goal] * arrival + latency_weight[goal] * arrival * arrival
    book[count] = 0.0
    for place in range(count - 1, -1, -1):
        goal = tour[place]
        book[place, 1] = book[place + 1, 1] + weights[goal]
        book[place, 2] = book[place + 1, 2] + latency_weight[goal]
        book[place, 3] = book[place + 1, 3] + latency_weight[goal] * book[place, 0]
        book[place, 4] = book[place + 1, 4] + loads[goal]
    return total


@kernel("float64(float64[:,::1], int64, float64)")
def _delay(book: Numbers, place: int, later: float) -> float:
    """What it costs if all goals of a tour from `place` on are reached `later`."""
    return float(later * (book[place, 1] + 2.0 * book[place, 3] + later * book[place, 2]))


@kernel("float64(float64[:,:,::1], int64[::1], int64)")
def _end(books: Numbers, counts: NDArray[np.int64], robot: int) -> float:
    """When a robot is done."""
    return float(books[robot, counts[robot] - 1, 0] + books[robot, 0, 4]) if counts[robot] else 0.0


@kernel("float64(float64[:,:,::1], int64[::1], int64, int64)")
def _longest(books: Numbers, counts: NDArray[np.int64], one: int, other: int) -> float:
    """When the last robot but these two is done."""
    longest = 0.0
    for robot in range(len(counts)):
        if robot not in (one, other):
            longest = max(longest, _end(books, counts, robot))
    return longest


@kernel(f"Tuple((float64, int64, int64))(int64, {_TASK}, {_PLAN})")
def _best_place(goal: int, task: _Task, plan: _Plan) -> tuple[float, int, int]:
    """Where a goal costs least: the cost, the robot (-1 if none can reach it) and the place in its tour."""
    starts, between, weights, latency_weight, last, way, loads = task
    tours, counts, books = plan
    least, best_robot, best_place = np.inf, -1, -1
    for robot in range(len(counts)):
        if not np.isfinite(starts[robot, goal]):
            continue
        others = _longest(books, counts, robot, robot)
        end = _end(books, counts, robot)
        for place in range(counts[robot] + 1):
            arrival = starts[robot, goal]
            if place:
                before = tours[robot, place - 1]
                arrival = books[robot, place - 1, 0] + between[before, goal]
            cost = arrival * (weights[goal] + arrival * latency_weight[goal])
            new_end = arrival + books[robot, 0, 4] + loads[goal]
            if place < counts[robot]:
                later = arrival + between[goal, tours[robot, place]] - books[robot, place, 0]
                cost += _delay(books[robot], place, later)
                new_end = end + later + loads[goal]
            cost += last * (max(others, new_end) - max(others, end)) + way * (new_end - end)
            if cost < least:
                least, best_robot, best_place = cost, robot, place
    return least, best_robot, best_place


@kernel(f"boolean(int64, {_TASK}, {_PLAN})")
def _move(goal: int, task: _Task, plan: _Plan) -> bool:
    """Put a goal where it costs least; whether it was elsewhere before."""
    _, _, _, _, last, way, _ = task
    tours, counts, books = plan
    robot, place, gain = -1, -1, np.inf
    for each in range(len(counts)):
        for at in range(counts[each]):
            if tours[each, at] == goal:
                robot, place = each, at
    if robot >= 0:
        others = _longest(books, counts, robot, robot)
        end = _end(books, counts, robot)
        gain = last * max(others, end) + way * end
        gain += _drive(robot, task, plan)
        tours[robot, place : counts[robot] - 1] = tours[robot, place + 1 : counts[robot]].copy()
        counts[robot] -= 1
        gain -= _drive(robot, task, plan)
        end = _end(books, counts, robot)
        gain -= last * max(others, end) + way * end
    cost, to_robot, to_place = _best_place(goal, task, plan)
    moved = to_robot >= 0 and cost < gain - _LEAST
    if not moved:
        to_robot, to_place = robot, place
    if to_robot >= 0:
        tours[to_robot, to_place + 1 : counts[to_robot] + 1] = tours[
            to_robot, to_place : counts[to_robot]
        ].copy()
        tours[to_robot, to_place] = goal
        counts[to_robot] += 1
        _drive(to_robot, task, plan)
    return moved


@kernel(f"boolean(int64, int64, {_TASK}, {_PLAN})")
def _swap_ends(one: int, other: int, task: _Task, plan: _Plan) -> bool:
    """Swap the ends of two tours where that gains most; whether it gains anything."""
    starts, between, _, _, last, way, _ = task
    tours, counts, books = plan
    others = _longest(books, counts, one, other)
    end_one, end_other = _end(books, counts, one), _end(books, counts, other)
    now = max(others, end_one, end_other)
    best, best_one, best_other = -_LEAST, -1, -1
    for place in range(counts[one] + 1):
        gone = books[one, place - 1, 0] if place else 0.0
        for at in range(counts[other] + 1):
            run = books[other, at - 1, 0] if at else 0.0
            load_one = books[one, 0, 4] - books[one, place, 4] + books[other, at, 4]
            load_other = books[other, 0, 4] - books[other, at, 4] + books[one, place, 4]
            cost, new_one, new_other = 0.0, gone + load_one, run + load_other
            if at < counts[other]:
                goal = tours[other, at]
                step = between[tours[one, place - 1], goal] if place else starts[one, goal]
                later = gone + step - books[other, at, 0]
                cost += _delay(books[other], at, later)
                new_one = end_other + later - books[other, 0, 4] + load_one
            if place < counts[one]:
                goal = tours[one, place]
                step = between[tours[other, at - 1], goal] if at else starts[other, goal]
                later = run + step - books[one, place, 0]
                cost += _delay(books[one], place, later)
                new_other = end_one + later - books[one, 0, 4] + load_other
            cost += last * (max(others, new_one, new_other) - now)
            cost += way * (new_one + new_other - end_one - end_other)
            if cost < best:
                best, best_one, best_other = cost, place, at
    if best_one < 0:
        return False
    tail_one = tours[one, best_one : counts[one]].copy()
    tail_other = tours[other, best_other : counts[other]].copy()
    counts[one], counts[other] = best_one + len(tail_other), best_other + len(tail_one)
    tours[one, best_one : counts[one]] = tail_other
    tours[other, best_other : counts[other]] = tail_one
    for robot in (one, other):
        _drive(robot, task, plan)
    return True


@kernel(f"boolean(int64, {_TASK}, {_PLAN})")
def _turn_around(robot: int, task: _Task, plan: _Plan) -> bool:
    """Turn around the part of a tour where that gains most; whether it gains anything."""
    starts, between, weights, latency_weight, last, way, _ = task
    tours, counts, books = plan
    tour, count, book = tours[robot], counts[robot], books[robot]
    others, end = _longest(books, counts, robot, robot), _end(books, counts, robot)
    best, best_first, best_last = -_LEAST, -1, -1
    for first in range(count - 1):
        for final in range(first + 1, count):
            cost, arrival = 0.0, 0.0
            for at in range(final, first - 1, -1):
                goal = tour[at]
                if at < final:
                    arrival += between[tour[at + 1], goal]
                elif first:
                    arrival = book[first - 1, 0] + between[tour[first - 1], goal]
                else:
                    arrival = starts[robot, goal]
                before = book[at, 0]
                cost += (arrival - before) * (weights[goal] + latency_weight[goal] * (arrival + before))
            new_end = arrival + book[0, 4]
            if final + 1 < count:
                later = arrival + between[tour[first], tour[final + 1]] - book[final + 1, 0]
                cost += _delay(book, final + 1, later)
                new_end = end + later
            cost += last * (max(others, new_end) - max(others, end)) + way * (new_end - end)
            if cost < best:
                best, best_first, best_last = cost, first, final
    if best_first < 0:
        return False
    tour[best_first : best_last + 1] = tour[best_first : best_last + 1][::-1].copy()
    _drive(robot, task, plan)
    return True


@kernel(f"void({_TASK}, int64[::1], int64[:,::1], int64[::1])")
def _plan(task: _Task, order: NDArray[np.int64], tours: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
    """Insert the goals in their order, and improve; `tours` and `counts` begin empty."""
    robots, goals = task[0].shape
    plan = tours, counts, np.zeros((robots, goals + 1, 5))
    for goal in order:
        _move(goal, task, plan)
    for _ in range(ROUNDS):
        improved = False
        for goal in order:
            improved |= _move(goal, task, plan)
        for one in range(robots):
            for other in range(one):
                improved |= _swap_ends(one, other, task, plan)
        for robot in range(robots):
            improved |= _turn_around(robot, task, plan)
        if not improved:
            break
