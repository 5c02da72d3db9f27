"""Goal candidates, worked out by hand on small maps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from agent.planning.candidates import (
    LEAST_CELLS,
    Segments,
    count_representatives,
    frontier_segments,
    goal_candidates,
    large_segments,
    mean_goals,
    representatives,
    searched_candidate,
    thin_out,
)
from agent.planning.clusters import cluster_groups, k_means
from agent.planning.frontier import is_frontier
from agent.planning.gain import information_gain
from agent.planning.path_planner import PathPlanner
from agent.planning.utility import in_sight
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.planning.planning_references import drawn, grids


@pytest.mark.parametrize(
    ("cells", "range_cells", "count"),
    [(1, 10.0, 1), (8, 10.0, 1), (9, 10.0, 2), (18, 10.0, 2), (27, 10.0, 3), (60, 60.0, 2), (53, 60.0, 1)],
)
def test_the_number_of_representatives_is_that_of_equation_1(
    cells: int, range_cells: float, count: int
) -> None:
    # 1 + floor(|F| / (1.8 rho) + 0.5): 9 / 18 + 0.5 is just 1.
    assert count_representatives(cells, range_cells) == count


def parts(segments: Segments) -> list[list[list[int]]]:
    """The cells of each edge."""
    cells, sizes = segments
    return [part.tolist() for part in np.split(cells, np.cumsum(sizes)[:-1])]


def test_frontier_segments_are_the_8_connected_parts_and_small_ones_wait() -> None:
    cells = np.array([(0, 0), (1, 0), (2, 1), (9, 1), (0, 5), (1, 5), (2, 5), (3, 6)], np.int32)
    edges = parts(frontier_segments(cells))
    assert edges == [[[0, 0], [1, 0], [2, 1]], [[0, 5], [1, 5], [2, 5], [3, 6]]]
    assert frontier_segments(cells[[0, 1, 3]])[1].tolist() == [2, 1]


@given(grids())
def test_large_segments_are_the_cells_of_segments_of_three_and_more_row_by_row(grid: Grid) -> None:
    cells = np.ascontiguousarray(np.argwhere(grid == FREE)[:, ::-1], np.int32)
    labels, _ = ndimage.label(grid == FREE, np.ones((3, 3)))
    sizes = np.bincount(labels.ravel())
    wanted = [(x, y) for x, y in cells.tolist() if sizes[labels[y, x]] >= LEAST_CELLS]
    assert [tuple(cell) for cell in large_segments(cells).tolist()] == wanted


@given(grids())
def test_frontier_segments_are_numbered_as_their_first_cells_come_row_by_row(grid: Grid) -> None:
    cells = np.argwhere(grid == FREE)[:, ::-1].astype(np.int32)
    if not len(cells):
        return
    labels, count = ndimage.label(grid == FREE, np.ones((3, 3)))
    all_parts = [np.argwhere(labels == 1 + number)[:, ::-1].tolist() for number in range(count)]
    wanted = [part for part in all_parts if len(part) >= LEAST_CELLS] or all_parts
    assert parts(frontier_segments(np.ascontiguousarray(cells))) == wanted


def test_a_short_edge_is_represented_by_its_middle_a_long_one_by_several_cells() -> None:
    row = np.array([(x, 3) for x in range(9)], np.int32)
    assert representatives(row, 20.0).tolist() == [[4, 3]]
    # 1 + floor(9 / 5.4 + 0.5) = 3 clusters of three cells.
    assert representatives(row, 3.0).tolist() == [[1, 3], [7, 3], [4, 3]]


def test_anr_makes_as_many_goals_as_there_are_robots_from_the_largest_edges_first() -> None:
    long = [(x, 0) for x in range(12)]
    short = [(x, 9) for x in range(4)]
    cells = np.array(long + short, np.int32)
    assert len(representatives(cells, 50.0)) == 2
    four = representatives(cells, 50.0, at_least=4)
    assert len(four) == 4
    assert (four[:, 1] == 0).sum() == 3
    assert len(representatives(cells[-4:], 50.0, at_least=9)) == 4


def test_representatives_are_frontier_cells_that_can_be_reached() -> None:
    grid = np.full((30, 30), UNKNOWN, np.uint8)
    grid[5:25, 5:25] = FREE
    goals = goal_candidates("rfe", PathPlanner(grid).frontier(10, 10), 5.0, 1)
    assert len(goals) > 3
    assert all(is_frontier(grid, x, y) for x, y in goals.tolist())


def test_the_mean_of_a_cluster_is_a_goal_where_it_serves() -> None:
    # Two segments of three cells; their means lie between them, at (1, 4/3) and (5, 4/3).
    def goals(*rows: str, reached: tuple[bool, bool] = (True, True), robot: int = 3) -> list[list[int]]:
        cells = np.array([(1, 0), (5, 0), (0, 2), (2, 2), (4, 2), (6, 2)], np.int32)
        clusters = cluster_groups(cells[[0, 2, 3, 1, 4, 5]], np.array([3, 3]), np.array([1, 1]))
        robots = np.array([(robot, 1)], np.int32)
        return mean_goals(drawn(*rows), clusters, np.array(reached), robots, 3.0).tolist()

    medoids = [[0, 2], [4, 2]]
    assert goals(".......", ".......", ".......") == [[1, 1], [5, 1]]
    assert goals(".......", ".......", ".......", reached=(True, False)) == [[1, 1], medoids[1]]
    assert goals(".......", ".......", ".......", robot=5) == [[1, 1], medoids[1]]
    assert goals(".......", ".#.....", ".......") == [medoids[0], [5, 1]]


def test_breadth_first_passes_over_cells_near_a_teammates_target() -> None:
    grid = drawn("?.......??")
    assert searched_candidate("breadth-first", PathPlanner(grid), (2, 0), [], 3.0).tolist() == [[1, 0]]
    assert searched_candidate("breadth-first", PathPlanner(grid), (2, 0), [(1, 0)], 3.0).tolist() == [[7, 0]]
    both = [(1, 0), (7, 0)]
    assert searched_candidate("breadth-first", PathPlanner(grid), (2, 0), both, 3.0).tolist() == [[1, 0]]


def test_k_means_of_two_heaps_are_their_means() -> None:
    points = np.array([(0, 0), (0, 2), (10, 0), (10, 2), (12, 1)], np.float64)
    means, owner = k_means(points, points[[0, 4]])
    assert owner.tolist() == [0, 0, 1, 1, 1]
    np.testing.assert_allclose(means, [(0, 1), (32 / 3, 1)])
    found = cluster_groups(points.astype(np.int32), np.array([5]), np.array([2]))
    assert found.medoids.tolist() == [[0, 0], [10, 0]]
    np.testing.assert_allclose(found.means, means)


def test_information_gain_counts_unknown_cells_out_of_range_of_teammates() -> None:
    random = np.random.default_rng(3)
    grid = random.choice(np.array([UNKNOWN, FREE], np.uint8), (20, 25))
    cells, others, reach = np.array([(3, 4), (24, 19), (12, 10)], np.int32), [(10, 10), (20, 4)], 6.5
    ranges = [6.5, 2.5]
    slow = [
        sum(
            grid[y, x] == UNKNOWN
            and (x - cx) ** 2 + (y - cy) ** 2 <= reach**2
            and all((x - ox) ** 2 + (y - oy) ** 2 > r**2 for (ox, oy), r in zip(others, ranges, strict=True))
            for y in range(20)
            for x in range(25)
        )
        for cx, cy in cells
    ]
    assert information_gain(grid, cells, reach, others, ranges).tolist() == slow


@given(st.integers(0, 2**32 - 1), st.floats(0.5, 20.0))
def test_thinning_removes_exactly_the_cells_near_a_longer_segment(seed: int, gap: float) -> None:
    random = np.random.default_rng(seed)
    grid = random.choice(np.array([FREE, OCCUPIED], np.uint8), (30, 30), p=[0.9, 0.1])
    ys, xs = np.nonzero(grid == FREE)
    pick = random.permutation(len(xs))[:40]
    cells = np.stack([xs[pick], ys[pick]], axis=1).astype(np.int32)
    lengths = random.integers(1, 6, len(cells))
    stay = thin_out(grid, cells, lengths, gap).tolist()

    def near(one: int, other: int) -> bool:
        (x0, y0), (x1, y1) = cells[one].tolist(), cells[other].tolist()
        return (x0 - x1) ** 2 + (y0 - y1) ** 2 < gap**2 and in_sight(grid, x0, y0, x1, y1)

    assert not any(near(one, other) for one in stay for other in stay if one != other)
    for number in set(range(len(cells))) - set(stay):
        assert any(near(number, other) and lengths[other] >= lengths[number] for other in stay)
