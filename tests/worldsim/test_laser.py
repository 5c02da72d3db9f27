"""The laser: readings in random worlds, compared with a reference beam, and the cells drawn from them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, RayTable, ray_table
from protocol.scans import HIT, NONE, Readings, check_readings, draw
from worldsim.laser import cast

Place = tuple[Grid, NDArray[np.bool_], int, int]


@st.composite
def places(draw_: st.DrawFn) -> Place:
    """Draw a random world, teammates on some of its free cells, and the free cell of a robot."""
    rng = np.random.default_rng(draw_(st.integers(0, 2**32 - 1)))
    free = draw_(st.sampled_from((0.9, 0.7, 0.5, 0.98)))
    height, width = rng.integers(1, 25, 2)
    chances = [(1 - free) / 2, free, (1 - free) / 2]
    truth = rng.choice(np.array([UNKNOWN, FREE, OCCUPIED], np.uint8), (height, width), p=chances)
    x, y = int(rng.integers(width)), int(rng.integers(height))
    truth[y, x] = FREE
    teammates = (rng.random((height, width)) < 0.05) & (truth == FREE)
    teammates[y, x] = False
    return truth, teammates, x, y


ray_tables = st.builds(ray_table, st.floats(1, 25), st.sampled_from((4, 36, 360)))


def reference_reading(place: Place, walk: list[list[int]]) -> int:
    truth, teammates, x, y = place
    height, width = truth.shape
    for crossed, (dx, dy) in enumerate(walk):
        cx, cy = x + dx, y + dy
        if not (0 <= cx < width and 0 <= cy < height) or truth[cy, cx] != FREE:
            return crossed | HIT
        if teammates[cy, cx]:
            return crossed + 1
    return len(walk)


def reference_readings(place: Place, laid: RayTable) -> list[int]:
    return [reference_reading(place, laid.cells[a:b].tolist()) for a, b in pairwise(laid.start.tolist())]


def scanned(place: Place, laid: RayTable) -> Grid:
    """Return an empty grid after one scan was drawn into it."""
    truth, teammates, x, y = place
    grid = np.full_like(truth, UNKNOWN)
    draw(grid, laid, x, y, cast(truth, teammates, laid, x, y))
    return grid


@given(places(), ray_tables)
def test_readings_are_those_of_a_beam_followed_cell_by_cell(place: Place, laid: RayTable) -> None:
    truth, teammates, x, y = place
    readings = cast(truth, teammates, laid, x, y)
    assert readings.dtype == np.uint16
    assert readings.tolist() == reference_readings(place, laid)


@given(places(), ray_tables)
def test_readings_are_valid_for_their_beams(place: Place, laid: RayTable) -> None:
    truth, teammates, x, y = place
    check_readings(cast(truth, teammates, laid, x, y), laid)


@given(places(), ray_tables)
def test_drawn_scan_contains_only_true_cells(place: Place, laid: RayTable) -> None:
    truth, _, _, _ = place
    grid = scanned(place, laid)
    assert (truth[grid == FREE] == FREE).all()
    assert (truth[grid == OCCUPIED] != FREE).all()


@given(places(), ray_tables)
def test_teammate_is_not_drawn_as_a_wall_and_hides_the_cells_behind_it(place: Place, laid: RayTable) -> None:
    truth, teammates, x, y = place
    grid = scanned(place, laid)
    assert (grid[teammates] != OCCUPIED).all()
    alone = scanned((truth, np.zeros_like(teammates), x, y), laid)
    assert (grid[grid != UNKNOWN] == alone[grid != UNKNOWN]).all()


@given(places(), ray_tables)
def test_no_beam_passes_between_walls_that_touch_at_a_corner(place: Place, laid: RayTable) -> None:
    truth, _, x, y = place
    areas, _ = ndimage.label(truth == FREE)
    assert (areas[scanned(place, laid) == FREE] == areas[y, x]).all()


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("at", range(1, 29))
def test_nothing_is_seen_through_a_diagonal_wall(at: int, flip: bool) -> None:
    size = 30
    truth = np.full((size, size), FREE, np.uint8)
    wall = np.arange(size)
    truth[wall, wall] = OCCUPIED
    if flip:
        truth = truth[:, ::-1].copy()
    y, x = at, (size - at if flip else at - 1)
    grid = scanned((truth, np.zeros_like(truth, np.bool_), x, y), ray_table(60.0, 720))
    behind = np.triu(np.ones_like(truth, np.bool_), 1)
    assert not (grid[behind[:, ::-1] if flip else behind] != UNKNOWN).any()


@given(places(), st.floats(1, 25))
def test_the_free_neighbors_are_always_seen_free(place: Place, range_cells: float) -> None:
    truth, _, x, y = place
    grid = scanned(place, ray_table(range_cells, 4))
    height, width = truth.shape
    for nx, ny in ((x + 1, y), (x, y + 1), (x - 1, y), (x, y - 1)):
        if 0 <= nx < width and 0 <= ny < height:
            assert grid[ny, nx] == (FREE if truth[ny, nx] == FREE else OCCUPIED)


@given(places(), ray_tables)
def test_nothing_beyond_the_range_is_seen(place: Place, laid: RayTable) -> None:
    _, _, x, y = place
    far = max(int(dx) ** 2 + int(dy) ** 2 for dx, dy in laid.cells)
    ys, xs = np.nonzero(scanned(place, laid))
    assert all((xs - x) ** 2 + (ys - y) ** 2 <= far)


def test_unknown_cell_stops_a_beam_like_a_wall() -> None:
    truth = np.array([[FREE, FREE, UNKNOWN, FREE]], np.uint8)
    readings = cast(truth, np.zeros_like(truth, np.bool_), ray_table(3.0, 4), 0, 0)
    assert readings[0] == 1 | HIT


def test_border_of_the_world_stops_a_beam() -> None:
    truth = np.full((1, 3), FREE, np.uint8)
    readings = cast(truth, np.zeros_like(truth, np.bool_), ray_table(9.0, 4), 1, 0)
    assert readings.tolist() == [1 | HIT, HIT, 1 | HIT, HIT]


def in_view(heading: int, field_of_view: float, beams: int) -> list[int]:
    truth = np.full((3, 3), FREE, np.uint8)
    readings: Readings = cast(
        truth, np.zeros_like(truth, np.bool_), ray_table(2.0, beams), 1, 1, heading, field_of_view
    )
    return np.flatnonzero(readings != NONE).tolist()


def test_laser_with_full_field_of_view_reads_every_beam_at_any_heading() -> None:
    assert all(in_view(heading, 360.0, 36) == list(range(36)) for heading in range(8))


@pytest.mark.parametrize("heading", range(8))
@pytest.mark.parametrize("field_of_view", [1.0, 45.0, 90.0, 180.0, 270.0, 359.0])
def test_beams_outside_the_field_of_view_read_nothing(heading: int, field_of_view: float) -> None:
    wanted = []
    for beam in range(72):
        off = abs(5 * beam - 45 * heading) % 360
        if min(off, 360 - off) <= field_of_view / 2:
            wanted.append(beam)
    assert in_view(heading, field_of_view, 72) == wanted
    assert len(wanted) >= 1


def test_laser_of_180_degrees_covers_the_beams_around_the_heading() -> None:
    assert in_view(2, 180.0, 8) == [0, 1, 2, 3, 4]
    assert in_view(0, 180.0, 8) == [0, 1, 2, 6, 7]
