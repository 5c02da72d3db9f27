"""Contours of random grids and real maps: closed, apart from each other, around exactly the free space."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from agent.outline.contour import Tracer, contours
from agent.outline.polygons import SIDE_X, SIDE_Y, Polygons
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.explorations import (
    REAL_MAPS,
    Cell,
    exploration,
    grids,
    growing_maps,
    real_fragment,
    real_map,
)
from tests.agent.outline.edit_scripts import canonical

MAPS = sorted(path.stem for path in REAL_MAPS.glob("*.png")) or ["intel"]

quick = settings(deadline=None)


def reachable(grid: Grid, robot: Cell) -> NDArray[np.bool_]:
    """Free cells that are 4-connected to the robot."""
    areas, _ = ndimage.label(grid == FREE)
    free: NDArray[np.bool_] = areas == areas[robot[1], robot[0]]
    return free


def contours_by_the_book(grid: Grid, robot: Cell) -> list[list[tuple[int, int, int]]]:
    """The rule of section 4.1, point by point, on a dictionary of cells."""
    free = {(x, y) for y, x in np.argwhere(reachable(grid, robot)).tolist()}
    aside = [(0, 1), (1, 0), (0, -1), (-1, 0)]
    left_or_right_first = [
        (x + dx, y, side) for y, x in sorted((y, x) for x, y in free) for dx, side in ((-1, 1), (1, 3))
    ]
    done = set()
    objects = []
    for begin in left_or_right_first:
        x, y, side = begin
        if begin in done or (x, y) in free:
            continue
        cycle = []
        while (x, y, side) not in done:
            done.add((x, y, side))
            cycle.append((x, y, side))
            left = (side + 1) % 4
            ahead = x + aside[left][0], y + aside[left][1]
            diagonal = ahead[0] + aside[side][0], ahead[1] + aside[side][1]
            if diagonal not in free:
                (x, y), side = diagonal, (side - 1) % 4
            elif ahead not in free:
                x, y = ahead
            else:
                side = left
        assert (x, y, side) == begin
        objects.append(cycle)
    return objects


def cycles(polygons: Polygons) -> list[list[tuple[int, int, int]]]:
    points = list(zip(polygons.x.tolist(), polygons.y.tolist(), polygons.side.tolist(), strict=True))
    return [points[a:b] for a, b in zip(polygons.start[:-1], polygons.start[1:], strict=True)]


def quarters(polygons: Polygons) -> list[NDArray[np.int64]]:
    """Each polygon's vertices as an (n, 2) array, in quarters of a cell."""
    x, y = 4 * polygons.x + SIDE_X[polygons.side], 4 * polygons.y + SIDE_Y[polygons.side]
    return np.split(np.stack([x, y], 1), polygons.start[1:-1])


def encloses(polygon: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Cells whose centres a ray to the left of them shows to lie within the polygon."""
    x, y = np.meshgrid(4 * np.arange(shape[1]), 4 * np.arange(shape[0]))
    within = np.zeros(shape, np.bool_)
    for edge in zip(polygon.tolist(), np.roll(polygon, -1, 0).tolist(), strict=True):
        (ax, ay), (bx, by) = sorted(edge, key=lambda end: end[1])
        within ^= (ay <= y) & (y < by) & ((bx - ax) * (y - ay) < (x - ax) * (by - ay))
    return within


def area(polygon: NDArray[np.int64]) -> int:
    x, y = polygon.T
    return int((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def assert_apart(segments: list[tuple[tuple[int, int], tuple[int, int]]]) -> None:
    """No two segments have a point in common but the vertex that joins neighbours."""

    def turn(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> int:
        return int(np.sign((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])))

    def on(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> bool:
        return turn(a, b, c) == 0 and min(a, b) <= c <= max(a, b)

    for i, (a, b) in enumerate(segments):
        for c, d in segments[:i]:
            if max(a[0], b[0]) < min(c[0], d[0]) or max(c[0], d[0]) < min(a[0], b[0]):
                continue
            ends = {a, b} & {c, d}
            touching = {p for p in (c, d) if on(a, b, p)} | {p for p in (a, b) if on(c, d, p)}
            assert touching <= ends, (a, b, c, d)
            assert ends or turn(a, b, c) * turn(a, b, d) >= 0 or turn(c, d, a) * turn(c, d, b) >= 0


@quick
@given(grids())
def test_contours_follow_the_rule_of_section_4_1_point_by_point(case: tuple[Grid, Cell]) -> None:
    grid, robot = case
    assert cycles(contours(grid, robot)) == contours_by_the_book(grid, robot)


@quick
@given(grids())
def test_every_side_between_a_free_and_another_cell_is_a_point_exactly_once(case: tuple[Grid, Cell]) -> None:
    grid, robot = case
    found = contours(grid, robot)
    free = np.pad(reachable(grid, robot), 2)
    expected = {
        (x - 2, y - 2, side)
        for side in range(4)
        for y, x in np.argwhere(~free & np.roll(free, (-SIDE_Y[side], -SIDE_X[side]), (0, 1))).tolist()
    }
    points = [point for cycle in cycles(found) for point in cycle]
    assert len(points) == len(expected)
    assert set(points) == expected


@quick
@given(grids())
def test_a_point_is_occupied_where_its_cell_is(case: tuple[Grid, Cell]) -> None:
    grid, robot = case
    found = contours(grid, robot)
    rimmed = np.pad(grid, 1, constant_values=UNKNOWN)
    assert ((rimmed[found.y + 1, found.x + 1] == OCCUPIED) == found.occupied).all()


@quick
@given(grids(max_side=9))
def test_no_contour_touches_or_crosses_itself_or_another(case: tuple[Grid, Cell]) -> None:
    segments = []
    for polygon in quarters(contours(*case)):
        points = [(int(x), int(y)) for x, y in polygon]
        assert len(points) >= 4
        segments += list(zip(points, points[1:] + points[:1], strict=True))
    assert_apart(segments)


@quick
@given(grids())
def test_contours_enclose_exactly_the_free_space_of_the_robot(case: tuple[Grid, Cell]) -> None:
    grid, robot = case
    found = contours(grid, robot)
    inside, *outside = (encloses(polygon, grid.shape) for polygon in quarters(found))
    free = inside.copy()
    for filled in outside:
        assert not (filled & ~inside).any()
        assert (free & filled).sum() == filled.sum(), "outside objects do not overlap"
        free &= ~filled
    assert (free == reachable(grid, robot)).all()


@quick
@given(grids())
def test_the_first_object_is_the_only_inside_one(case: tuple[Grid, Cell]) -> None:
    found = contours(*case)
    assert found.inside.tolist() == [True] + [False] * (found.objects - 1)
    for is_inside, polygon in zip(found.inside, quarters(found), strict=True):
        assert (area(polygon) > 0) == is_inside, "the object lies to the left"


@quick
@given(grids())
def test_free_cells_out_of_reach_count_as_unknown(case: tuple[Grid, Cell]) -> None:
    grid, robot = case
    sealed = grid.copy()
    sealed[(grid == FREE) & ~reachable(grid, robot)] = UNKNOWN
    assert canonical(contours(grid, robot)) == canonical(contours(sealed, robot))


def test_a_ring_has_an_inside_and_an_outside_object() -> None:
    grid = np.full((3, 3), FREE, np.uint8)
    grid[1, 1] = OCCUPIED
    found = contours(grid, (0, 0))
    assert cycles(found)[1] == [(1, 1, 3), (1, 1, 0), (1, 1, 1), (1, 1, 2)]
    assert len(cycles(found)[0]) == 12
    assert found.occupied.tolist() == [0] * 12 + [1] * 4


@pytest.mark.parametrize("robot", [(1, 0), (3, 0), (0, -1)])
def test_a_robot_in_a_wall_or_off_the_grid_is_rejected(robot: Cell) -> None:
    grid = np.array([[FREE, OCCUPIED, FREE]], np.uint8)
    with pytest.raises(ValueError, match=r"it must be in a free cell of the 3 x 1 grid"):
        contours(grid, robot)


@pytest.mark.parametrize("name", MAPS)
def test_real_maps_have_one_outside_object_for_each_island(name: str) -> None:
    grid = real_map(name)
    y, x = np.argwhere(grid == FREE)[0].tolist()
    found = contours(grid, (x, y))
    free = np.pad(reachable(grid, (x, y)), 1)
    islands = ndimage.label(~free, np.ones((3, 3)))[1] - 1
    assert found.objects == 1 + islands
    assert len(found.x) == sum(int((free & ~np.roll(free, 1, axis)).sum()) * 2 for axis in (0, 1))


@quick
@given(st.sampled_from(MAPS), st.integers(0, 2**32 - 1))
def test_fragments_of_real_maps_follow_the_rule(name: str, seed: int) -> None:
    grid, robot = real_fragment(name, np.random.default_rng(seed), 30)
    assert cycles(contours(grid, robot)) == contours_by_the_book(grid, robot)


def test_a_growing_map_follows_the_rule_at_every_step() -> None:
    for grid, robot in exploration(real_map("fr079"), np.random.default_rng(7), 40, 30.0):
        assert cycles(contours(grid, robot)) == contours_by_the_book(grid, robot)


def flat(polygons: Polygons) -> list[list[int]]:
    columns = polygons.x, polygons.y, polygons.side, polygons.occupied, polygons.start, polygons.inside
    return [column.tolist() for column in columns]


@quick
@given(growing_maps())
def test_incremental_contours_equal_new_ones(steps: list[tuple[Grid, Cell]]) -> None:
    tracer = Tracer(steps[0][0].shape)
    before = np.full(steps[0][0].shape, UNKNOWN, np.uint8)
    for grid, robot in steps:
        ys, xs = np.nonzero(grid != before)
        boxes = np.array([(x, y, x + 1, y + 1) for x, y in zip(xs, ys, strict=True)], np.int32).reshape(-1, 4)
        assert flat(tracer.contours(grid, robot, boxes)) == flat(contours(grid, robot))
        before = grid


def test_a_tracer_follows_a_real_exploration() -> None:
    world = real_map("intel")
    tracer = Tracer(world.shape)
    before = np.full(world.shape, UNKNOWN, np.uint8)
    for grid, robot in exploration(world, np.random.default_rng(4), 25, 40.0):
        ys, xs = np.nonzero(grid != before)
        box = [(xs.min(), ys.min(), xs.max() + 1, ys.max() + 1)] if len(xs) else []
        traced = tracer.contours(grid, robot, np.array(box, np.int32).reshape(-1, 4))
        assert flat(traced) == flat(contours(grid, robot))
        before = grid
