"""Start positions of robots: given one by one or around one place, and moved at random by the seed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import make
from deploy.scenario.scenario import Scenario
from protocol.grid import FREE, OCCUPIED
from worldsim.maps import Map

HALL = Map("hall", np.full((100, 200), FREE, np.uint8), 0.1)


def starts(**settings: Any) -> list[tuple[int, int]]:
    return list(make(Scenario(**settings), HALL).world.starts)


def test_the_first_robots_start_at_the_given_starts_and_the_others_around_the_start() -> None:
    found = starts(robots=3, starts=[(1.05, 1.05), (15.05, 9.05)], start=(10.05, 5.05))
    assert found == [(10, 89), (150, 9), (100, 49)]
    assert starts(robots=1, starts=[(1.05, 1.05), (15.05, 9.05)]) == [(10, 89)]


def test_jitter_moves_the_start_by_the_seed_and_no_farther_than_its_limit() -> None:
    fixed = starts(robots=3, start=(10.0, 5.0))
    found = [starts(robots=3, start=(10.0, 5.0), start_jitter=0.5, seed=seed) for seed in range(20)]
    assert all(math.dist(each[0], fixed[0]) <= 5 for each in found)
    assert len({each[0] for each in found}) > 10
    assert found[3] == starts(robots=3, start=(10.0, 5.0), start_jitter=0.5, seed=3)
    both = [(10.0, 5.0), (10.4, 5.0)]
    for seed in range(20):
        one, other = starts(robots=2, starts=both, start_jitter=1.0, radius=0.15, seed=seed)
        assert math.dist(one, other) >= 3


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"start_jitter": 1.0}, "set start or starts"),
        ({"starts": [(1.0, 1.0), (1.0, 1.0)]}, "robots 0 and 1 would start in the same place"),
        ({"starts": [(-5.0, 1.0)]}, "-5,1 is outside the map, which extends from 0,0 to 20,10"),
        ({"starts": [1.0]}, "starts.0 = 1.0"),
    ],
)
def test_an_invalid_start_is_rejected(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        starts(robots=2, **settings)


def test_a_start_in_a_wall_is_rejected_with_the_nearest_free_point() -> None:
    cells = HALL.cells.copy()
    cells[:, :2] = OCCUPIED
    message = "0,3.04 is not free: robots cannot start there; the nearest free point is 0.25,3.05"
    with pytest.raises(ScenarioError, match=message):
        make(Scenario(robots=1, start=(0.0, 3.04)), Map("hall", cells, 0.1))


def test_a_start_on_the_border_is_in_the_cell_beside_it() -> None:
    assert starts(robots=2, starts=[(0.0, 0.0), (20.0, 10.0)]) == [(0, 99), (199, 0)]


def test_without_collisions_robots_may_start_in_one_place() -> None:
    assert starts(robots=2, starts=[(1.0, 1.0), (1.0, 1.0)], robots_collide=False)[0] == (10, 90)


def test_each_robot_may_have_its_own_radius_and_scanner() -> None:
    own = [{"robot": 1, "radius": 0.2, "scanner_turn": 72.0}]
    plan = make(Scenario(robots=2, robot=own, scanner_turn=18.0, motion="cells", robots_collide=False), HALL)
    assert [body.radius_cells for body in plan.world.bodies] == [0.0, 2.0]
    assert [body.scanner_turn for body in plan.world.bodies] == [18.0, 72.0]
    assert plan.robot_settings[0].bodies == plan.world.bodies
    assert plan.world.cell_steps
    assert not plan.world.robots_collide
