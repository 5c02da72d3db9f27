"""Voronoi diagrams: small maps with known results, and the thesis' Table 3.1 on real maps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.stats import kendalltau

from deploy.study.voronoi import ISLAND_M2, cleaned, contour, distances, free_space, pixels, ridge, smoothed
from protocol.grid import FREE, OCCUPIED
from tests.agent.explorations import real_map

TABLE_3_1 = {
    "killian": (0.749, 0.637), "intel": (1.317, 1.014), "aces": (0.768, 0.672), "edmonton": (1.562, 1.488),
    "fr079": (1.652, 1.404), "fr101": (1.519, 1.254), "acapulco": (3.022, 1.723), "seattle": (1.220, 0.790),
}  # fmt: skip
"""The available maps of ten, with their ratios as they are and smoothed."""


def corridor(width: int, length: int = 40) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    free = np.zeros((width + 2, length), np.bool_)
    free[1:-1, 1:-1] = True
    return free


@pytest.mark.parametrize("width", [1, 2, 5, 8])
def test_the_diagram_of_a_corridor_is_its_center_line(width: int) -> None:
    found = ridge(corridor(width))
    middle = found[:, width + 2 : -width - 2]
    assert (middle.sum(axis=0) == 1).all()
    assert set(np.flatnonzero(middle.any(axis=1))) <= {(width + 1) // 2, width // 2 + 1}


def test_the_diagram_of_a_hall_is_a_cross() -> None:
    hall = np.ones((9, 9), np.bool_)
    found = pixels(hall)
    assert found.contour == 4 * 9
    assert ridge(hall)[4, 4]
    assert ridge(hall)[[0, 0, 8, 8], [0, 8, 0, 8]].all()
    assert found.voronoi == 2 * 9 - 1


@given(st.integers(0, 2**32 - 1))
def test_distances_agree_with_a_nearest_neighbor_search(seed: int) -> None:
    random = np.random.default_rng(seed)
    free = random.random((9, 12)) < 0.8
    solid = np.argwhere(~np.pad(free, 1)) - 1
    wanted, _ = cKDTree(solid).query(np.argwhere(free))
    np.testing.assert_allclose(distances(free)[free], wanted)
    assert not (ridge(free) & ~free).any()
    assert contour(free).sum() == sum(
        any(
            (y + dy, x + dx) in {(int(a), int(b)) for a, b in np.argwhere(free)}
            for dy, dx in ((0, 1), (1, 0), (0, -1), (-1, 0))
        )
        for y, x in solid.tolist()
    )


def test_smoothing_removes_jags_and_specks_with_their_ridges() -> None:
    free = corridor(20, 120)
    free[10, 30] = free[12, 60] = False
    free[1, 5::7] = False
    jagged = smoothed(free)
    assert pixels(jagged).ratio < pixels(free).ratio
    assert pixels(jagged).voronoi < 0.7 * pixels(free).voronoi
    assert jagged[9:12, 29:32].all()


def test_cleaning_removes_small_objects_but_no_walls() -> None:
    free = corridor(20, 60)
    free[10, 30] = False
    free[3:8, 40:45] = False
    clean = cleaned(free, (ISLAND_M2 / 24) ** 0.5)
    assert clean[10, 30]
    assert (clean != free).sum() == 1
    assert (cleaned(free, 0.001) != free).sum() == 26, "the border is no object, however small"


def test_free_space_is_the_largest_area() -> None:
    grid = np.full((5, 9), OCCUPIED, np.uint8)
    grid[1:4, 1:4] = FREE
    grid[2, 6] = FREE
    assert free_space(grid).sum() == 9
    assert not free_space(np.full((3, 3), OCCUPIED, np.uint8)).any()


def test_ratios_of_real_maps_have_the_order_of_the_thesis_and_fall_by_smoothing() -> None:
    found = []
    for name in TABLE_3_1:
        free = free_space(real_map(name))
        found.append((pixels(free).ratio, pixels(smoothed(free)).ratio))
    for column, least in ((0, 0.6), (1, 0.8)):
        order = kendalltau([each[column] for each in found], [row[column] for row in TABLE_3_1.values()])
        assert order.statistic > least
    assert all(after < before for before, after in found)
