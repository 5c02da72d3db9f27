"""The starts of objects by Algorithm 3, against a plain form of the algorithm."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings

from agent.outline.contour import contours
from agent.outline.extraction import extracted
from agent.outline.polygons import Polygons
from protocol.grid import FREE, OCCUPIED, Grid
from tests.agent.explorations import Cell, grids
from tests.agent.outline.edit_scripts import canonical

Point = tuple[int, int, int]


def cycles(polygons: Polygons) -> list[list[Point]]:
    rows = list(zip(polygons.x.tolist(), polygons.y.tolist(), polygons.side.tolist(), strict=True))
    return [rows[first:end] for first, end in pairwise(polygons.start.tolist())]


def extracted_by_the_book(objects: list[list[Point]]) -> list[list[Point]]:
    """Algorithms 2 and 3: take the first point of the array, follow its contour, remove its points."""
    successor = {a: b for cycle in objects for a, b in zip(cycle, cycle[1:] + cycle[:1], strict=True)}
    array = sorted(successor, key=lambda point: (point[1], point[0], point[2]))
    lists = []
    while array:
        start = point = array[0]
        lists.append([])
        while True:
            lists[-1].append(point)
            array[array.index(point)] = array[-1]
            array.pop()
            point = successor[point]
            if point == start:
                break
    return lists


@settings(deadline=None)
@given(grids())
def test_objects_start_where_the_algorithm_starts_them(case: tuple[Grid, Cell]) -> None:
    exact = contours(*case)
    assert sorted(cycles(extracted(exact))) == sorted(extracted_by_the_book(cycles(exact)))


def test_one_cell_moves_the_start_of_an_unchanged_object() -> None:
    grid = np.full((9, 12), FREE, np.uint8)
    grid[3:6, 3:6] = OCCUPIED
    changed = grid.copy()
    changed[8, 11] = OCCUPIED
    before, after = (cycles(extracted(contours(each, (0, 0))))[1] for each in (grid, changed))
    assert sorted(before) == sorted(after)
    assert before[0] != after[0]


@settings(deadline=None)
@given(grids())
def test_the_objects_stay(case: tuple[Grid, Cell]) -> None:
    exact = contours(*case)
    assert canonical(extracted(exact)) == canonical(exact)
    assert extracted(exact).start.tolist() == exact.start.tolist()
