"""Incremental approximation: kept and added vertices, and validity (section 4.2)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.outline.approximation import Marks, approximation, repair
from agent.outline.contour import contours
from agent.outline.polygons import SIDE_X, SIDE_Y, Polygons
from agent.outline.simplify import refine
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.packets import MAX_OBJECTS, MAX_VERTICES
from tests.agent.explorations import Cell, exploration, grids, growing_maps, real_map
from tests.agent.outline.edit_scripts import canonical

quick = settings(deadline=None)

Vertex = tuple[int, int, int]


def cycles(polygons: Polygons) -> list[list[Vertex]]:
    points = list(zip(polygons.x.tolist(), polygons.y.tolist(), polygons.side.tolist(), strict=True))
    return [points[a:b] for a, b in pairwise(polygons.start.tolist())]


def distance(one: Vertex, other: Vertex) -> int:
    x, y = (4 * (one[0] - other[0]), 4 * (one[1] - other[1]))
    return int((x + SIDE_X[one[2]] - SIDE_X[other[2]]) ** 2 + (y + SIDE_Y[one[2]] - SIDE_Y[other[2]]) ** 2)


def assert_valid(coarse: Polygons, exact: Polygons) -> None:
    """Section 4.2: only vertices of P(t), in its order, at least two an object."""
    assert coarse.objects == exact.objects
    assert (coarse.inside == exact.inside).all()
    for vertices, points in zip(cycles(coarse), cycles(exact), strict=True):
        assert len(vertices) >= 2
        places = [points.index(vertex) for vertex in vertices]
        assert places == sorted(set(places))


def expected_repair(previous: Polygons, exact: Polygons) -> list[list[Vertex]]:
    """The surviving vertices of each object, or the initial ones of a new object."""
    old = {vertex for cycle in cycles(previous) for vertex in cycle}
    expected = []
    for points in cycles(exact):
        kept = [point for point in points if point in old]
        if not kept:
            kept = points[:1]
        if len(kept) == 1:
            kept.append(max(points, key=lambda point: distance(point, kept[0])))
        expected.append(sorted(kept, key=points.index))
    return expected


def assert_repaired(previous: Polygons, exact: Polygons) -> Marks:
    marks = repair(previous, exact)
    coarse = approximation(exact, marks)
    assert_valid(coarse, exact)
    assert cycles(coarse) == expected_repair(previous, exact)
    return marks


@quick
@given(growing_maps(), st.data())
def test_repair_keeps_surviving_vertices_and_adds_only_missing_ones(
    steps: list[tuple[Grid, Cell]], data: st.DataObject
) -> None:
    held = Polygons.empty(steps[0][0].shape)
    for grid, robot in steps:
        exact = contours(grid, robot)
        marks = refine(exact, assert_repaired(held, exact), data.draw(st.sampled_from([0, 1, 3, None])))
        held = approximation(exact, marks)
        assert_valid(held, exact)


@pytest.mark.parametrize(("name", "splits"), [("intel", 1), ("fr079", None)])
def test_repair_follows_a_robot_through_a_real_map(name: str, splits: int | None) -> None:
    world = real_map(name)
    held = Polygons.empty(world.shape)
    for grid, robot in exploration(world, np.random.default_rng(3), 60, 40.0):
        exact = contours(grid, robot)
        marks = refine(exact, assert_repaired(held, exact), splits)
        held = approximation(exact, marks)


def test_an_approximation_that_is_still_valid_does_not_change() -> None:
    grid, robot = np.full((6, 9), FREE, np.uint8), (0, 0)
    exact = contours(grid, robot)
    marks = refine(exact, repair(Polygons.empty(grid.shape), exact), 2)
    assert repair(approximation(exact, marks), exact).tolist() == marks.tolist()


def test_objects_that_split_or_merge_keep_their_vertices() -> None:
    grid = np.full((5, 11), FREE, np.uint8)
    grid[2, 2:9] = UNKNOWN
    whole = contours(grid, (0, 0))
    exact = approximation(whole, refine(whole, repair(Polygons.empty(grid.shape), whole)))
    grid[2, 5] = FREE
    halves = contours(grid, (0, 0))
    apart = approximation(halves, repair(exact, halves))
    assert [len(cycle) for cycle in cycles(apart)] == [8, 3, 3], "each half keeps its end"
    assert {v for cycle in cycles(apart) for v in cycle} == {v for cycle in cycles(exact) for v in cycle}
    grid[2, 5] = UNKNOWN
    joined = approximation(whole, repair(apart, contours(grid, (0, 0))))
    assert canonical(joined) == canonical(exact)


@quick
@given(grids(), st.data())
def test_an_edge_is_occupied_only_where_all_its_points_are(
    case: tuple[Grid, Cell], data: st.DataObject
) -> None:
    exact = contours(*case)
    marks = np.array(
        [
            mark
            for a, b in pairwise(exact.start.tolist())
            for mark in sorted(
                data.draw(st.sets(st.integers(a, b - 1), min_size=2, max_size=min(6, b - a)), label="marks")
            )
        ],
        np.int32,
    )
    coarse = approximation(exact, marks)
    for first, end, a, b in zip(
        coarse.start[:-1].tolist(),
        coarse.start[1:].tolist(),
        exact.start[:-1].tolist(),
        exact.start[1:].tolist(),
        strict=True,
    ):
        for i in range(first, end):
            point = int(marks[i])
            to = int(marks[i + 1 if i + 1 < end else first])
            covered = []
            while point != to:
                covered.append(exact.occupied[point])
                point = point + 1 if point + 1 < b else a
            assert coarse.occupied[i] == all(covered)


def test_objects_beyond_the_limit_of_packets_are_the_smallest_ones() -> None:
    grid = np.full((210, 400), FREE, np.uint8)
    grid[1::3, 1::3] = OCCUPIED
    grid[2, 1::6] = OCCUPIED
    exact = contours(grid, (0, 0))
    assert exact.objects > MAX_OBJECTS
    coarse = approximation(exact, repair(Polygons.empty(grid.shape), exact))
    assert coarse.objects == MAX_OBJECTS
    assert coarse.inside.sum() == 1
    lengths = dict(zip((cycle[0] for cycle in cycles(exact)), np.diff(exact.start).tolist(), strict=True))
    spoken = [lengths[cycle[0]] for cycle in cycles(coarse)]
    assert sorted(spoken) == sorted(lengths.values())[-MAX_OBJECTS:]


def test_an_object_beyond_the_vertex_limit_is_coarsened_and_not_refined_further() -> None:
    grid = np.full((9, 1600), FREE, np.uint8)
    grid[:3, ::2] = grid[-3:, ::2] = OCCUPIED
    robot = (0, 4)
    exact = contours(grid, robot)
    all_points = approximation(exact, np.arange(len(exact.x), dtype=np.int32))
    assert len(all_points.x) > MAX_VERTICES
    marks = repair(all_points, exact)
    assert len(marks) == MAX_VERTICES
    assert_valid(approximation(exact, marks), exact)
    assert refine(exact, marks).tolist() == marks.tolist()
    assert len(refine(exact, repair(Polygons.empty(grid.shape), exact))) == MAX_VERTICES
