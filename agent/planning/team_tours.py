"""Minimum-latency tours of a team through all goals: the k-traveling repairmen problem.

Traveling salesmen minimize the length of their tours, repairmen the arrival times at goals (Fakcharoenphol, Harrelson
and Rao 2007). Here a goal costs its weight times its arrival, plus its latency weight times the square of
its arrival, so that small goals may wait for some time but not for long. The lengths of all tours and of the longest
tour count as well: they bound the end of the run. The length of a tour includes the expected work behind its goals
(their loads), so that a robot with large unknown areas gets fewer other goals.

The search inserts goals one by one where they cost least. Then it improves the tours: it moves single goals, swaps the
ends of two tours, or reverses a part of a tour, as long as the cost decreases. Sums over the rest of a tour give the
cost of a change without evaluating the whole tour.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import FloatRows, Floats, Int64Rows, Int64s
from protocol.kernels import kernel

ROUNDS = 10
"""Largest number of improvement rounds; the search ends earlier if a round changes nothing."""

_LEAST = 1e-7
"""Least improvement that counts; less may be rounding."""


class Task(NamedTuple):
    """Input of the planner."""

    starts: FloatRows
    """Distance from each robot to each goal, shape (m, n); infinite without a way."""
    between: FloatRows
    """Distance between goals, symmetric, shape (n, n)."""
    weights: Floats
    """Cost of each goal per cell of its arrival distance, shape (n,)."""
    latency_weight: Floats
    """Cost of each goal per square of its arrival distance, shape (n,)."""
    last: float
    """Cost per cell of the longest tour."""
    way: float
    """Cost per cell of every tour."""
    loads: Floats
    """Length that each goal adds to the end of its tour, for the expected work behind it, shape (n,)."""

    def key(self) -> tuple[object, ...]:
        """Return a key for caches: equal for equal tasks."""
        return Task, self.starts.shape, *(np.asarray(each).tobytes() for each in self)


def team_tours(task: Task) -> list[list[int]]:
    """Plan one tour per robot, goals in their order, at a small cost (see above); unreachable goals are left out."""
    robots, goals = task.starts.shape
    tours = np.full((robots, goals), -1)
    counts = np.zeros(robots, np.int64)
    order = np.lexsort((task.starts.min(axis=0), -task.weights)) if goals else np.empty(0, np.int64)
    _plan((*task,), order, tours, counts)
    return [tour[:count].tolist() for tour, count in zip(tours, counts, strict=True)]


_Task = tuple[FloatRows, FloatRows, Floats, Floats, float, float, Floats]
_Books = Annotated[NDArray[np.float64], "float64[:,:,::1]"]
_Plan = tuple[Int64Rows, Int64s, _Books]
"""Tours by robot and place, the length of each, and the sums of `_drive`."""
_Ranks = tuple[int, int, int]


@kernel
def _drive(robot: int, task: _Task, plan: _Plan) -> float:
    """Compute the arrival at each place of a tour, and sums over the later goals; return the cost of the goals.

    `book[k]` has the arrival at place k, then sums of weight, latency weight, latency weight times arrival, and load.
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


@kernel
def _delay(book: FloatRows, place: int, later: float) -> float:
    """Return the additional cost if the arrival at all goals from `place` on increases by `later`."""
    return float(later * (book[place, 1] + 2.0 * book[place, 3] + later * book[place, 2]))


@kernel
def _end(books: _Books, counts: Int64s, robot: int) -> float:
    """Return the length of a robot's tour, loads included."""
    return float(books[robot, counts[robot] - 1, 0] + books[robot, 0, 4]) if counts[robot] else 0.0


@kernel
def _rank(books: _Books, counts: Int64s) -> tuple[int, int, int]:
    """Return the robots of the three longest tours, the longest first; -1 where there are fewer robots."""
    first, second, third = -1, -1, -1
    for robot in range(len(counts)):
        end = _end(books, counts, robot)
        if first < 0 or end > _end(books, counts, first):
            first, second, third = robot, first, second
        elif second < 0 or end > _end(books, counts, second):
            second, third = robot, second
        elif third < 0 or end > _end(books, counts, third):
            third = robot
    return first, second, third


@kernel
def _longest(books: _Books, counts: Int64s, ranks: _Ranks, one: int, other: int) -> float:
    """Return the length of the longest tour of the robots other than these two, given the `_rank` of all tours."""
    for robot in ranks:
        if robot not in (one, other):
            return _end(books, counts, robot) if robot >= 0 else 0.0
    return 0.0


@kernel
def _best_place(goal: int, task: _Task, plan: _Plan) -> tuple[float, int, int]:
    """Find the cheapest insertion of a goal: the cost, the robot (-1 for an unreachable goal) and the place."""
    starts, between, weights, latency_weight, last, way, loads = task
    tours, counts, books = plan
    least, best_robot, best_place = np.inf, -1, -1
    ranks = _rank(books, counts)
    for robot in range(len(counts)):
        if not np.isfinite(starts[robot, goal]):
            continue
        others = _longest(books, counts, ranks, robot, robot)
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


@kernel
def _move(goal: int, task: _Task, plan: _Plan) -> bool:
    """Move a goal to its cheapest place; return whether that is another place than before."""
    _, _, _, _, last, way, _ = task
    tours, counts, books = plan
    robot, place, gain = -1, -1, np.inf
    for each in range(len(counts)):
        for at in range(counts[each]):
            if tours[each, at] == goal:
                robot, place = each, at
    if robot >= 0:
        others = _longest(books, counts, _rank(books, counts), robot, robot)
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


@kernel
def _swap_ends(one: int, other: int, ranks: _Ranks, task: _Task, plan: _Plan) -> bool:
    """Swap the ends of two tours at the best places; return whether the cost decreases.

    `ranks` is the `_rank` of all tours before.
    """
    starts, between, _, _, last, way, _ = task
    tours, counts, books = plan
    others = _longest(books, counts, ranks, one, other)
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


@kernel
def _reverse_part(robot: int, task: _Task, plan: _Plan) -> bool:
    """Reverse the best part of a tour; return whether the cost decreases."""
    starts, between, weights, latency_weight, last, way, _ = task
    tours, counts, books = plan
    tour, count, book = tours[robot], counts[robot], books[robot]
    if count < 2:
        return False
    others, end = _longest(books, counts, _rank(books, counts), robot, robot), _end(books, counts, robot)
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


@kernel
def _plan(task: _Task, order: Int64s, tours: Int64Rows, counts: Int64s) -> None:
    """Insert the goals in the given order, then improve; `tours` and `counts` are empty before."""
    robots, goals = task[0].shape
    plan = tours, counts, np.zeros((robots, goals + 1, 5))
    for goal in order:
        _move(goal, task, plan)
    for _ in range(ROUNDS):
        improved = False
        for goal in order:
            improved |= _move(goal, task, plan)
        ranks = _rank(plan[2], counts)
        for one in range(robots):
            for other in range(one):
                if counts[one] + counts[other] and _swap_ends(one, other, ranks, task, plan):
                    improved = True
                    ranks = _rank(plan[2], counts)
        for robot in range(robots):
            improved |= _reverse_part(robot, task, plan)
        if not improved:
            break
