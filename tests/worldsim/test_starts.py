"""Start cells, and the cells that robots can reach from them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from protocol.body import Body
from protocol.grid import FREE, OCCUPIED
from protocol.range_scans import TURN, Laser
from tests.worldsim.random_walls import random_walls
from worldsim.regions import wide_part
from worldsim.sensor_options import LaserOptions, PoseOptions
from worldsim.sensors import RobotSensors, SensorSettings
from worldsim.starts import start_cells
from worldsim.world import World, WorldSettings, reachable_by

Cell = tuple[int, int]
seeds = st.integers(0, 2**32 - 1)
NEIGHBORS = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1) if dx or dy]


@given(seeds, st.integers(1, 8), st.integers(1, 3))
def test_start_cells_are_free_connected_and_spaced(seed: int, robots: int, spacing: int) -> None:
    truth = random_walls(seed, 0.9)
    cells = start_cells(truth, robots, seed, spacing)
    assert len(cells) == robots
    areas, _ = ndimage.label(truth == FREE)
    assert len({areas[y, x] for x, y in cells}) == 1
    assert all(truth[y, x] == FREE for x, y in cells)
    for n, (x, y) in enumerate(cells):
        assert all(max(abs(x - ox), abs(y - oy)) >= spacing for ox, oy in cells[:n])
    assert cells == start_cells(truth, robots, seed, spacing)


def test_robots_start_in_the_largest_component_at_varying_cells() -> None:
    truth = np.full((9, 9), OCCUPIED, np.uint8)
    truth[0, 0] = FREE
    truth[4:, 4:] = FREE
    firsts = {start_cells(truth, 1, seed, 1)[0] for seed in range(30)}
    assert len(firsts) > 5
    assert all(x >= 4 and y >= 4 for x, y in firsts)


def test_robots_do_not_start_behind_openings_that_they_do_not_explore() -> None:
    """A room of 2 by 8 cells, an opening of one cell, and a larger room."""
    truth = np.full((8, 14), FREE, np.uint8)
    truth[:, 2] = OCCUPIED
    truth[4, 2] = FREE
    assert any(start_cells(truth, 1, seed, 1)[0][0] < 3 for seed in range(40))
    for seed in range(40):
        drawn, chosen = start_cells(truth, 1, seed, 1), start_cells(truth, 1, seed, 1, wide=2)
        assert chosen[0][0] >= 3
        assert chosen == drawn or drawn[0][0] < 3


def test_robots_start_around_the_requested_cell() -> None:
    truth = np.full((9, 9), FREE, np.uint8)
    cells = start_cells(truth, 5, 0, 1, (4, 4))
    assert cells[0] == (4, 4)
    assert sorted(cells[1:]) == [(3, 4), (4, 3), (4, 5), (5, 4)]


@pytest.mark.parametrize("first", [(0, 0), (-1, 3), (3, -1), (9, 3), (3, 9), (10**9, 0)])
def test_start_cell_that_is_not_free_is_rejected(first: Cell) -> None:
    truth = np.full((9, 9), FREE, np.uint8)
    truth[0, 0] = OCCUPIED
    with pytest.raises(ValueError, match=r"cell \(.*\) is not free"):
        start_cells(truth, 1, 0, 1, first)


def test_robots_too_wide_for_every_cell_are_rejected() -> None:
    with pytest.raises(ValueError, match="no cell is free for robots of that radius"):
        start_cells(np.full((9, 9), OCCUPIED, np.uint8), 1, 0, 1)


def test_error_states_how_many_robots_fit() -> None:
    truth = np.full((1, 9), FREE, np.uint8)
    assert len(start_cells(truth, 5, 0, 2, (0, 0))) == 5
    with pytest.raises(ValueError, match="6 robots do not fit: 5 free cells"):
        start_cells(truth, 6, 0, 2, (0, 0))


@given(seeds)
def test_reachable_cells_need_no_cut_corners(seed: int) -> None:
    truth = random_walls(seed, 0.6)
    found = {(10, 10)}
    queue = [(10, 10)]
    while queue:
        x, y = queue.pop()
        for dx, dy in NEIGHBORS:
            nx, ny = x + dx, y + dy
            inside = 0 <= nx < 20 and 0 <= ny < 20 and (nx, ny) not in found
            if inside and truth[ny, nx] == truth[y, nx] == truth[ny, x] == FREE:
                found.add((nx, ny))
                queue.append((nx, ny))
    reachable = reachable_by(truth, (10, 10), 0.0)
    assert {(int(x), int(y)) for y, x in np.argwhere(reachable)} == found


@given(seeds, st.integers(1, 4))
def test_the_wide_part_is_what_a_moving_square_covers(seed: int, width: int) -> None:
    free = random_walls(seed, 0.8) == FREE
    start = 10, 10
    fits = {
        (x, y)
        for y in range(21 - width)
        for x in range(21 - width)
        if free[y : y + width, x : x + width].all()
    }
    corner = start[0] - width // 2, start[1] - width // 2
    places, queue = {corner}, [corner]
    while queue:
        x, y = queue.pop()
        for place in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            if place in fits and place not in places:
                places.add(place)
                queue.append(place)
    covered = np.zeros_like(free)
    for x, y in places:
        covered[y : y + width, x : x + width] = True
    assert (wide_part(free, start, width) == covered).all()


def test_cells_behind_a_narrow_opening_count_only_with_exact_sensors() -> None:
    truth = np.full((21, 41), FREE, np.uint8)
    truth[:, 20] = OCCUPIED
    body, start = Body(10.0, 360.0, 1.0), ((5, 10),)
    laser = Laser(beams=9, first=0, span=TURN // 2, reach_mm=1000)
    sensors = SensorSettings((RobotSensors(LaserOptions(range_error_m=0.01), PoseOptions(), laser),), 0.1)
    for opening, exact, real in ((2, True, False), (3, True, True)):
        truth[10 : 10 + opening, 20] = FREE
        worlds = [World(truth, WorldSettings((body,), start, 4, sensors=each)) for each in (None, sensors)]
        assert [bool(world.reachable[10, 30]) for world in worlds] == [exact, real]
        assert worlds[1].share_seen(0) == 0.0


def test_all_cells_count_where_no_square_fits() -> None:
    corridor = np.zeros((5, 9), np.bool_)
    corridor[2] = True
    assert (wide_part(corridor, (4, 2), 3) == corridor).all()
