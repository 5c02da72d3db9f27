"""Forces by the leader paper's formulas, and the motion that they lead to."""

from __future__ import annotations

import numpy as np
import pytest

from agent.planning.forces import SUBSTEPS, TIME_STEP, FieldParameters, closest_obstacle, glide, repulsion
from protocol.grid import FREE, OCCUPIED

FIELD = FieldParameters(
    rho_robots=2.0, rho_obstacles=0.5, gain_robots=0.5, gain_obstacles=0.01, gain_frontier=1.0, damping=1.5
)
NO_ROBOTS = np.empty((0, 2))
NOWHERE = np.empty((0, 2), np.int32)


def test_repulsion_is_that_of_equation_2() -> None:
    # k (1 / d - 1 / rho) / d^2 = 3 (1 / 0.5 - 1 / 2) / 0.25
    assert repulsion(0.5, 2.0, 3.0) == pytest.approx(18.0)
    assert repulsion(2.0, 2.0, 3.0) == 0.0
    assert repulsion(2.1, 2.0, 3.0) == 0.0


def test_the_first_euler_step_is_the_sum_of_all_forces() -> None:
    floor = np.full((100, 100), FREE, np.uint8)
    floor[50, 46] = OCCUPIED
    frontier = np.array([(80, 50)], np.int32)
    at, velocity = (50.0, 50.0), np.array([0.2, 0.1])
    path, _ = glide(floor, 0.1, at, velocity, frontier, np.array([(50.0, 40.0)]), FIELD, 100.0)
    # The obstacle's border is 3.5 cells away, the robot 10, the frontier point 30; a cell is 0.1 m.
    force_x = 3.0 + 0.01 * (1 / 0.35 - 1 / 0.5) / 0.35**2 - 1.5 * 0.2
    force_y = 0.5 * (1 / 1.0 - 1 / 2.0) - 1.5 * 0.1
    after = velocity + TIME_STEP * np.array([force_x, force_y])
    np.testing.assert_allclose(path[0], np.array(at) + after * TIME_STEP / 0.1)


def test_nothing_is_faster_than_the_top_speed() -> None:
    floor = np.full((300, 300), FREE, np.uint8)
    path, velocity = glide(
        floor, 0.1, (10.0, 10.0), np.zeros(2), np.array([(290, 290)], np.int32), NO_ROBOTS, FIELD, 1.0
    )
    steps = np.hypot(*np.diff(path, axis=0).T) * 0.1 / TIME_STEP
    assert steps.max() <= 1.0 + 1e-9
    assert np.hypot(*velocity) == pytest.approx(1.0)
    assert len(path) == SUBSTEPS


def test_without_forces_damping_brings_a_robot_to_rest() -> None:
    floor = np.full((100, 100), FREE, np.uint8)
    velocity = np.array([1.0, 0.0])
    _, slower = glide(floor, 0.1, (50.0, 50.0), velocity, NOWHERE, NO_ROBOTS, FIELD, 1.0)
    assert slower[0] == pytest.approx((1 - 1.5 * TIME_STEP) ** SUBSTEPS)


def test_a_robot_slides_along_the_border_of_its_known_free_space() -> None:
    floor = np.full((40, 40), FREE, np.uint8)
    floor[:, 21:] = 0
    path, _ = glide(
        floor, 0.1, (20.0, 20.0), np.zeros(2), np.array([(39, 30)], np.int32), NO_ROBOTS, FIELD, 1.0
    )
    assert path[:, 0].max() < 20.5
    assert path[-1, 1] > 20.5


@pytest.mark.parametrize("at", [(9.4, 5.0), (-0.4, 5.0), (5.0, 9.4), (5.0, -0.4)])
def test_a_robot_that_is_pushed_out_of_its_map_stays_on_it(at: tuple[float, float]) -> None:
    floor = np.full((10, 10), FREE, np.uint8)
    inwards = np.array([at]) - np.sign(np.array(at) - 5.0)
    path, velocity = glide(floor, 0.25, at, np.zeros(2), NOWHERE, inwards, FIELD, 1.0)
    assert (path > -0.5).all()
    assert (path < 9.5).all()
    assert (velocity == 0.0).all()


def test_the_closest_obstacle_is_the_closest_point_of_a_cell() -> None:
    floor = np.full((20, 20), FREE, np.uint8)
    floor[10, 5] = floor[12, 10] = OCCUPIED
    found = np.empty(2)
    closest_obstacle(floor, 10.2, 10.0, 4.0, found)
    np.testing.assert_allclose(found, (10.2, 11.5))
    closest_obstacle(floor, 10.2, 10.0, 1.0, found)
    assert np.isnan(found).all()


def test_a_moving_teammate_repels_from_where_it_is_at_each_moment() -> None:
    floor = np.full((100, 100), FREE, np.uint8)
    at, robots = (50.0, 50.0), np.array([(50.0, 35.0)])
    drifts = np.array([(0.0, 10.0)])
    moving, _ = glide(floor, 0.1, at, np.zeros(2), NOWHERE, robots, FIELD, 100.0, drifts)
    still, _ = glide(floor, 0.1, at, np.zeros(2), NOWHERE, robots, FIELD, 100.0)
    np.testing.assert_array_equal(moving[0], still[0])
    assert (moving[2:, 1] > still[2:, 1]).all()
    away, _ = glide(floor, 0.1, at, np.zeros(2), NOWHERE, robots, FIELD, 100.0, -drifts)
    assert (away[2:, 1] < still[2:, 1]).all()
