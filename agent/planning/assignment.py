"""Assignments of goals to robots, by the costs of ways and the utilities of goals.

An assignment is an int64 array with the index of each robot's goal, -1 for none. There is at least one robot, and at
least one goal. Of equally good assignments the one with the first robot, then the first goal counts.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from agent.planning.utility import proximity, sees
from protocol.arrays import Cells, FloatRows, Floats, Int32s, Int64s
from protocol.grid import Grid
from protocol.kernels import kernel

Costs = FloatRows
"""Cost of the way of each robot to each goal; infinite without a way."""

Assignment = Int64s

STARTS = 8
"""Random starts of the search for the best assignment."""


def greedy(costs: Costs, order: Int64s) -> Assignment:
    """Give each robot, in the given order, the nearest goal that is left (Faigl and Vanek 2014, GA)."""
    left = costs.copy()
    given = np.full(len(costs), -1)
    for robot in order:
        goal = int(np.argmin(left[robot]))
        if np.isfinite(left[robot, goal]):
            given[robot] = goal
            left[:, goal] = np.inf
    return given


def iterative(costs: Costs) -> Assignment:
    """Repeatedly assign the cheapest pair whose robot and goal are both free (Faigl and Vanek 2014, IA)."""
    left = costs.copy()
    given = np.full(len(costs), -1)
    for _ in range(min(costs.shape)):
        robot, goal = divmod(int(np.argmin(left)), costs.shape[1])
        if not np.isfinite(left[robot, goal]):
            break
        given[robot] = goal
        left[robot] = np.inf
        left[:, goal] = np.inf
    return given


def hungarian(costs: Costs) -> Assignment:
    """Return the assignment of least total cost; `iterative` for fewer goals than robots (Faigl and Vanek 2014, HA)."""
    robots, goals = costs.shape
    if goals < robots:
        return iterative(costs)
    is_reached = np.isfinite(costs)
    far = 1e6 + 1e3 * costs[is_reached].max(initial=0.0)
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415  slow to import, and few need it

    rows, columns = linear_sum_assignment(np.where(is_reached, costs, far))
    given = np.full(robots, -1)
    given[rows] = np.where(is_reached[rows, columns], columns, -1)
    return given


Visibility = Callable[[Grid, Cells, Int32s, float], Floats]
"""Returns P(d) of cells for a target: `agent.planning.utility.proximity`, or a function with its parameters."""


def in_turn(
    grid: Grid,
    goals: Cells,
    utility: Floats,
    costs: Costs,
    ranges: Floats,
    visibility: Visibility = proximity,
) -> Assignment:
    """Assign goals as Algorithm 1 of Burgard et al. (section II-C) does.

    Assign the pair of best utility minus cost, lower the utilities around its goal, and repeat until every robot has a
    goal. Two robots may share a goal if no other is better.

    Obstacles of the planning grid hide goals from each other. `utility`, shape (n,), is that of each goal before the
    assignment; `costs`, shape (m, n), are multiplied by beta before, so that both are comparable. `ranges`, shape (m,),
    has the sensor range of each robot in cells. `visibility` returns the amounts P(d) by which a goal lowers utilities
    within this range.
    """
    worth = utility.copy()
    given = np.full(len(costs), -1)
    for _ in range(len(costs)):
        value = worth[None, :] - costs
        value[given >= 0] = -np.inf
        robot, goal = divmod(int(np.argmax(value)), len(goals))
        if not np.isfinite(value[robot, goal]):
            break
        given[robot] = goal
        worth -= visibility(grid, goals, goals[goal], ranges[robot])
    return given


def best_of_all(
    grid: Grid, goals: Cells, utility: Floats, costs: Costs, ranges: Floats, random: np.random.Generator
) -> Assignment:
    """Search for the assignment with the largest `total_value` (Burgard et al. 2005, Algorithm 2).

    Hill climbing from the assignment of `in_turn` and from `STARTS` random ones: a robot takes another goal, or two
    robots swap goals. Parameters are those of `in_turn`, with costs squared before they are weighted; P(d) is Eq. 2.
    """
    cost = np.where(np.isfinite(costs), costs, 1e9)
    best, best_value = in_turn(grid, goals, utility, cost, ranges), -np.inf
    for start in [best, *(random.integers(len(goals), size=(STARTS, len(costs))))]:
        given = start.astype(np.int64)
        _climb(grid, goals, utility, cost, ranges, given)
        value = total_value(grid, goals, utility, cost, ranges, given)
        if value > best_value + 1e-9:
            best, best_value = given, value
    return np.where(np.isfinite(costs[np.arange(len(costs)), best]), best, -1)


def total_value(
    grid: Grid, goals: Cells, utility: Floats, costs: Costs, ranges: Floats, given: Assignment
) -> float:
    """Return the sum over all robots of the utility of its goal, lowered by all other goals, minus its cost."""
    total = 0.0
    for robot, goal in enumerate(given):
        others = [
            sees(grid, goals[goal], goals[taken], ranges[other])
            for other, taken in enumerate(given)
            if other != robot
        ]
        total += float(utility[goal] - np.sum(others) - costs[robot, goal])
    return total


@kernel
def _overlap(grid: Grid, goals: Cells, one: int, other: int, range_one: float, range_other: float) -> float:
    """Sum of the amounts by which two robots with these goals and ranges lower each other's utilities."""
    lowered = sees(grid, goals[one], goals[other], range_one)
    if range_one == range_other:
        return lowered + lowered
    return lowered + sees(grid, goals[one], goals[other], range_other)


@kernel
def _climb(
    grid: Grid, goals: Cells, utility: Floats, costs: Costs, ranges: Floats, given: Assignment
) -> None:
    robots = len(given)
    improved = True
    while improved:
        improved = False
        for robot in range(robots):
            best, best_value, now = -1, -np.inf, -np.inf
            for goal in range(len(goals)):
                value = utility[goal] - costs[robot, goal]
                if value < best_value and goal != given[robot]:
                    continue
                for other in range(robots):
                    if other != robot:
                        value -= _overlap(grid, goals, goal, given[other], ranges[robot], ranges[other])
                if goal == given[robot]:
                    now = value
                if value > best_value:
                    best, best_value = goal, value
            if best_value > now + 1e-9:
                given[robot] = best
                improved = True
        for one in range(robots):
            for other in range(one):
                before = costs[one, given[one]] + costs[other, given[other]]
                after = costs[one, given[other]] + costs[other, given[one]]
                if ranges[one] != ranges[other]:
                    for third in range(robots):
                        if third not in (one, other):
                            at, reach = given[third], ranges[third]
                            before += _overlap(grid, goals, given[one], at, ranges[one], reach)
                            before += _overlap(grid, goals, given[other], at, ranges[other], reach)
                            after += _overlap(grid, goals, given[other], at, ranges[one], reach)
                            after += _overlap(grid, goals, given[one], at, ranges[other], reach)
                if after < before - 1e-9:
                    given[one], given[other] = given[other], given[one]
                    improved = True
