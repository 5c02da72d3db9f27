"""The quality of maps: walls within one cell, agreement of robots, and maps that noise alone cannot explain."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from deploy.record.map_quality import (
    Mask,
    TrueWalls,
    WallScore,
    is_refuted,
    robot_figures,
    team_figures,
    walls_held,
)
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid

SHAPE = (7, 9)
GRIDS = hnp.arrays(np.uint8, SHAPE, elements=st.sampled_from([UNKNOWN, FREE, OCCUPIED]))
MASKS = hnp.arrays(np.bool_, SHAPE)


def room(wall: int = 5) -> Grid:
    """Return a room of 40 x 30 cells inside walls, the left one in column `wall`."""
    truth = np.full((40, 50), UNKNOWN, np.uint8)
    truth[5:35, wall : wall + 32] = OCCUPIED
    truth[6:34, wall + 1 : wall + 31] = FREE
    return truth


def score(grid: Grid, truth: Grid) -> WallScore:
    return TrueWalls(truth != FREE, truth == FREE).score(grid)


# --- walls and the true map ----------------------------------------------------------------------------


def cells_of(mask: Mask) -> list[tuple[int, int]]:
    return [(int(y), int(x)) for y, x in np.argwhere(mask)]


def beside(cell: tuple[int, int], free: set[tuple[int, int]]) -> bool:
    y, x = cell
    return any(each in free for each in ((y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)))


def share_near(cells: list[tuple[int, int]], others: set[tuple[int, int]], distance: int) -> float | None:
    """Return the share of cells that have another one within a distance (Chebyshev); None without cells."""
    near = [any(max(abs(y - v), abs(x - u)) <= distance for v, u in others) for y, x in cells]
    return sum(near) / len(near) if near else None


def plain_score(grid: Grid, truth: Grid, reachable: Mask) -> WallScore:
    """Compare walls cell by cell; everything beyond the border is solid."""
    height, width = truth.shape
    free, found = set(cells_of(truth == FREE)), cells_of(grid == OCCUPIED)
    surface = {cell for cell in cells_of(truth != FREE) if beside(cell, free)}
    beyond = {
        (y, x)
        for y, x in product(range(-1, height + 1), range(-1, width + 1))
        if not (0 <= y < height and 0 <= x < width)
    }
    walls = [cell for cell in cells_of(truth != FREE) if beside(cell, set(cells_of(reachable)))]
    if not walls:
        return WallScore(None, None, None)
    precision, recall = share_near(found, surface | beyond, 1), share_near(walls, set(found), 1)
    assert recall is not None
    if not precision:
        return WallScore(precision, recall, 0.0)
    return WallScore(precision, recall, 2 / (1 / precision + 1 / recall) if recall else 0.0)


@given(grid=GRIDS, truth=GRIDS, chosen=MASKS)
def test_precision_recall_and_f1_are_those_of_the_plain_reference(
    grid: Grid, truth: Grid, chosen: Mask
) -> None:
    reachable = chosen & (truth == FREE)
    expected = plain_score(grid, truth, reachable)
    assert TrueWalls(truth != FREE, reachable).score(grid) == pytest.approx(expected)


def test_walls_within_one_cell_count_as_found() -> None:
    truth = room()
    assert score(truth, truth) == score(room(wall=6), truth) == WallScore(1, 1, 1)
    displaced = score(room(wall=8), truth).f1
    assert displaced is not None
    assert displaced < 0.9


def test_precision_shows_false_walls_and_recall_missing_ones() -> None:
    truth = room()
    half, double = truth.copy(), truth.copy()
    half[:20][half[:20] == OCCUPIED] = UNKNOWN
    double[8:32, 20] = OCCUPIED
    precision, recall, f1 = score(half, truth)
    assert precision == 1
    assert recall == pytest.approx(0.5, abs=0.02)
    assert f1 == pytest.approx(2 / 3, abs=0.02)
    precision, recall, f1 = score(double, truth)
    assert recall == 1
    assert precision == pytest.approx(1 - 24 / (double == OCCUPIED).sum())


def test_a_wall_deep_inside_a_true_wall_is_false() -> None:
    truth = np.full((20, 20), OCCUPIED, np.uint8)
    truth[2:5, 2:18] = FREE
    grid = truth.copy()
    grid[grid == OCCUPIED] = UNKNOWN
    grid[6, 5], grid[15, 5] = OCCUPIED, OCCUPIED
    assert score(grid, truth).precision == 0.5


def test_a_map_without_walls_has_no_precision_and_f1_of_0() -> None:
    truth = room()
    assert score(np.zeros_like(truth), truth) == WallScore(None, 0, 0)


def test_without_true_walls_there_is_no_score() -> None:
    unknown = np.zeros((5, 5), np.uint8)
    assert score(room()[:5, :5], unknown) == WallScore(None, None, None)


# --- walls of different robots -------------------------------------------------------------------------


@given(
    owns=st.lists(GRIDS, min_size=2, max_size=3),
    settled=st.lists(MASKS, min_size=3, max_size=3),
    copies=st.lists(GRIDS, min_size=3, max_size=3),
    tolerance=st.integers(0, 3),
)
def test_the_walls_that_teammates_hold_are_those_of_the_plain_reference(
    owns: list[Grid], settled: list[Mask], copies: list[Grid], tolerance: int
) -> None:
    walls = {author: (own == OCCUPIED) & settled[author] for author, own in enumerate(owns)}
    shared = dict(enumerate(copies))
    held = walls_held(walls, shared, tolerance)
    for holder, grid in shared.items():
        expected = {
            author: share_near(cells_of(mask), set(cells_of(grid == OCCUPIED)), tolerance)
            for author, mask in walls.items()
            if author != holder and mask.any()
        }
        assert held[holder] == pytest.approx(expected)


def test_agreement_has_the_mean_and_the_worst_pair() -> None:
    truth = room()
    half = truth.copy()
    half[:20][half[:20] == OCCUPIED] = UNKNOWN
    planning = {0: truth, 1: room(wall=6), 2: half}
    walls = dict.fromkeys(planning, truth == OCCUPIED)
    shared = {0: half, 1: truth, 2: room(wall=6)}
    figures = robot_figures(planning, shared, walls, TrueWalls(truth != FREE, truth == FREE), 1)
    team = team_figures(figures, 0)
    held = figures[0]["walls_within_tolerance"]
    assert held == pytest.approx(0.5, abs=0.02)
    assert figures[1]["walls_within_tolerance"] == figures[2]["walls_within_tolerance"] == 1
    assert team["worst_walls_within_tolerance"] == held
    assert team["walls_within_tolerance"] == pytest.approx((2 + held) / 3)
    assert team["claimed_wall_f1"] == 1
    assert team["claimed_worst_wall_f1"] == figures[2]["wall_f1"]
    assert team["claimed_mean_wall_recall"] == pytest.approx((2 + 0.5) / 3, abs=0.02)
    exact = robot_figures(planning, shared, walls, TrueWalls(truth != FREE, truth == FREE), 0)
    same = (truth == OCCUPIED) & (room(wall=6) == OCCUPIED)
    assert exact[2]["walls_within_tolerance"] == pytest.approx(same.sum() / (truth == OCCUPIED).sum())


def test_a_single_robot_has_no_agreement() -> None:
    truth = room()
    maps = {0: truth}
    figures = robot_figures(maps, maps, {0: truth == OCCUPIED}, TrueWalls(truth != FREE, truth == FREE), 1)
    assert figures[0]["walls_within_tolerance"] is None
    team = team_figures(figures, 0)
    assert team["walls_within_tolerance"] is team["worst_walls_within_tolerance"] is None
    assert team["claimed_wall_f1"] == team["claimed_mean_wall_f1"] == 1


def test_a_team_without_maps_has_no_figures() -> None:
    assert set(team_figures({}, -1).values()) == {None}


# --- false maps ----------------------------------------------------------------------------------------


def test_noise_does_not_refute_a_map_but_a_false_room_does() -> None:
    truth = room()
    reachable = truth == FREE
    everything = int(reachable.sum())
    noisy, false = room(wall=7), np.full_like(truth, FREE)
    assert not is_refuted(truth, truth, reachable, everything, noisy=False)
    assert is_refuted(noisy, truth, reachable, everything, noisy=False)
    assert not is_refuted(noisy, truth, reachable, everything, noisy=True)
    assert is_refuted(false, truth, reachable, everything, noisy=True)
