"""Targets that a robot could not reach are avoided for a while, and longer each time."""

from __future__ import annotations

import numpy as np
import pytest

from agent.planning.avoided import MOST_TIMES, AvoidedTargets
from agent.planning.frontier import frontier_cells
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid

TARGET, AWAY = (20, 10), (3, 10)


def half_known() -> Grid:
    """Return a grid whose left half is free, and whose right half is unknown."""
    grid = np.full((20, 40), UNKNOWN, np.uint8)
    grid[:, :21] = FREE
    return grid


def steps_avoided(avoided: AvoidedTargets, most: int = 100) -> int:
    """Return for how many steps the target is no frontier."""
    for step in range(most):
        grid = half_known()
        avoided.draw(grid, AWAY)
        avoided.pass_step()
        if list(TARGET) in frontier_cells(grid, grid == FREE).tolist():
            return step
    return most


def test_the_frontier_around_a_target_vanishes_and_other_frontiers_stay() -> None:
    avoided = AvoidedTargets(reach=5.0, radius=1.0)
    avoided.add(TARGET, 1)
    grid = half_known()
    avoided.draw(grid, AWAY)
    left = frontier_cells(grid, grid == FREE)
    assert {tuple(cell) for cell in left.tolist()} == {(20, row) for row in range(20) if abs(row - 10) > 4}
    assert (grid[:, :21] == FREE).all(), "ways over known cells stay"
    assert (grid[:, 21:] != FREE).all()


def test_each_failure_doubles_the_time_until_the_target_is_given_up() -> None:
    avoided = AvoidedTargets(reach=5.0, radius=1.0)
    for time in range(MOST_TIMES - 1):
        avoided.add(TARGET, 10)
        assert avoided.waits
        assert steps_avoided(avoided) == 10 << time
        assert not avoided.waits
    avoided.add((TARGET[0], TARGET[1] + 1), 10)
    assert not avoided.waits
    assert steps_avoided(avoided) == 100


@pytest.mark.parametrize("here", [TARGET, (19, 10), (18, 9)])
def test_a_robot_beside_the_target_is_not_enclosed(here: tuple[int, int]) -> None:
    avoided = AvoidedTargets(reach=5.0, radius=2.0)
    avoided.add(TARGET, 10)
    grid = half_known()
    avoided.draw(grid, here)
    rows, columns = np.nonzero(grid == OCCUPIED)
    assert len(rows)
    assert np.hypot(columns - here[0], rows - here[1]).min() > 2.0
    assert list(TARGET) not in frontier_cells(grid, grid == FREE).tolist()
