"""The ray table: the cells that beams cross, compared with a slow traversal in exact fractions."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise, takewhile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation

from protocol.grid import FREE, MAX_ROBOTS, MAX_SIDE, OCCUPIED, RayTable, disc, enlarge, ray_table

ranges = st.floats(1, 40) | st.integers(1, 40).map(float)
beam_counts = st.integers(1, 30).map(lambda quarters: 4 * quarters)


def walks(laid: RayTable) -> list[list[tuple[int, int]]]:
    cells = [(int(x), int(y)) for x, y in laid.cells]
    return [cells[begin:end] for begin, end in pairwise(laid.start.tolist())]


def walk_by_fractions(beam: int, beams: int, range_cells: float) -> list[tuple[int, int]]:
    """Cross the borders between cells one by one, in the order of their exact distances, x before y."""
    angle = 2 * math.pi * beam / beams
    unit = 1 << 20
    direction = round(math.cos(angle) * unit), round(math.sin(angle) * unit)
    crossings = sorted(
        (Fraction(2 * border + 1, 2 * abs(along)), axis)
        for axis, along in enumerate(direction)
        if along
        for border in range(math.ceil(range_cells) + 1)
    )
    cell = [0, 0]
    walk = []
    for _, axis in crossings:
        cell[axis] += 1 if direction[axis] > 0 else -1
        if Fraction(cell[0] ** 2 + cell[1] ** 2) > Fraction(range_cells * range_cells):
            break
        walk.append((cell[0], cell[1]))
    return walk


@given(ranges, beam_counts)
def test_beams_equal_those_in_exact_fractions(range_cells: float, beams: int) -> None:
    for beam, walk in enumerate(walks(ray_table(range_cells, beams))):
        assert walk == walk_by_fractions(beam, beams, range_cells)


@given(ranges, beam_counts)
def test_a_beam_moves_between_4_neighbors_and_crosses_no_cell_twice(range_cells: float, beams: int) -> None:
    for walk in walks(ray_table(range_cells, beams)):
        for (x0, y0), (x1, y1) in pairwise([(0, 0), *walk]):
            assert abs(x1 - x0) + abs(y1 - y0) == 1
            assert abs(x1) + abs(y1) == abs(x0) + abs(y0) + 1


@given(ranges, beam_counts)
def test_beams_end_at_the_sensor_range(range_cells: float, beams: int) -> None:
    for walk in walks(ray_table(range_cells, beams)):
        assert all(math.hypot(x, y) <= range_cells + 1e-9 for x, y in walk)
        assert math.hypot(*walk[-1]) > range_cells - 1 - 1e-9


@given(ranges, beam_counts)
def test_each_of_the_four_neighbors_is_the_first_cell_of_a_beam(range_cells: float, beams: int) -> None:
    firsts = [walk[0] for walk in walks(ray_table(range_cells, beams))]
    assert [firsts[quarter * beams // 4] for quarter in range(4)] == [(1, 0), (0, 1), (-1, 0), (0, -1)]


@given(st.integers(1, 60).map(float))
def test_a_whole_range_reaches_its_last_cell_along_the_axes(range_cells: float) -> None:
    laid = walks(ray_table(range_cells))
    assert [walk[-1] for walk in laid[::90]] == [
        (range_cells, 0),
        (0, range_cells),
        (-range_cells, 0),
        (0, -range_cells),
    ]


def test_beams_turn_from_x_towards_y_and_stay_on_their_line() -> None:
    for beam, walk in enumerate(walks(ray_table(30.0))):
        angle = math.radians(beam)
        for x, y in walk:
            assert x * math.cos(angle) + y * math.sin(angle) > 0
            assert abs(x * math.sin(angle) - y * math.cos(angle)) <= math.sqrt(0.5) + 1e-5


def test_a_beam_through_corners_takes_the_cell_beside_it_in_x_first() -> None:
    assert walks(ray_table(3.0))[45] == [(1, 0), (1, 1), (2, 1), (2, 2)]
    assert walks(ray_table(3.0))[225] == [(-1, 0), (-1, -1), (-2, -1), (-2, -2)]


def test_all_cells_in_range_are_seen_where_beams_lie_close() -> None:
    seen = {cell for walk in walks(ray_table(20.0)) for cell in walk}
    assert {(x, y) for x in range(-20, 21) for y in range(-20, 21) if 0 < x * x + y * y <= 400} == seen


@pytest.mark.parametrize("range_cells", [0.99, 0.0, -1.0, math.nan])
def test_a_range_that_does_not_reach_the_neighbors_is_rejected(range_cells: float) -> None:
    with pytest.raises(ValueError, match="must see at least its neighbors"):
        ray_table(range_cells)


@pytest.mark.parametrize("beams", [0, 2, 3, 5, 359, -4])
def test_beams_that_miss_a_neighbor_are_rejected(beams: int) -> None:
    with pytest.raises(ValueError, match="multiple of 4"):
        ray_table(5.0, beams)


@pytest.mark.parametrize("range_cells", [1e300, math.inf])
def test_a_range_beyond_any_grid_ends_with_the_largest_grid(range_cells: float) -> None:
    laid = ray_table(range_cells, 8)
    assert len(laid.cells) < 8 * 2 * MAX_SIDE
    for walk in walks(laid):
        assert math.hypot(*walk[-1]) >= (MAX_SIDE - 1) * math.sqrt(2)


@given(ranges, beam_counts)
def test_shared_cells_are_the_common_prefix_of_successive_beams(range_cells: float, beams: int) -> None:
    laid = ray_table(range_cells, beams)
    both = [zip(before, walk, strict=False) for before, walk in pairwise(walks(laid))]
    shared = [len(list(takewhile(lambda cells: cells[0] == cells[1], pairs))) for pairs in both]
    assert laid.shared.tolist() == [0, *shared]


def test_the_ray_table_has_integer_offsets() -> None:
    laid = ray_table(7.5, 36)
    assert laid.cells.dtype == np.int32
    assert laid.start.dtype == np.int32
    assert laid.beams == 36
    assert laid.start[0] == 0
    assert laid.start[-1] == len(laid.cells)


def test_grids_and_teams_are_as_large_as_the_packets_allow() -> None:
    assert MAX_SIDE >= 2048
    assert MAX_ROBOTS >= 64


@given(
    st.integers(0, 2**32), st.floats(0, 6) | st.integers(0, 6).map(float), st.sampled_from([0.0, 0.02, 0.3])
)
def test_obstacles_grow_by_the_disc_of_a_robot(seed: int, radius: float, density: float) -> None:
    rng = np.random.default_rng(seed)
    grid = rng.integers(0, 3, (17, 23)).astype(np.uint8)
    grid[grid == OCCUPIED] = FREE
    grid[rng.random(grid.shape) < density] = OCCUPIED
    grown = enlarge(grid, radius)
    covered = binary_dilation(grid == OCCUPIED, disc(radius)) & (grid == FREE)
    assert np.array_equal(grown, np.where(covered, OCCUPIED, grid))
