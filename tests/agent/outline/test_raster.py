"""Drawing polygons: the enclosed cells are those of a plain even-odd test, and no boundary leaks."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.outline.polygons import SIDE_X, SIDE_Y
from agent.outline.raster import Edges, draw, fill
from protocol.boxes import whole_grid

quick = settings(deadline=None)

Vertex = tuple[int, int, int]
SHAPE = (11, 13)

vertices = st.tuples(st.integers(-1, SHAPE[1]), st.integers(-1, SHAPE[0]), st.integers(0, 3))
polygons = st.lists(vertices, min_size=2, max_size=8, unique=True)


def edges(polygon: list[Vertex], occupied: list[int] | None = None) -> Edges:
    """The edges of a polygon, all of them occupied by default."""
    corners = [(4 * x + int(SIDE_X[side]), 4 * y + int(SIDE_Y[side])) for x, y, side in polygon]
    walls = occupied or [1] * len(polygon)
    both = zip(corners, corners[1:] + corners[:1], walls, strict=True)
    return np.array([(*one, *other, wall) for one, other, wall in both], np.int32)


def filled(polygon: list[Vertex], shape: tuple[int, int] = SHAPE) -> NDArray[np.bool_]:
    layer = np.zeros(shape, np.uint8)
    fill(layer, edges(polygon), 1, 0, whole_grid(shape)[0])
    return layer.astype(np.bool_)


def drawn(polygon: list[Vertex], shape: tuple[int, int] = SHAPE) -> NDArray[np.bool_]:
    layer = np.zeros(shape, np.uint8)
    draw(layer, edges(polygon), 1, 0, 0, whole_grid(shape)[0])
    return layer.astype(np.bool_)


def place(vertex: Vertex) -> tuple[Fraction, Fraction]:
    x, y, side = vertex
    return x + Fraction(int(SIDE_X[side]), 4), y + Fraction(int(SIDE_Y[side]), 4)


def encloses(polygon: list[Vertex], x: int, y: int) -> bool:
    """Even-odd by a ray upwards; an edge counts in the columns from its left end to before its right."""
    within = False
    for one, other in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        (ax, ay), (bx, by) = sorted((place(one), place(other)))
        if ax <= x < bx and ay + (by - ay) * (x - ax) / (bx - ax) <= y:
            within = not within
    return within


@quick
@given(polygons)
def test_a_polygon_encloses_the_cells_whose_centers_pass_the_even_odd_test(polygon: list[Vertex]) -> None:
    expected = [[encloses(polygon, x, y) for x in range(SHAPE[1])] for y in range(SHAPE[0])]
    assert filled(polygon).tolist() == expected


@settings(quick, max_examples=4 * quick.max_examples)
@given(polygons)
def test_of_two_neighbors_of_which_one_is_enclosed_one_is_boundary(polygon: list[Vertex]) -> None:
    inside, boundary = filled(polygon), drawn(polygon)
    for one, other in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        leak = (inside[one] != inside[other]) & ~boundary[one] & ~boundary[other]
        assert not leak.any()


@quick
@given(vertices, vertices)
def test_an_edge_is_drawn_in_the_cell_nearest_to_it_in_each_column_or_row(one: Vertex, other: Vertex) -> None:
    (ax, ay), (bx, by) = place(one), place(other)
    expected = {one[:2]}
    if abs(bx - ax) >= abs(by - ay):
        for x in range(min(one[0], other[0]), max(one[0], other[0]) + 1):
            if x not in (one[0], other[0]):
                expected.add((x, int((ay + (by - ay) * (x - ax) / (bx - ax) + Fraction(1, 2)) // 1)))
    else:
        for y in range(min(one[1], other[1]), max(one[1], other[1]) + 1):
            if y not in (one[1], other[1]):
                expected.add((int((ax + (bx - ax) * (y - ay) / (by - ay) + Fraction(1, 2)) // 1), y))
    layer = np.zeros(SHAPE, np.uint8)
    # Only the first of the two edges is occupied.
    draw(layer, edges([one, other], [1, 0]), 1, 0, 0, whole_grid(SHAPE)[0])
    cells = {(int(x), int(y)) for y, x in np.argwhere(layer)}
    assert cells == {(x, y) for x, y in expected if 0 <= x < SHAPE[1] and 0 <= y < SHAPE[0]}


@pytest.mark.parametrize(
    ("one", "other", "cells"),
    [
        ((2, 3, 0), (6, 3, 0), [(2, 3), (3, 3), (4, 3), (5, 3)]),
        ((6, 3, 2), (2, 3, 2), [(3, 3), (4, 3), (5, 3), (6, 3)]),
        ((2, 2, 0), (5, 5, 3), [(2, 2), (3, 3), (4, 4)]),
        ((5, 5, 1), (2, 2, 2), [(3, 3), (4, 4), (5, 5)]),
        ((2, 5, 1), (2, 5, 2), [(2, 5)]),
    ],
)
def test_an_exact_edge_is_drawn_in_the_cells_of_its_points_but_the_last(
    one: Vertex, other: Vertex, cells: list[tuple[int, int]]
) -> None:
    layer = np.zeros(SHAPE, np.uint8)
    draw(layer, edges([one, other], [1, 0]), 1, 0, 0, whole_grid(SHAPE)[0])
    assert sorted((int(x), int(y)) for y, x in np.argwhere(layer)) == cells


@quick
@given(
    st.lists(st.tuples(*(st.integers(-(2**15), 2**15 - 1),) * 2, st.integers(0, 3)), min_size=2, max_size=4)
)
def test_vertices_far_outside_the_grid_are_clipped(polygon: list[Vertex]) -> None:
    inside = filled(polygon, (3, 5))
    drawn(polygon, (3, 5))
    for y, x in ((0, 0), (2, 4)):
        assert inside[y, x] == encloses(polygon, x, y)


def test_bits_are_set_and_cleared_in_the_right_cells() -> None:
    square = [(1, 1, 3), (1, 5, 0), (5, 5, 1), (5, 1, 2)]
    layer = np.full(SHAPE, 0b101, np.uint8)
    fill(layer, edges(square), 0b010, 0b100, whole_grid(layer.shape)[0])
    assert (layer == np.where(filled(square), 0b011, 0b101)).all()
    draw(layer, edges(square, [1, 0, 1, 0]), 0b1000, 0b10000, 0b1, whole_grid(layer.shape)[0])
    assert layer[3, 1] == 0b1010, "an occupied edge"
    assert layer[5, 3] == 0b10010, "another edge"
    assert layer[3, 3] == 0b011


@quick
@given(polygons, st.tuples(*2 * [st.tuples(st.integers(0, SHAPE[1]), st.integers(0, SHAPE[0]))]))
def test_drawing_is_restricted_to_the_box(
    polygon: list[Vertex], corners: tuple[tuple[int, int], tuple[int, int]]
) -> None:
    (x0, x1), (y0, y1) = (sorted(pair) for pair in zip(*corners, strict=True))
    box = np.array((x0, y0, x1, y1), np.int32)
    area, outline = np.zeros(SHAPE, np.uint8), np.zeros(SHAPE, np.uint8)
    fill(area, edges(polygon), 1, 0, box)
    draw(outline, edges(polygon), 1, 0, 0, box)
    within = np.zeros(SHAPE, np.bool_)
    within[y0:y1, x0:x1] = True
    assert area.tolist() == (filled(polygon) & within).tolist()
    assert outline.tolist() == (drawn(polygon) & within).tolist()
