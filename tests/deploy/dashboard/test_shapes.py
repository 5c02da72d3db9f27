"""Shapes of the dashboard: pictures of maps, axes in meters, numbers, outlines and ways."""

from __future__ import annotations

import io
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from deploy.dashboard.shapes import (
    axes,
    extend,
    flip,
    map_picture,
    number_strips,
    outline_strips,
)
from deploy.record.colors import CELLS, GROUPS, robot_color
from deploy.record.ticks import tick_values
from protocol.cell_bytes import grid_from_bytes, grid_to_bytes
from protocol.grid import MAX_ROBOTS, Grid
from protocol.packets import ALL_KINDS
from worldsim.maps import Map

grids = st.tuples(st.integers(1, 9), st.integers(1, 13)).flatmap(
    lambda shape: arrays(np.uint8, shape, elements=st.integers(0, 2))
)


def world(width: int = 30, height: int = 20) -> Map:
    return Map("w", np.ones((height, width), np.uint8), 0.5, (-3.0, 7.0, 0.0))


@given(grids)
def test_a_map_is_a_picture_whose_pixels_have_the_colors_of_its_cells(grid: Grid) -> None:
    height, width = grid.shape
    cells = grid_to_bytes(grid)
    assert (grid_from_bytes(cells, width, height) == grid).all()
    picture = Image.open(io.BytesIO(map_picture(width, height, cells))).convert("RGB")
    assert (np.array(picture) == np.array(CELLS, np.uint8)[grid]).all()


def test_every_packet_kind_is_in_one_group() -> None:
    assert sorted(kind for group in GROUPS.values() for kind in group.kinds) == sorted(ALL_KINDS)


def test_neighboring_robots_have_different_colors() -> None:
    assert all(robot_color(robot) != robot_color(robot + 1) for robot in range(MAX_ROBOTS))


@given(st.floats(-1e3, 1e3), st.floats(0.5, 1e3), st.integers(2, 8))
def test_ticks_are_few_evenly_spaced_and_within(first: float, length: float, most: int) -> None:
    ticks = tick_values(first, first + length, most)
    assert 1 <= len(ticks) <= most + 1 or length < 1
    assert all(first - 1e-6 <= tick <= first + length + 1e-6 for tick in ticks)
    assert len({round(b - a, 6) for a, b in pairwise(ticks)}) <= 1


def test_axes_count_meters_of_the_maps_own_frame() -> None:
    strips, places, labels = axes(world(), most=4, room=0.2)
    assert strips[0] == [(-3.0, -17.0), (-3.0, -7.0), (12.0, -7.0)]
    across = {label: place for label, place in zip(labels, places, strict=True) if place[1] > -7.0}
    up = {label: place for label, place in zip(labels, places, strict=True) if place[0] < -3.0}
    assert {label: place[0] for label, place in across.items()} == {"0": 0.0, "5": 5.0, "10 m": 10.0}
    assert {label: -place[1] - 0.25 * 0.2 * 15.0 for label, place in up.items()} == {"10": 10.0, "15": 15.0}


def test_an_outline_is_closed_and_lies_on_the_map_where_its_vertices_do() -> None:
    triangle = np.array([[4, 0, 0, 2], [4, 8, 0, 3], [4, 0, 8, 2], [5, 40, 40, 0], [5, 44, 44, 0]], "<i2")
    first, second = outline_strips(world(), triangle.tobytes())
    assert first.tolist() == [[-2.75, -16.75], [-1.75, -16.75], [-2.75, -15.75], [-2.75, -16.75]]
    assert len(second) == 3
    assert outline_strips(world(), b"") == []


@pytest.mark.parametrize(("number", "height"), [(0, 2.2), (8, 2.2), (10, 1.95), (63, 1.95), (200, 1.37)])
def test_a_number_fits_on_the_disc_around_its_place(number: int, height: float) -> None:
    strips = number_strips(number, (5.0, -3.0), 2.0)
    points = np.array([point for strip in strips for point in strip]) - (5.0, -3.0)
    assert np.hypot(*points.T).max() <= 0.8 * 2.0 + 1e-9
    assert points[:, 1].min() == pytest.approx(-height / 2, abs=0.01)
    assert points[:, 1].max() == pytest.approx(height / 2, abs=0.01)


def test_all_digits_look_different() -> None:
    assert len({str(number_strips(digit, (0.0, 0.0), 2.0)) for digit in range(10)} | {"8=3"}) == 11


def test_a_simplified_path_keeps_only_its_corners() -> None:
    way: list[tuple[float, float]] = []
    for place in [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 0.0), (3.0, 1.0), (4.0, 2.0), (3.0, 1.0)]:
        extend(way, place)
    assert way == [(0.0, 0.0), (2.0, 0.0), (4.0, 2.0), (3.0, 1.0)]


def test_flipping_twice_changes_nothing() -> None:
    assert flip(flip((2.0, -3.0))) == (2.0, -3.0)


def test_the_short_side_of_a_narrow_map_has_few_labels() -> None:
    shaft = Map("shaft", np.ones((700, 60), np.uint8), 0.1)
    _, places, labels = axes(shaft, most=6, room=0.2)
    assert sum(place[1] > 0 for place in places) == 1
    assert labels[-1] == "60"
