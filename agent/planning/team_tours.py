"""Minimum-latency tours of a team through all goals: the k-traveling repairmen problem.

Traveling salesmen minimize the length of their tours, repairmen the arrival times at goals (Fakcharoenphol, Harrelson
and Rao 2007). Here a goal costs its weight times its arrival, plus its latency weight times the square of
its arrival, so that small goals may wait for some time but not for long. The lengths of all tours and of the longest
tour count as well: they bound the end of the run. The length of a tour includes the expected work behind its goals
(their loads), so that a robot with large unknown areas gets fewer other goals.

The search inserts goals one by one where they cost least. Then it improves the tours: it moves single goals, swaps the
ends of two tours, or reverses a part of a tour, as long as the cost decreases. Sums over the rest of a tour give the
cost of a change without evaluating the whole tour. Kernels loop over all attempts of a kind themselves: to call one
with so many arrays takes longer than most attempts.
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
    latency_weights: Floats
    """Cost of each goal per square of its arrival distance, shape (n,)."""
    longest_weight: float
    """Cost per cell of the longest tour."""
    length_weight: float
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
    return [tours[robot, :count].tolist() if count else [] for robot, count in enumerate(counts.tolist())]


_Task = tuple[FloatRows, FloatRows, Floats, Floats, float, float, Floats]
_Sums = Annotated[NDArray[np.float64], "float64[:,:,::1]"]
_Plan = tuple[Int64Rows, Int64s, _Sums, Floats]
"""Tours by robot and place, the number of goals of each, the sums of `_drive`, and the length of each tour."""
_Ranks = tuple[int, int, int]


@kernel
def _drive(robot: int, task: _Task, plan: _Plan) -> float:
    """Compute the arrival at each place of a tour, and sums over the later goals; return the cost of the goals.

    `sums[robot, k]` has the arrival at place k, then sums of weight, latency weight, latency weight times arrival, and
    load. The length of the tour includes its loads.
    """
    starts, between, weights, latency_weights, _, _, loads = task
    tours, counts, sums, ends = plan
    tour, count, row = tours[robot], counts[robot], sums[robot]
    arrival = 0.0
    total = 0.0
    for place in range(count):
        goal = tour[place]
        arrival += starts[robot, goal] if place == 0 else between[tour[place - 1], goal]
        row[place, 0] = arrival
        total += weights[goal] * arrival + latency_weights[goal] * arrival * arrival
    row[count] = 0.0
    for place in range(count - 1, -1, -1):
        goal = tour[place]
        row[place, 1] = row[place + 1, 1] + weights[goal]
        row[place, 2] = row[place + 1, 2] + latency_weights[goal]
        row[place, 3] = row[place + 1, 3] + latency_weights[goal] * row[place, 0]
        row[place, 4] = row[place + 1, 4] + loads[goal]
    ends[robot] = row[count - 1, 0] + row[0, 4] if count else 0.0
    return total


@kernel
def _delay(sums: _Sums, robot: int, place: int, later: float) -> float:
    """Return the additional cost if a robot's arrival at all goals from `place` on increases by `later`."""
    return float(
        later * (sums[robot, place, 1] + 2.0 * sums[robot, place, 3] + later * sums[robot, place, 2])
    )


@kernel
def _rank(ends: Floats) -> tuple[int, int, int]:
    """Return the robots of the three longest tours, the longest first; -1 where there are fewer robots."""
    first, second, third = -1, -1, -1
    for robot in range(len(ends)):
        end = ends[robot]
        if first < 0 or end > ends[first]:
            first, second, third = robot, first, second
        elif second < 0 or end > ends[second]:
            second, third = robot, second
        elif third < 0 or end > ends[third]:
            third = robot
    return first, second, third


@kernel
def _longest(ends: Floats, ranks: _Ranks, one: int, other: int) -> float:
    """Return the length of the longest tour of the robots other than these two, given the `_rank` of all tours."""
    for robot in ranks:
        if robot not in (one, other):
            return float(ends[robot]) if robot >= 0 else 0.0
    return 0.0


@kernel
def _best_place(goal: int, task: _Task, plan: _Plan) -> tuple[float, int, int]:
    """Find the cheapest insertion of a goal: the cost, the robot (-1 for an unreachable goal) and the place."""
    starts, between, weights, latency_weights, longest_weight, length_weight, loads = task
    tours, counts, sums, ends = plan
    least, best_robot, best_place = np.inf, -1, -1
    ranks = _rank(ends)
    for robot in range(len(counts)):
        if not np.isfinite(starts[robot, goal]):
            continue
        others, end = _longest(ends, ranks, robot, robot), ends[robot]
        for place in range(counts[robot] + 1):
            arrival = starts[robot, goal]
            if place:
                before = tours[robot, place - 1]
                arrival = sums[robot, place - 1, 0] + between[before, goal]
            cost = arrival * (weights[goal] + arrival * latency_weights[goal])
            new_end = arrival + sums[robot, 0, 4] + loads[goal]
            if place < counts[robot]:
                later = arrival + between[goal, tours[robot, place]] - sums[robot, place, 0]
                cost += _delay(sums, robot, place, later)
                new_end = end + later + loads[goal]
            cost += longest_weight * (max(others, new_end) - max(others, end)) + length_weight * (
                new_end - end
            )
            if cost < least:
                least, best_robot, best_place = cost, robot, place
    return least, best_robot, best_place


@kernel
def _move_goals(order: Int64s, idle: int, attempts: int, task: _Task, plan: _Plan) -> int:
    """Move each goal to its cheapest place, if the cost decreases; goals of no tour are inserted there.

    Takes and returns the number of attempts in a row that changed nothing; ends early when it reaches `attempts`.
    """
    _, _, _, _, longest_weight, length_weight, _ = task
    tours, counts, _, ends = plan
    for goal in order:
        if idle == attempts:
            break
        robot, place, gain = -1, -1, np.inf
        for each in range(len(counts)):
            for at in range(counts[each]):
                if tours[each, at] == goal:
                    robot, place = each, at
        if robot >= 0:
            others, end = _longest(ends, _rank(ends), robot, robot), ends[robot]
            gain = longest_weight * max(others, end) + length_weight * end
            gain += _drive(robot, task, plan)
            counts[robot] -= 1
            for at in range(place, counts[robot]):
                tours[robot, at] = tours[robot, at + 1]
            gain -= _drive(robot, task, plan)
            end = ends[robot]
            gain -= longest_weight * max(others, end) + length_weight * end
        cost, to_robot, to_place = _best_place(goal, task, plan)
        idle += 1
        if to_robot >= 0 and cost < gain - _LEAST:
            idle = 0
        else:
            to_robot, to_place = robot, place
        if to_robot >= 0:
            for at in range(counts[to_robot], to_place, -1):
                tours[to_robot, at] = tours[to_robot, at - 1]
            tours[to_robot, to_place] = goal
            counts[to_robot] += 1
            _drive(to_robot, task, plan)
    return idle


@kernel
def _swap_ends(idle: int, attempts: int, task: _Task, plan: _Plan) -> int:
    """Swap the ends of each two tours at the best places, if the cost decreases.

    Takes and returns the number of attempts in a row that changed nothing; ends early when it reaches `attempts`.
    """
    starts, between, _, _, longest_weight, length_weight, _ = task
    tours, counts, sums, ends = plan
    ranks = _rank(ends)
    for one in range(len(counts)):
        for other in range(one):
            if idle == attempts:
                return idle
            idle += 1
            if counts[one] + counts[other] == 0:
                continue
            others, end_one, end_other = _longest(ends, ranks, one, other), ends[one], ends[other]
            now = max(others, end_one, end_other)
            best, best_one, best_other = -_LEAST, -1, -1
            for place in range(counts[one] + 1):
                gone = sums[one, place - 1, 0] if place else 0.0
                for at in range(counts[other] + 1):
                    run = sums[other, at - 1, 0] if at else 0.0
                    load_one = sums[one, 0, 4] - sums[one, place, 4] + sums[other, at, 4]
                    load_other = sums[other, 0, 4] - sums[other, at, 4] + sums[one, place, 4]
                    cost, new_one, new_other = 0.0, gone + load_one, run + load_other
                    if at < counts[other]:
                        goal = tours[other, at]
                        step = between[tours[one, place - 1], goal] if place else starts[one, goal]
                        later = gone + step - sums[other, at, 0]
                        cost += _delay(sums, other, at, later)
                        new_one = end_other + later - sums[other, 0, 4] + load_one
                    if place < counts[one]:
                        goal = tours[one, place]
                        step = between[tours[other, at - 1], goal] if at else starts[other, goal]
                        later = run + step - sums[one, place, 0]
                        cost += _delay(sums, one, place, later)
                        new_other = end_one + later - sums[one, 0, 4] + load_other
                    cost += longest_weight * (max(others, new_one, new_other) - now)
                    cost += length_weight * (new_one + new_other - end_one - end_other)
                    if cost < best:
                        best, best_one, best_other = cost, place, at
            if best_one >= 0:
                _exchange(one, best_one, other, best_other, task, plan)
                idle, ranks = 0, _rank(ends)
    return idle


@kernel
def _exchange(one: int, place: int, other: int, at: int, task: _Task, plan: _Plan) -> None:
    """Exchange the ends of two tours, from these places on."""
    tours, counts, _, _ = plan
    tail_one = tours[one, place : counts[one]].copy()
    tail_other = tours[other, at : counts[other]].copy()
    counts[one], counts[other] = place + len(tail_other), at + len(tail_one)
    tours[one, place : counts[one]] = tail_other
    tours[other, at : counts[other]] = tail_one
    for robot in (one, other):
        _drive(robot, task, plan)


@kernel
def _reverse_parts(idle: int, attempts: int, task: _Task, plan: _Plan) -> int:
    """Reverse the best part of each tour, if the cost decreases; arguments and result as those of `_swap_ends`."""
    starts, between, weights, latency_weights, longest_weight, length_weight, _ = task
    tours, counts, sums, ends = plan
    for robot in range(len(counts)):
        if idle == attempts:
            break
        idle += 1
        if counts[robot] < 2:
            continue
        others, end = _longest(ends, _rank(ends), robot, robot), ends[robot]
        best, best_first, best_last = -_LEAST, -1, -1
        for first in range(counts[robot] - 1):
            for final in range(first + 1, counts[robot]):
                cost, arrival = 0.0, 0.0
                for at in range(final, first - 1, -1):
                    goal = tours[robot, at]
                    if at < final:
                        arrival += between[tours[robot, at + 1], goal]
                    elif first:
                        arrival = sums[robot, first - 1, 0] + between[tours[robot, first - 1], goal]
                    else:
                        arrival = starts[robot, goal]
                    before = sums[robot, at, 0]
                    cost += (arrival - before) * (weights[goal] + latency_weights[goal] * (arrival + before))
                new_end = arrival + sums[robot, 0, 4]
                if final + 1 < counts[robot]:
                    following = sums[robot, final + 1, 0]
                    later = arrival + between[tours[robot, first], tours[robot, final + 1]] - following
                    cost += _delay(sums, robot, final + 1, later)
                    new_end = end + later
                cost += longest_weight * (max(others, new_end) - max(others, end)) + length_weight * (
                    new_end - end
                )
                if cost < best:
                    best, best_first, best_last = cost, first, final
        if best_first >= 0:
            part = tours[robot, best_first : best_last + 1]
            part[:] = part[::-1].copy()
            _drive(robot, task, plan)
            idle = 0
    return idle


@kernel
def _plan(task: _Task, order: Int64s, tours: Int64Rows, counts: Int64s) -> None:
    """Insert the goals in the given order, then improve; `tours` and `counts` are empty before.

    A round attempts to move each goal, to swap the ends of each pair of tours, and to reverse a part of each tour. The
    search ends when as many attempts in a row have changed nothing, wherever in a round: none of them would later.
    """
    robots, goals = task[0].shape
    plan = tours, counts, np.zeros((robots, goals + 1, 5)), np.zeros(robots)
    attempts = goals + robots * (robots + 1) // 2
    _move_goals(order, 0, attempts, task, plan)
    idle = 0
    for _ in range(ROUNDS):
        idle = _move_goals(order, idle, attempts, task, plan)
        idle = _swap_ends(idle, attempts, task, plan)
        idle = _reverse_parts(idle, attempts, task, plan)
