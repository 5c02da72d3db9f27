"""Shortest ways in the plane, compared with a graph of all corners and of points strewn about."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra as all_ways

from agent.planning.cost_field import costs
from agent.planning.frontier import Floor
from agent.planning.visibility import FINE, MARGIN, shortest_way
from agent.strategies.base import Situation
from agent.strategies.registry import strategy
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.planning.planning_references import drawn, settings_for

SIDE = FINE // 2 + MARGIN - 1


def clear(grid: Grid, one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Whether no square around a non-free cell, or around one beyond the rim, is cut: Liang and Barsky's test."""
    middle = (np.argwhere(np.pad(grid, 1) != FREE)[:, ::-1] - 1) * FINE
    enters, leaves = np.zeros(len(middle)), np.ones(len(middle))
    for axis in (0, 1):
        at, to = one[axis], other[axis]
        low, high = middle[:, axis] - SIDE, middle[:, axis] + SIDE
        if at == to:
            leaves = np.where((low < at) & (at < high), leaves, -1.0)
            continue
        first, last = (low - at) / (to - at), (high - at) / (to - at)
        enters = np.maximum(enters, np.minimum(first, last))
        leaves = np.minimum(leaves, np.maximum(first, last))
    return not (enters < leaves).any()


def length(points: NDArray[np.float64]) -> float:
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


@settings(max_examples=4)
@given(st.integers(0, 2**32 - 1))
def test_no_way_over_corners_or_over_any_points_is_shorter_and_obstacles_are_not_touched(seed: int) -> None:
    random = np.random.default_rng(seed)
    grid = random.choice(np.array([FREE, OCCUPIED], np.uint8), (5, 6), p=[0.75, 0.25])
    x, y = int(random.integers(6)), int(random.integers(5))
    grid[y, x] = FREE
    field = costs(Floor(grid), x, y)
    goals = np.argwhere(np.isfinite(field) & (field > 2))[:, ::-1].astype(np.int32)
    if not len(goals):
        return
    goals = goals[random.permutation(len(goals))[:2]]
    most = float(field[goals[:, 1], goals[:, 0]].min())
    start = x * FINE + int(random.integers(-300, 301)), y * FINE + int(random.integers(-300, 301))
    found = shortest_way(grid, start, goals, most)
    assert found is not None
    assert found[-1].tolist() in (goals * FINE).tolist()
    way = np.concatenate([[start], found]).astype(np.float64)
    assert all(clear(grid, one, other) for one, other in pairwise(way))
    strewn = random.uniform(-500, (5500, 4500), (6, 2))
    corners = [
        (cx * FINE + sx * 400, cy * FINE + sy * 400)
        for cy in range(5)
        for cx in range(6)
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    nodes = np.array([start, *(goals * FINE).tolist(), *corners, *strewn.tolist()], np.float64)
    free = [node for node in nodes if clear(grid, node, node)]
    graph = np.zeros((len(free), len(free)))
    for i, one in enumerate(free):
        for j, other in enumerate(free[:i]):
            if clear(grid, one, other):
                graph[i, j] = math.dist(one, other)
    best = all_ways(graph, directed=False, indices=0)[1 : len(goals) + 1].min()
    assert length(way) <= best + 5
    assert length(way) >= best - 5


def test_a_robot_that_stands_too_near_to_a_wall_goes_to_the_middle_of_its_cell_first() -> None:
    grid = drawn("###", "...", "...")
    found = shortest_way(grid, (0, 550), np.array([[2, 2]], np.int32), 3.0)
    assert found is not None
    assert found.tolist() == [[0, 1000], [2000, 2000]]


def test_an_unreachable_goal_has_no_way() -> None:
    assert shortest_way(drawn(".#.", ".#."), (0, 0), np.array([[2, 0]], np.int32), 9.0) is None


@pytest.mark.parametrize(("way", "bends"), [("visibility", 2), ("cells", 2)])
def test_a_leader_follows_the_visibility_graph_if_configured(way: str, bends: int) -> None:
    grid = np.full((20, 30), FREE, np.uint8)
    grid[0:14, 12] = OCCUPIED
    grid[1, 29] = UNKNOWN
    view = Situation(step=1, grid=grid, x=3, y=2, home=(3, 2))
    task = settings_for(grid, robots=1, ranges_cells=[5.0], resolution=0.1, speed_cells=40.0)
    decision = strategy("leaders")({"way": way}, task).decide(view)
    assert decision.target is not None
    assert len(decision.points) >= bends
    length_of = length(np.concatenate([[(3000, 2000)], decision.points]))
    best = length(np.array([(3000, 2000), (11400, 13600), (12600, 13600), (28000, 1000)]))
    assert (length_of <= best + 2) == (way == "visibility")
