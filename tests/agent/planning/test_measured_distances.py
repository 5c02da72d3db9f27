"""P(d) learned from measured distances, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from agent.planning.measured_distances import MeasuredDistances
from agent.planning.utility import proximity
from protocol.grid import FREE, OCCUPIED, UNKNOWN


def test_in_an_empty_hall_all_beams_reach_the_range() -> None:
    grid = np.full((41, 41), FREE, np.uint8)
    measured = MeasuredDistances(10.0, beams=4)
    measured.add(grid, (20, 20), 10.0)
    assert measured.shares().tolist() == [1.0] * 11


def test_the_share_of_beams_that_reach_a_distance_falls_behind_walls() -> None:
    # Four beams: to the right a wall at 2 cells, to the left one at 4, up and down nothing within 6 cells.
    grid = np.full((21, 21), FREE, np.uint8)
    grid[10, 12] = grid[10, 6] = OCCUPIED
    measured = MeasuredDistances(6.0, beams=4)
    measured.add(grid, (10, 10), 6.0)
    assert measured.shares().tolist() == [1.0, 1.0, 1.0, 0.75, 0.75, 0.5, 0.5]
    # From another place, all beams reach the range.
    measured.add(grid, (10, 14), 6.0)
    assert measured.shares().tolist() == [1.0, 1.0, 1.0, 0.875, 0.875, 0.75, 0.75]


def test_beams_that_end_in_unknown_cells_or_outside_the_grid_measure_nothing() -> None:
    grid = np.full((21, 21), UNKNOWN, np.uint8)
    grid[10, 10:] = FREE
    grid[10, 13] = OCCUPIED
    measured = MeasuredDistances(6.0, beams=4)
    measured.add(grid, (10, 10), 6.0)
    assert measured.shares().tolist() == [1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]


def test_before_any_measurement_p_is_that_of_equation_2() -> None:
    grid = np.full((5, 40), FREE, np.uint8)
    cells = np.array([(x, 2) for x in range(5, 30)], np.int32)
    target = np.array([5, 2], np.int32)
    learned = MeasuredDistances(20.0, beams=360).proximity(grid, cells, target, 20.0)
    assert learned == pytest.approx(proximity(grid, cells, target, 20.0))


def test_learned_p_is_interpolated_and_zero_behind_obstacles_and_beyond_the_range() -> None:
    grid = np.full((21, 21), FREE, np.uint8)
    grid[10, 12] = grid[10, 6] = OCCUPIED
    measured = MeasuredDistances(6.0, beams=4)
    measured.add(grid, (10, 10), 6.0)
    cells = np.array([(10, 10), (12, 12), (13, 10), (10, 4), (10, 3)], np.int32)
    found = measured.proximity(grid, cells, np.array([10, 10], np.int32), 6.0)
    # P between 2 and 3 cells falls from 1 to 0.75; (13, 10) is behind the wall, and 6 cells are not within the range.
    root = float(np.sqrt(8.0))
    assert found == pytest.approx([1.0, 1.0 - 0.25 * (root - 2), 0.0, 0.0, 0.0])
