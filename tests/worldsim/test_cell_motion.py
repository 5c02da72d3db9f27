"""Cell motion: along free cells, at the robot's speed, around corners, and never into a teammate."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from worldsim.motion import DIAGONAL, INTERFERENCE, NOT_BLOCKED, ROBOT, WALL, drive, heading_of, swept

NEIGHBORS = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1) if dx or dy]
Cell = tuple[int, int]


def floor(*rows: str) -> Grid:
    return np.array([[{".": FREE, "#": OCCUPIED, "?": UNKNOWN}[c] for c in row] for row in rows], np.uint8)


def no_robots(truth: Grid) -> NDArray[np.bool_]:
    return np.zeros(truth.shape, np.bool_)


@st.composite
def moves(draw: st.DrawFn) -> tuple[Grid, NDArray[np.bool_], Cell, list[Cell], float]:
    """Draw a random world with teammates, a robot, a mostly valid path, and a distance."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    height, width = rng.integers(1, 9, 2)
    truth = rng.choice(np.array([UNKNOWN, FREE, OCCUPIED], np.uint8), (height, width), p=[0.05, 0.85, 0.1])
    start = int(rng.integers(width)), int(rng.integers(height))
    truth[start[1], start[0]] = FREE
    taken = (rng.random((height, width)) < 0.05) & (truth == FREE)
    taken[start[1], start[0]] = False
    path, (x, y) = [], start
    for _ in range(rng.integers(0, 12)):
        dx, dy = NEIGHBORS[rng.integers(8)] if rng.random() < 0.98 else rng.integers(-2, 3, 2).tolist()
        x, y = x + dx, y + dy
        path.append((x, y))
    return truth, taken, start, path, draw(st.floats(0, 12))


def length_of(cells: list[Cell]) -> float:
    return sum(math.sqrt(2) if x0 != x1 and y0 != y1 else 1.0 for (x0, y0), (x1, y1) in pairwise(cells))


@given(moves())
def test_robot_enters_only_free_cells_without_robots(
    move: tuple[Grid, NDArray[np.bool_], Cell, list[Cell], float],
) -> None:
    truth, taken, start, path, way = move
    done = drive(truth, taken, start, path, way)
    assert done.cells == path[: len(done.cells)]
    for x, y in done.cells:
        assert truth[y, x] == FREE
        assert not taken[y, x]


@given(moves())
def test_robot_cuts_no_corners_and_skips_no_cells(
    move: tuple[Grid, NDArray[np.bool_], Cell, list[Cell], float],
) -> None:
    truth, taken, start, path, way = move
    for (x0, y0), (x1, y1) in pairwise([start, *drive(truth, taken, start, path, way).cells]):
        assert max(abs(x1 - x0), abs(y1 - y0)) == 1
        assert truth[y0, x1] == FREE
        assert truth[y1, x0] == FREE


@given(moves())
def test_robot_drives_its_distance_or_reports_why_it_stopped(
    move: tuple[Grid, NDArray[np.bool_], Cell, list[Cell], float],
) -> None:
    truth, taken, start, path, way = move
    done = drive(truth, taken, start, path, way)
    assert done.length == pytest.approx(length_of([start, *done.cells]))
    assert done.length <= way + 1e-6
    assert 0 <= done.carry <= way + 1e-6
    left = path[len(done.cells) :]
    if not left:
        assert (done.blocked, done.carry) == (NOT_BLOCKED, 0)
        return
    x, y = ([start, *done.cells])[-1]
    nx, ny = left[0]
    height, width = truth.shape
    if done.blocked == ROBOT:
        assert taken[ny, nx]
    elif done.blocked == WALL:
        neighbor = max(abs(nx - x), abs(ny - y)) == 1
        inside = 0 <= nx < width and 0 <= ny < height
        assert not (neighbor and inside) or truth[ny, nx] != FREE or not truth[y, nx] == truth[ny, x] == FREE
    else:
        assert done.length + length_of([(x, y), (nx, ny)]) > way
        assert done.carry == pytest.approx(way - done.length)
    if done.blocked:
        assert done.carry == 0


def test_step_to_a_4_neighbor_has_length_1_and_a_diagonal_step_sqrt_2() -> None:
    truth = floor("...", "...", "...")
    assert drive(truth, no_robots(truth), (0, 0), [(1, 0)], 1.0).length == 1.0
    assert drive(truth, no_robots(truth), (0, 0), [(1, 1)], 1.0).cells == []
    assert drive(truth, no_robots(truth), (0, 0), [(1, 1)], 1.5).length == pytest.approx(math.sqrt(2))
    assert pytest.approx(math.sqrt(2)) == DIAGONAL


def test_unused_distance_is_carried_over() -> None:
    truth = floor(".....")
    at, carry, where = (0, 0), 0.0, []
    for _ in range(8):
        done = drive(truth, no_robots(truth), at, [(x, 0) for x in range(at[0] + 1, 5)], 0.4 + carry)
        carry = done.carry
        at = done.cells[-1] if done.cells else at
        where.append(at[0])
    assert where == [0, 0, 1, 1, 2, 2, 2, 3]


def test_speed_within_rounding_of_a_whole_number_counts_as_whole() -> None:
    truth = floor("....")
    speed = 0.3 / 0.1
    assert speed < 3
    done = drive(truth, no_robots(truth), (0, 0), [(1, 0), (2, 0), (3, 0)], speed)
    assert done.cells[-1] == (3, 0)
    assert done.carry == 0


def test_rounding_over_many_steps_changes_no_distance() -> None:
    truth = floor(201 * ".")
    at, carry = 0, 0.0
    for _ in range(1000):
        done = drive(truth, no_robots(truth), (at, 0), [(at + 1, 0), (at + 2, 0)], 0.2 + carry)
        carry = done.carry
        at += len(done.cells)
    assert at == 200


@pytest.mark.parametrize("corner", ["#", "?"])
def test_a_diagonal_step_needs_both_cells_beside_it(corner: str) -> None:
    for truth in (floor("." + corner, ".."), floor("..", corner + ".")):
        assert drive(truth, no_robots(truth), (0, 0), [(1, 1)], 9.0).blocked == WALL
        assert drive(truth, no_robots(truth), (1, 1), [(0, 0)], 9.0).blocked == WALL


def test_a_teammate_beside_a_diagonal_step_does_not_stop_it() -> None:
    truth, taken = floor("..", ".."), np.array([[False, True], [False, False]])
    assert drive(truth, taken, (0, 0), [(1, 1)], 9.0).cells == [(1, 1)]


def test_a_robot_stops_before_a_wall_and_before_a_teammate() -> None:
    truth = floor("...#")
    assert drive(truth, no_robots(truth), (0, 0), [(1, 0), (2, 0), (3, 0)], 9.0).cells == [(1, 0), (2, 0)]
    taken = np.array([[False, False, True, False]])
    done = drive(truth, taken, (0, 0), [(1, 0), (2, 0), (3, 0)], 9.0)
    assert (done.cells, done.blocked, done.carry) == ([(1, 0)], ROBOT, 0.0)


@pytest.mark.parametrize("step", [(0, 0), (2, 0), (0, 2), (-1, 0), (0, -1), (5, 5), (1000000, 0)])
def test_step_to_a_cell_that_is_no_neighbor_ends_the_path_like_a_wall(step: Cell) -> None:
    truth = floor("...", "...", "...")
    done = drive(truth, no_robots(truth), (0, 0), [step], 9.0)
    assert (done.cells, done.blocked) == ([], WALL)


def test_swept_cells_include_both_cells_beside_a_diagonal() -> None:
    assert swept((0, 0), [(1, 0), (2, 1)]) == [(1, 0), (2, 0), (1, 1), (2, 1)]
    assert swept((0, 0), []) == []


@given(moves())
def test_swept_cells_are_free(
    move: tuple[Grid, NDArray[np.bool_], Cell, list[Cell], float],
) -> None:
    truth, taken, start, path, way = move
    assert all(truth[y, x] == FREE for x, y in swept(start, drive(truth, taken, start, path, way).cells))


def test_headings_count_eighths_of_a_turn_from_x_toward_y() -> None:
    turn = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)]
    assert [heading_of(dx, dy) for dx, dy in turn] == list(range(8))


def test_reasons_to_stop_differ() -> None:
    assert len({WALL, ROBOT, INTERFERENCE, NOT_BLOCKED}) == 4
