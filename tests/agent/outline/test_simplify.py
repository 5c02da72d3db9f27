"""Douglas-Peucker over all objects: each split equals that of a plain search, until the approximation is exact."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.encoding_options import ValueFunction
from agent.outline.approximation import Marks, approximation, repair
from agent.outline.contour import contours
from agent.outline.edge_value import VALUE_FUNCTIONS
from agent.outline.polygons import SIDE_X, SIDE_Y, Polygons
from agent.outline.simplify import refine
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.explorations import Cell, exploration, grids, real_map
from tests.agent.outline.edit_scripts import canonical

quick = settings(deadline=None)


def born(exact: Polygons) -> Marks:
    return repair(Polygons.empty(exact.shape), exact)


def squared_distance(exact: Polygons, p: int, a: int, b: int) -> Fraction:
    """From point p to the segment from a to b, in quarters of a cell."""
    x, y = ((4 * cell + aside[exact.side]).tolist() for cell, aside in ((exact.x, SIDE_X), (exact.y, SIDE_Y)))
    along = (x[p] - x[a]) * (x[b] - x[a]) + (y[p] - y[a]) * (y[b] - y[a])
    t = min(max(Fraction(along, (x[b] - x[a]) ** 2 + (y[b] - y[a]) ** 2), Fraction(0)), Fraction(1))
    off_x, off_y = x[p] - x[a] - t * (x[b] - x[a]), y[p] - y[a] - t * (y[b] - y[a])
    return Fraction(off_x**2 + off_y**2)


def squared_height(points: list[tuple[int, int]], one: tuple[int, int], other: tuple[int, int]) -> Fraction:
    """The largest squared distance of the points from the line through two others."""
    along_x, along_y = other[0] - one[0], other[1] - one[1]
    return max(
        Fraction((along_x * (y - one[1]) - along_y * (x - one[0])) ** 2, along_x**2 + along_y**2)
        for x, y in points
    )


def squared_width(points: list[tuple[int, int]]) -> Fraction:
    """The width of the narrowest strip: one of its rims passes through two points, and all lie on one side of it."""
    widths = [
        squared_height(points, one, other)
        for one, other in combinations(points, 2)
        for crosses in [
            [(other[0] - one[0]) * (y - one[1]) - (other[1] - one[1]) * (x - one[0]) for x, y in points]
        ]
        if one != other and (min(crosses) >= 0 or max(crosses) <= 0)
    ]
    return min(widths)


def plain_value(value_function: ValueFunction, points: list[tuple[int, int]], longest: Fraction) -> Fraction:
    """Return a number that orders edges as the value function does; `points` run from one vertex to the other."""
    match value_function:
        case "height":
            return squared_height(points, points[0], points[-1])
        case "width":
            return squared_width(points)
        case "area":
            ring = zip(points, points[1:] + points[:1], strict=True)
            return Fraction(abs(sum(x * next_y - next_x * y for (x, y), (next_x, next_y) in ring)))
    return longest


def plain_next_split(
    exact: Polygons, marks: list[int], mixed_edges_first: bool, value_function: ValueFunction
) -> int | None:
    """Look at all points of all edges (Algorithm 6, lines 3 to 12)."""
    x, y = ((4 * cell + aside[exact.side]).tolist() for cell, aside in ((exact.x, SIDE_X), (exact.y, SIDE_Y)))
    best = None
    for first, end in pairwise(exact.start.tolist()):
        own = [mark for mark in marks if first <= mark < end]
        for a, b in zip(own, own[1:] + own[:1], strict=True):
            between = list(range(a + 1, b)) if a < b else [*range(a + 1, end), *range(first, b)]
            occupied = exact.occupied[[a, *between]].tolist()
            changes = [p for p, (one, other) in zip(between, pairwise(occupied), strict=True) if one != other]
            distances = [squared_distance(exact, p, a, b) for p in between]
            longest = max(distances, default=Fraction(0))
            if longest == 0 and not changes:
                continue
            split = between[distances.index(longest)] if longest > 0 else changes[0]
            points = [(x[p], y[p]) for p in (a, *between, b)]
            value = (bool(changes) and mixed_edges_first, plain_value(value_function, points, longest))
            if best is None or value > best[0]:
                best = value, split
    return None if best is None else best[1]


@quick
@given(grids(max_side=8), st.booleans(), st.sampled_from(VALUE_FUNCTIONS))
def test_each_split_is_the_one_that_a_plain_search_over_all_points_finds(
    case: tuple[Grid, Cell], mixed_edges_first: bool, value_function: ValueFunction
) -> None:
    exact = contours(*case)
    marks = born(exact)
    plain = marks.tolist()
    for splits in range(1, 12):
        split = plain_next_split(exact, plain, mixed_edges_first, value_function)
        plain = sorted([*plain, split]) if split is not None else plain
        refined = refine(exact, marks, splits, mixed_first=mixed_edges_first, value_function=value_function)
        assert refined.tolist() == plain


@quick
@given(grids(), st.integers(0, 10), st.integers(0, 10), st.booleans())
def test_refining_in_two_calls_equals_refining_in_one(
    case: tuple[Grid, Cell], one: int, other: int, mixed_first: bool
) -> None:
    exact = contours(*case)
    marks = born(exact)
    first = refine(exact, marks, one, mixed_first=mixed_first)
    both = refine(exact, marks, one + other, mixed_first=mixed_first)
    assert refine(exact, first, other, mixed_first=mixed_first).tolist() == both.tolist()
    assert set(marks.tolist()) <= set(both.tolist())
    assert len(both) <= len(marks) + one + other


def assert_exact(exact: Polygons, marks: Marks) -> None:
    for first, end in pairwise(exact.start.tolist()):
        own = [mark for mark in marks.tolist() if first <= mark < end]
        for a, b in zip(own, own[1:] + own[:1], strict=True):
            between = list(range(a + 1, b)) if a < b else [*range(a + 1, end), *range(first, b)]
            assert len(set(exact.occupied[[a, *between]].tolist())) == 1
            assert all(squared_distance(exact, p, a, b) == 0 for p in between)


@quick
@given(grids(), st.booleans(), st.sampled_from(VALUE_FUNCTIONS))
def test_refinement_without_a_limit_is_exact(
    case: tuple[Grid, Cell], mixed_first: bool, value_function: ValueFunction
) -> None:
    exact = contours(*case)
    marks = refine(exact, born(exact), mixed_first=mixed_first, value_function=value_function)
    assert_exact(exact, marks)
    assert refine(exact, marks, 5, mixed_first=mixed_first).tolist() == marks.tolist(), (
        "nothing is left to split"
    )


@pytest.mark.parametrize("mixed_first", [False, True])
def test_refinement_without_a_limit_is_exact_on_real_maps(mixed_first: bool) -> None:
    *_, (grid, robot) = exploration(real_map("fr079"), np.random.default_rng(5), 30, 30.0)
    exact = contours(grid, robot)
    assert_exact(exact, refine(exact, born(exact), mixed_first=mixed_first))


def test_a_straight_edge_is_split_where_its_occupancy_changes() -> None:
    grid = np.full((1, 9), FREE, np.uint8)
    grid = np.vstack([grid, grid, grid])
    grid[0] = [UNKNOWN] * 4 + [OCCUPIED] * 5
    exact = contours(grid, (0, 1))
    coarse = approximation(exact, refine(exact, born(exact)))
    ((_, cycle),) = canonical(coarse)
    wall = [(0, 0, 0, 0), (4, 0, 0, 1), (8, 0, 0, 1), (9, 1, 3, 0)]
    assert [vertex for vertex in cycle if vertex[1] == 0 or vertex in wall] == wall


@pytest.mark.parametrize(("columns", "far_end"), [((2, 4), (10, 1, 1)), ((7, 9), (1, 1, 3))])
def test_distances_are_to_the_segment_not_to_the_line_through_it(
    columns: tuple[int, int], far_end: tuple[int, int, int]
) -> None:
    grid = np.full((3, 12), FREE, np.uint8)
    grid[1, 1:11] = OCCUPIED
    exact = contours(grid, (0, 0))
    places = list(zip(exact.x.tolist(), exact.y.tolist(), exact.side.tolist(), strict=True))
    below = [places.index((x, 1, 0)) for x in columns]
    (split,) = set(refine(exact, np.array(below, np.int32), 1).tolist()) - set(below)
    assert places[split] == far_end, "by the line, any point above the bar is farther"


def test_mixed_first_splits_an_edge_of_mixed_occupancy_before_one_with_a_larger_distance() -> None:
    grid = np.full((12, 12), FREE, np.uint8)
    grid[0, 2:10] = [OCCUPIED, OCCUPIED, OCCUPIED, UNKNOWN, OCCUPIED, OCCUPIED, OCCUPIED, OCCUPIED]
    grid[6:11, 3:9] = OCCUPIED
    exact = contours(grid, (0, 5))
    marks = refine(exact, born(exact), 3, mixed_first=True)
    assert set(marks.tolist()) != set(refine(exact, born(exact), 3).tolist())
    inside_only = marks[marks < exact.start[1]]
    assert len(inside_only) == 5, "only the inside contour is of mixed occupancy"
