"""The further kinds of buildings have the features that their names promise, measured over many seeds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.worldsim.building_measures import (
    ALL_AROUND,
    SEEDS,
    area_m2,
    check_enclosed_and_connected,
    has_size,
    is_empty_rectangle,
    objects,
    rooms_and_doors,
)
from worldsim.generators import make
from worldsim.maps import Map

pytestmark = pytest.mark.slow

# The warehouse


def racks_and_pallets(world: Map) -> tuple[list[Any], list[Any]]:
    """Return the slices of racks, and of the smaller pallets."""
    boxes = [box for box, _ in objects(world.cells)]
    longest = {id(box): max(side.stop - side.start for side in box) * world.resolution for box in boxes}
    return [box for box in boxes if longest[id(box)] > 1.5], [box for box in boxes if longest[id(box)] <= 1.5]


def test_racks_are_solid_and_have_aisles_on_both_sides() -> None:
    for seed in SEEDS:
        world = make("warehouse", seed, clutter=0)
        assert has_size(world, 40.0, 30.0)
        racks, pallets = racks_and_pallets(world)
        assert len(racks) >= 10
        assert not pallets
        for rows, columns in racks:
            around = np.pad(world.cells, 1)[rows, columns.start - 23 : columns.stop + 23]
            assert (around[:, 23:-23] == OCCUPIED).all()
            assert (around[:, :23] == FREE).all(), "an aisle on the left"
            assert (around[:, -23:] == FREE).all(), "an aisle on the right"
            assert columns.stop - columns.start == 22
            assert rows.stop - rows.start <= 130


def test_trailers_stand_at_some_of_the_docks() -> None:
    counts = set()
    for seed in SEEDS:
        world = make("warehouse", seed)
        behind = world.cells[-20] == FREE
        starts = np.flatnonzero(behind & ~np.roll(behind, 1))
        widths = np.array([np.argmin(behind[start:]) for start in starts])
        assert (widths == 25).all()
        assert (np.diff(starts) % 45 == 0).all()
        counts.add(len(starts))
    assert min(counts) >= 1
    assert len(counts) > 2


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**40), st.floats(20, 80), st.floats(20, 80), st.floats(0, 20))
def test_a_warehouse_of_any_size_and_clutter_is_connected_and_deterministic(
    seed: int, width_m: float, height_m: float, clutter: float
) -> None:
    options = {"width_m": width_m, "height_m": height_m, "clutter": clutter, "resolution": 0.2}
    world = make("warehouse", seed, **options)
    check_enclosed_and_connected(world)
    assert make("warehouse", seed, **options).cells.tobytes() == world.cells.tobytes()
    assert racks_and_pallets(world)[0], "at least one rack"


def test_clutter_is_pallets_that_stand_free() -> None:
    for seed in SEEDS:
        plain, some, many = (make("warehouse", seed, clutter=clutter) for clutter in (0, 3, 10))
        racks, few = racks_and_pallets(some)
        assert len(racks) == len(racks_and_pallets(plain)[0])
        assert 15 <= len(few) < len(racks_and_pallets(many)[1])
        assert {
            tuple(sorted((rows.stop - rows.start, columns.stop - columns.start))) for rows, columns in few
        } == {(8, 12)}


# Further kinds of buildings, with sides and clutter of choice

LEAST_M = {"caves": 15.0, "maze": 8.0, "wings": 30.0, "office-campus": 30.0}
FREE_SHARE = {"caves": (0.2, 0.75), "maze": (0.75, 0.95), "wings": (0.2, 0.75), "office-campus": (0.7, 0.97)}
"""The smallest and the largest share of free cells."""

sides = st.floats(0, 1)
"""A side, from the shortest valid one to 60 m more."""


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(LEAST_M)), st.integers(0, 2**40), sides, sides, st.floats(0, 20))
def test_kinds_of_any_size_and_clutter_are_connected_reachable_and_deterministic(
    kind: str, seed: int, wide: float, high: float, clutter: float
) -> None:
    least_m = LEAST_M[kind]
    options = {"width_m": least_m + 60 * wide, "height_m": least_m + 60 * high, "clutter": clutter}
    world = make(kind, seed, resolution=0.2, **options)
    assert has_size(world, options["width_m"], options["height_m"])
    check_enclosed_and_connected(world)
    low, most = FREE_SHARE[kind]
    assert low < (world.cells == FREE).mean() < most
    fits = ndimage.distance_transform_edt(world.cells == FREE) > 1.25
    areas = np.bincount(ndimage.label(fits)[0].ravel())[1:]
    assert areas.max() >= 0.99 * areas.sum(), "a robot of half a meter gets nearly everywhere"
    assert make(kind, seed, resolution=0.2, **options).cells.tobytes() == world.cells.tobytes()


@pytest.mark.parametrize("kind", sorted(LEAST_M))
def test_more_clutter_means_more_objects_that_stand_free(kind: str) -> None:
    for seed in range(4):
        counts = []
        for clutter in (0, 2, 6):
            world, plain = make(kind, seed, clutter=clutter), make(kind, seed, clutter=0)
            added = (plain.cells == FREE) & (world.cells == OCCUPIED)
            counts.append(ndimage.label(added, ALL_AROUND)[1])
            near = ndimage.binary_dilation(added, ALL_AROUND, iterations=4)
            assert not (near & (plain.cells != FREE)).any(), "a passage is left beside each object"
        assert 0 == counts[0] < counts[1] < counts[2]


def loops(cells: Grid) -> int:
    """Return the number of independent loops of the free space: its separate obstacles inside."""
    return len(objects(cells))


def test_caves_and_mazes_have_loops() -> None:
    for kind in ("caves", "maze"):
        found = [loops(make(kind, seed, clutter=0).cells) for seed in SEEDS]
        assert min(found) >= 1
        assert len(set(found)) > 2


def test_caves_have_no_straight_walls() -> None:
    """A straight wall would be a long run of cells with the same neighbors above and below."""
    for seed in SEEDS:
        free = make("caves", seed, clutter=0).cells == FREE
        for grid in (free, free.T):
            edge = grid[1:] & ~grid[:-1]
            inner = edge[3:-3]
            lengths = [run[1].stop - run[1].start for run in ndimage.find_objects(ndimage.label(inner)[0])]
            assert max(lengths) < 25


def test_a_maze_has_corridors_of_two_meters_everywhere() -> None:
    for seed in SEEDS:
        world = make("maze", seed)
        free = world.cells == FREE
        depth = ndimage.distance_transform_cdt(free, "chessboard")
        assert 10 <= depth.max() <= 24, "no halls"
        squares = ndimage.binary_erosion(free, np.ones((20, 20), bool))
        assert ndimage.label(ndimage.binary_dilation(squares, np.ones((20, 20), bool)))[1] == 1


def test_the_rooms_of_a_multi_wing_office_are_behind_corridors_with_courts_between_the_wings() -> None:
    linked = []
    for seed in SEEDS:
        world = make("wings", seed, clutter=0)
        rooms, _ = rooms_and_doors(world)
        offices = [room for room in rooms if is_empty_rectangle(room)]
        assert len(rooms) - len(offices) == 1, "one net of corridors, all else empty rectangles"
        assert 15 <= len(offices) <= 80
        labels, count = ndimage.label(world.cells == UNKNOWN)
        outside = set(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]).tolist())
        linked.append(sum(1 for each in range(1, count + 1) if each not in outside))
    assert max(linked) >= 2, "links enclose courts"
    assert min(linked) == 0


def test_every_building_of_the_office_campus_can_be_entered() -> None:
    for seed in SEEDS:
        world = make("office-campus", seed, clutter=0)
        rooms, doors = rooms_and_doors(world)
        offices = [room for room in rooms if is_empty_rectangle(room) and area_m2(world, room) < 200]
        assert 20 <= len(offices) <= 150
        assert len(doors) > len(offices)
        assert not (world.cells == UNKNOWN).any(), "no building is solid"
