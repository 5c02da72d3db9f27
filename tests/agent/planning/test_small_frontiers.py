"""Small frontiers are left unexplored: compared with a plain implementation, and in whole runs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from agent.planning.frontier import frontier_cells
from agent.planning.small_frontiers import without_small_frontiers
from deploy.run.exploration import explore
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import Scenario
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.planning.planning_references import drawn, grids


def by_labels(grid: Grid, least: float) -> Grid:
    """Close the small frontiers of a grid, by the labels of all frontier cells."""
    is_frontier = np.zeros(grid.shape, np.bool_)
    for x, y in frontier_cells(grid, grid == FREE):
        is_frontier[y, x] = True
    labels, _ = ndimage.label(is_frontier, np.ones((3, 3)))
    closed = grid.copy()
    for number, (rows, columns) in enumerate(ndimage.find_objects(labels), start=1):
        if max(rows.stop - rows.start, columns.stop - columns.start) < least:
            beside = ndimage.binary_dilation(labels == number) & (grid == UNKNOWN)
            closed[beside] = OCCUPIED
    return closed


@given(grids(), st.sampled_from((1.0, 1.5, 2.0, 3.0, 5.0, 40.0)))
def test_unknown_cells_beside_small_frontiers_are_walls_as_in_a_plain_implementation(
    grid: Grid, least: float
) -> None:
    before = grid.copy()
    found = without_small_frontiers(grid, least)
    assert found.tolist() == by_labels(grid, least).tolist()
    assert (grid == before).all(), "the planning grid is not changed"


def test_an_unknown_speck_and_a_short_gap_are_closed_and_a_doorway_stays_open() -> None:
    grid = drawn(
        "##########",
        "#...#....#",
        "#.?.#....?",
        "#...#....#",
        "#........#",
        "####???###",
    )
    found = without_small_frontiers(grid, 4)
    assert len(frontier_cells(found, found == FREE)) == 0
    found = without_small_frontiers(grid, 3)
    assert frontier_cells(found, found == FREE).tolist() == [
        [2, 1],
        [1, 2],
        [3, 2],
        [2, 3],
        [4, 4],
        [5, 4],
        [6, 4],
    ]


@pytest.mark.parametrize("sensors", [{}, {"laser": "utm-30lx", "pose": "graph-slam"}], ids=["exact", "noisy"])
def test_a_team_that_leaves_small_frontiers_finishes_earlier_and_misses_less_than_a_thousandth(
    sensors: dict[str, str],
) -> None:
    team = {
        "map": "office", "map_options": {"width_m": 14.0, "height_m": 12.0}, "bandwidth": 50, "bus": "memory",
        **{key: {"preset": name} for key, name in sensors.items()},
    }  # fmt: skip
    whole = explore(keep=False, **team).summary
    found = explore(keep=False, min_frontier_size=0.5, **team).summary
    assert found["steps"] < whole["steps"]
    assert 0.999 < found["coverage"] <= 1.0


def test_a_size_above_all_doors_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"min_frontier_size.* 5"):
        Scenario(min_frontier_size=6.0)
