"""Continuous motion, turning scanners and round robots in the world."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.body import Body
from protocol.cell_bytes import points_to_bytes
from protocol.grid import FREE, OCCUPIED, enlarge
from protocol.messages import Move
from protocol.scans import NONE
from worldsim.motion import FINE, cell_of, glide
from worldsim.world import World, WorldSettings, beams_outside, reachable_by

POINT = Body(range_cells=5.0, field_of_view=360.0, speed=4.0)


def hall(height: int = 20, width: int = 30) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    grid = np.full((height, width), OCCUPIED, np.uint8)
    grid[1:-1, 1:-1] = FREE
    return grid


def no_robots(
    grid: np.ndarray[tuple[int, int], np.dtype[np.uint8]],
) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    return np.zeros(grid.shape, np.bool_)


def along(*points: tuple[int, int], step: int = 1, look: bool = True) -> Move:
    return Move(step, b"", 0, False, look, points=points_to_bytes(np.array(points, np.int32)))


def test_robot_moves_to_any_position_and_reports_all_entered_cells() -> None:
    grid = hall()
    drive = glide(grid, no_robots(grid), (5000, 5000), [(6300, 5000), (6300, 6200)], 10.0)
    assert drive.point == (6300, 6200)
    assert drive.cells == [(6, 5), (6, 6)]
    assert drive.length == pytest.approx(2.5)
    assert drive.blocked == ""


def test_top_speed_limits_a_glide() -> None:
    grid = hall()
    drive = glide(grid, no_robots(grid), (5000, 5000), [(25000, 5000)], 4.0)
    assert drive.length == pytest.approx(4.0, abs=0.1)
    assert drive.blocked == ""


@pytest.mark.parametrize("way", [0.01, 0.05, 0.15, 0.95])
@pytest.mark.parametrize("end", [(25000, 5000), (25000, 25000), (25000, 9000)])
def test_slow_robots_lose_little_of_their_distance(way: float, end: tuple[int, int]) -> None:
    drive = glide(hall(40, 40), no_robots(hall(40, 40)), (5000, 5000), [end], way)
    assert 0.8 * way <= drive.length <= way


def test_a_wall_and_a_teammate_stop_a_glide_before_their_cell() -> None:
    grid = hall()
    wall = glide(grid, no_robots(grid), (2000, 5000), [(-3000, 5000)], 10.0)
    assert wall.blocked == "wall"
    assert cell_of(wall.point) == (1, 5)
    taken = no_robots(grid)
    taken[5, 8] = True
    robot = glide(grid, taken, (5000, 5000), [(12000, 5000)], 10.0)
    assert robot.blocked == "robot"
    assert cell_of(robot.point) == (7, 5)


def test_no_corner_is_cut() -> None:
    grid = hall()
    grid[5, 6] = OCCUPIED
    drive = glide(grid, no_robots(grid), (5000, 5000), [(6000, 6000)], 10.0)
    assert drive.blocked == "wall"


@given(st.integers(0, 2**32 - 1))
def test_robots_stay_on_free_cells_and_apart_for_any_waypoints(seed: int) -> None:
    random = np.random.default_rng(seed)
    grid = hall(12, 12)
    grid[random.random(grid.shape) < 0.2] = OCCUPIED
    free = np.argwhere(grid == FREE)
    chosen = free[random.permutation(len(free))[:3]]
    starts = tuple((int(x), int(y)) for y, x in chosen)
    world = World(grid, WorldSettings((POINT,) * len(starts), starts))
    for step in range(1, 6):
        moves = {
            robot: along(*[(int(x), int(y)) for x, y in random.integers(-2000, 14000, (4, 2))], step=step)
            for robot in world.cells
        }
        senses = world.advance(moves)
        assert len(set(world.cells.values())) == len(starts)
        for robot, (x, y) in world.cells.items():
            assert grid[y, x] == FREE
            offset_x, offset_y = world.offsets[robot]
            assert -FINE // 2 <= offset_x < FINE // 2
            assert -FINE // 2 <= offset_y < FINE // 2
            assert (senses[robot].offset_x, senses[robot].offset_y) == (offset_x, offset_y)
            assert all(
                grid[cy, cx] == FREE for cx, cy in np.frombuffer(senses[robot].driven, "<i2").reshape(-1, 2)
            )


def test_glide_never_exceeds_its_distance() -> None:
    grid = hall()
    world = World(grid, WorldSettings((POINT,), ((5, 5),)))
    world.advance({})
    for step in range(1, 5):
        world.advance({0: along((20000, 15000), (1000, 1000), step=step)})
    assert world.driven[0] <= 4 * POINT.speed + 1e-9


def test_turning_scanner_covers_one_sector_per_step_and_all_in_a_full_turn() -> None:
    body = Body(range_cells=5.0, field_of_view=360.0, speed=1.0, scanner_turn=72.0)
    world = World(hall(), WorldSettings((body,), ((10, 10),)))
    seen = np.zeros(360, np.int64)
    for step in range(5):
        readings = np.frombuffer(world.advance({})[0].readings, np.uint16)
        assert (readings != NONE).sum() == 72
        assert np.flatnonzero(readings != NONE)[0] == 72 * step
        seen += readings != NONE
    assert (seen == 1).all()


def test_scanner_whose_step_does_not_divide_a_turn_leaves_no_gap() -> None:
    seen = np.zeros(360, np.bool_)
    for step in range(math.ceil(360 / 100)):
        seen |= ~beams_outside(360, 100.0 * step % 360, 100.0)
    assert seen.all()


def test_resting_scanner_reads_nothing_and_does_not_turn() -> None:
    body = Body(range_cells=5.0, field_of_view=360.0, speed=1.0, scanner_turn=72.0)
    world = World(hall(), WorldSettings((body,), ((10, 10),)))
    world.advance({})
    resting = np.frombuffer(world.advance({0: along(look=False)})[0].readings, np.uint16)
    assert (resting == NONE).all()
    assert world.seen[10, 10] == FREE
    after = np.frombuffer(world.advance({})[0].readings, np.uint16)
    assert np.flatnonzero(after != NONE)[0] == 72


def test_round_robot_stops_before_it_touches_a_wall_or_a_robot() -> None:
    grid = hall()
    disc = Body(range_cells=5.0, field_of_view=360.0, speed=30.0, radius_cells=2.0)
    world = World(grid, WorldSettings((disc, disc), ((15, 5), (15, 12))))
    senses = world.advance({0: along((0, 5000)), 1: along((15000, 5000))})
    assert senses[0].blocked == "wall"
    assert world.cells[0][0] == 3
    assert world.cells[1] == (15, 5)
    senses = world.advance({1: along((3000, 5000))})
    assert senses[1].blocked == "robot"
    assert world.cells[1][0] - world.cells[0][0] >= 4


def test_reachable_cells_of_a_round_robot_are_those_it_covers() -> None:
    grid = hall(11, 21)
    grid[:, 10] = OCCUPIED
    grid[5, 10] = FREE
    assert reachable_by(grid, (5, 5), 0.0)[5, 15]
    covered = reachable_by(grid, (5, 5), 1.5)
    assert covered[5, 5]
    assert not covered[5, 15]
    assert (enlarge(grid, 1.5) != FREE)[5, 10]
