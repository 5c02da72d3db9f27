"""Looking again before the end: robots drive toward frontiers that walls cut off, since a wall may be a person."""

from __future__ import annotations

import numpy as np

from agent.planning.second_look import BEYOND, BUSY, LASTING, PATIENCE, SecondLook
from protocol.arrays import Cells
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.planning.planning_references import settings_for


def rooms(door: int, *, unknown: int = 6) -> Grid:
    """Two rooms with a door between them, in a state of choice; the last columns of the right one are unknown."""
    grid = np.full((15, 40), OCCUPIED, np.uint8)
    grid[1:-1, 1:-1] = FREE
    grid[:, 20] = OCCUPIED
    grid[6:9, 20] = door
    grid[1:-1, 39 - unknown : 39] = UNKNOWN
    return grid


def way_to_look_again(grid: Grid, here: tuple[int, int], radius_cells: float, *earlier: Grid) -> Cells | None:
    second_look = SecondLook(settings_for(grid, radii_cells=[radius_cells] * 2))
    for each in (*earlier, grid):
        second_look.note(each, is_idle=True)
    return second_look.way(grid, here)


def test_a_robot_gives_up_after_its_way_and_some_steps_and_begins_anew_if_something_was_left() -> None:
    grid = rooms(OCCUPIED)
    second_look = SecondLook(settings_for(grid, speed_cells=5.0))
    for _ in range(2):
        steps = 0
        while second_look.way(grid, (4, 4)) is not None:
            second_look.note(grid, is_idle=True)
            steps += 1
        assert steps == PATIENCE + 15 / 5
        for _ in range(BUSY):
            assert second_look.way(grid, (4, 4)) is None
            second_look.note(grid, is_idle=False)


def test_a_robot_drives_up_to_a_wall_that_was_free_before() -> None:
    for radius, x in ((0.0, 19), (1.0, 18)):
        way = way_to_look_again(rooms(OCCUPIED), (4, 4), radius, *[rooms(FREE)] * LASTING)
        assert way is not None
        assert way[-1, 0] == x
        assert abs(int(way[-1, 1]) - 7) <= 1, "before the door"


def test_a_robot_drives_up_to_a_small_wall() -> None:
    """People in the door whom the robot has seen there from the beginning; the door is as wide as a disc needs."""
    grid = rooms(FREE)
    grid[4:6, 20] = grid[9:12, 20] = FREE
    grid[7, 19:22] = OCCUPIED
    assert way_to_look_again(grid, (4, 4), 0.0) is None, "a point gets past them"
    way = way_to_look_again(grid, (4, 4), 2.0)
    assert way is not None
    assert way[-1, 0] < 19
    assert abs(int(way[-1, 1]) - 7) <= 2, "before the door"


def test_a_wall_that_was_free_for_a_moment_is_no_doubtful_wall() -> None:
    grid = rooms(OCCUPIED)
    grid[9:14, 33:39] = FREE
    for steps, row in ((LASTING - 1, 1), (LASTING, 6)):
        way = way_to_look_again(grid, (4, 4), 0.0, *[rooms(FREE)] * steps)
        assert way is not None
        assert way[-1, 1] == row


def test_a_robot_drives_to_the_wall_in_front_of_a_frontier_that_is_cut_off() -> None:
    way = way_to_look_again(rooms(OCCUPIED), (4, 4), 0.0)
    assert way is not None
    assert way[-1, 0] == 19
    assert len(way_to_look_again(rooms(OCCUPIED), tuple(way[-1].tolist()), 0.0)) == 0, "it stays there"


def test_a_disc_comes_as_close_as_it_can() -> None:
    way = way_to_look_again(rooms(OCCUPIED), (6, 6), 2.0)
    assert way is not None
    assert way[-1, 0] == 17


def test_nothing_is_cut_off_if_the_door_is_open_or_all_is_known() -> None:
    assert way_to_look_again(rooms(FREE), (4, 4), 0.0) is None
    assert way_to_look_again(rooms(OCCUPIED, unknown=0), (4, 4), 0.0) is None
    assert way_to_look_again(rooms(FREE), (6, 7), 1.0) is None, (
        "frontiers beside walls belong to what it reaches"
    )


def test_specks_behind_walls_do_not_count() -> None:
    grid = rooms(OCCUPIED, unknown=0)
    grid[3, 30] = UNKNOWN
    assert way_to_look_again(grid, (4, 4), 0.0) is None
    grid[3, 30:33] = UNKNOWN
    assert way_to_look_again(grid, (4, 4), 0.0) is not None


def test_hollow_walls_are_not_worth_a_look() -> None:
    """Furniture: nothing is known of its inside, and no robot would see more of it."""
    grid = rooms(FREE, unknown=0)
    grid[3:9, 5:11] = OCCUPIED
    grid[4:8, 6:10] = UNKNOWN
    assert way_to_look_again(grid, (4, 4), 0.0, *[rooms(FREE, unknown=0)] * LASTING) is None


def test_the_longest_of_several_frontiers_counts() -> None:
    grid = rooms(OCCUPIED)
    grid[1:9, 33:39] = FREE
    grid[1:5, 21 + BEYOND] = UNKNOWN
    way = way_to_look_again(grid, (4, 4), 0.0)
    assert way is not None
    assert way[-1, 1] >= 8, "not the short one at the top, although it is nearer"
