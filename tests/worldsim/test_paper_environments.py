"""The environments of the papers have the features that their names promise, measured over many seeds."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy import ndimage

from protocol.grid import FREE, OCCUPIED, UNKNOWN
from tests.worldsim.building_measures import (
    ALL_AROUND,
    SEEDS,
    area_m2,
    has_size,
    is_empty_rectangle,
    objects,
    rooms_and_doors,
)
from worldsim.generators import make
from worldsim.generators.alkhawaldah import hilbert_curve
from worldsim.maps import Map

# The thesis


def test_unstructured_is_a_field_of_many_objects_of_many_shapes() -> None:
    for seed in SEEDS:
        world = make("unstructured", seed)
        assert has_size(world, 25.0, 25.0)
        found = objects(world.cells)
        areas = np.array([area for _, area in found]) * world.resolution**2
        filled = [area / ((box[0].stop - box[0].start) * (box[1].stop - box[1].start)) for box, area in found]
        assert 55 <= len(found) <= 75
        assert areas.max() > 3.0
        assert areas.min() < 0.3
        assert np.quantile(filled, 0.1) < 0.5, "angles leave most of their box free"
        assert np.quantile(filled, 0.9) > 0.75, "discs and boxes do not"
        assert 0.8 < (world.cells == FREE).mean() < 0.9
        rooms, _ = rooms_and_doors(world)
        assert not any(is_empty_rectangle(room) and area_m2(world, room) > 4 for room in rooms)


def test_unstructured_fills_all_parts_of_its_field() -> None:
    for seed in SEEDS:
        cells = make("unstructured", seed).cells[2:-2, 2:-2]
        for half in np.array_split(cells, 2):
            for quarter in np.array_split(half, 2, axis=1):
                assert 0.03 < (quarter == OCCUPIED).mean() < 0.3


def test_mixed_has_a_building_with_rooms_and_objects_around_it() -> None:
    for seed in SEEDS:
        world = make("mixed", seed)
        assert has_size(world, 25.0, 25.0)
        rooms, _ = rooms_and_doors(world)
        assert 4 <= sum(is_empty_rectangle(room) and area_m2(world, room) > 5 for room in rooms) <= 14
        found = [(box, area) for box, area in objects(world.cells) if area > 3]
        small = [box for box, _ in found if max(side.stop - side.start for side in box) < 40]
        assert 30 <= len(small) <= 65
        walls = [side for box, _ in found for side in box if side.stop - side.start > 90]
        assert walls, "nothing as large as a building"


def test_the_building_of_mixed_can_be_entered_from_several_sides() -> None:
    for seed in SEEDS:
        world = make("mixed", seed)
        walls, _ = ndimage.label(world.cells != FREE, ALL_AROUND)
        sizes = np.bincount(walls.ravel())
        sizes[[0, walls[0, 0]]] = 0
        large = np.isin(walls, np.nonzero(sizes > 150)[0])
        rows, columns = np.nonzero(large)
        hull = np.zeros_like(large)
        hull[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] = True
        assert ndimage.label(hull & ~large)[1] >= 1
        assert (world.cells[hull] == FREE).mean() > 0.7


def test_office_has_rooms_along_corridors_and_no_obstacles() -> None:
    for seed in SEEDS:
        world = make("office", seed)
        assert has_size(world, 25.0, 25.0)
        rooms, doors = rooms_and_doors(world)
        offices = [room for room in rooms if is_empty_rectangle(room)]
        assert len(rooms) - len(offices) == 1, "one net of corridors, all else empty rectangles"
        assert 14 <= len(offices) <= 40
        assert len(doors) >= len(offices)
        assert all(4 < area_m2(world, room) < 130 for room in offices)
        assert 0.85 < (world.cells == FREE).mean() < 0.95


DOORS_M = {
    "office": (0.9, 1.2),
    "jh-like": (0.8, 1.0),
    "office-plain": (1.0, 1.4),
    "burgard-office": (0.9, 1.2),
    "burgard-corridor": (0.9, 1.2),
}


@pytest.mark.parametrize("name", DOORS_M)
def test_doors_are_wide_enough_and_no_thicker_than_a_wall(name: str) -> None:
    narrow, wide = DOORS_M[name]
    for seed in SEEDS:
        world = make(name, seed)
        _, doors = rooms_and_doors(world, widest_door_m=wide)
        assert doors
        for depth, width in doors:
            assert depth * world.resolution <= 0.21
            assert narrow - 1e-9 <= width * world.resolution <= wide + 1e-9


# Faigl and Vanek


@pytest.mark.parametrize(
    ("name", "width_m", "height_m"),
    [("em", 21, 24), ("autolab-like", 30, 30), ("jh-like", 21, 24), ("potholes", 40, 40)],
)
def test_faigls_environments_have_the_size_and_the_cells_of_the_paper(
    name: str, width_m: float, height_m: float
) -> None:
    world = make(name)
    assert has_size(world, width_m, height_m)
    assert world.resolution == 0.05


def test_em_is_empty() -> None:
    world = make("em")
    assert (world.cells[2:-2, 2:-2] == FREE).all()


def test_autolab_is_a_hall_with_rooms_a_wing_and_screens() -> None:
    for seed in SEEDS[:2]:
        world = make("autolab-like", seed)
        rooms, doors = rooms_and_doors(world, widest_door_m=1.8)
        assert sum(is_empty_rectangle(room) for room in rooms) == 5
        assert len(rooms) == 6
        assert len(doors) == 5
        assert len(objects(world.cells)) == 1
        assert 0.5 < (world.cells == FREE).mean() < 0.75


def test_jh_has_many_small_rooms_on_both_sides_of_a_corridor_that_runs_round() -> None:
    for seed in SEEDS:
        world = make("jh-like", seed)
        rooms, _ = rooms_and_doors(world, widest_door_m=1.0)
        offices = [room for room in rooms if is_empty_rectangle(room)]
        (corridor,) = (room for room in rooms if not is_empty_rectangle(room))
        box, wide = corridor
        middle = wide[box].shape[0] // 2, wide[box].shape[1] // 2
        assert area_m2(world, corridor) > 100
        assert all(
            wide[box][y, x] for y, x in ((middle[0], 5), (middle[0], -5), (5, middle[1]), (-5, middle[1]))
        )
        assert 20 <= len(offices) <= 45
        assert np.median([area_m2(world, room) for room in offices]) < 20


def test_potholes_has_many_small_irregular_obstacles() -> None:
    for seed in SEEDS:
        world = make("potholes", seed, resolution=0.1)
        found = objects(world.cells)
        assert 45 <= len(found) <= 56
        assert all(max(side.stop - side.start for side in box) <= 37 for box, _ in found)
        assert (world.cells == FREE).mean() > 0.9


# Al-khawaldah and Nüchter


def test_the_office_with_obstacles_is_the_office_without_and_obstacles() -> None:
    for seed in SEEDS:
        plain, full = make("office-plain", seed), make("office-obstacles", seed)
        assert np.array_equal(plain.cells[full.cells == FREE], full.cells[full.cells == FREE])
        added = (plain.cells == FREE) & (full.cells == OCCUPIED)
        assert 25 <= ndimage.label(added, ALL_AROUND)[1] <= 50
        assert not (ndimage.binary_dilation(added, ALL_AROUND, iterations=5) & (plain.cells != FREE)).any()


def test_the_plain_office_has_wide_rooms_on_both_sides_of_one_corridor() -> None:
    for seed in SEEDS:
        world = make("office-plain", seed)
        rooms, _ = rooms_and_doors(world, widest_door_m=1.4)
        assert 5 <= len(rooms) <= 12
        assert all(is_empty_rectangle(room) for room in rooms)
        assert min(area_m2(world, room) for room in rooms) > 12


def test_campus_is_large_with_buildings_and_trees() -> None:
    for seed in SEEDS:
        world = make("campus", seed)
        assert has_size(world, 120.0, 90.0)
        areas = np.array([area for _, area in objects(world.cells)]) * world.resolution**2
        assert 8 <= (areas > 40).sum() <= 30
        assert (areas < 6).sum() >= 40
        assert 0.6 < (world.cells == FREE).mean() < 0.85
        assert areas.max() > 250


def test_campus_roads_surround_closed_blocks_of_which_some_have_a_yard() -> None:
    yards = []
    for seed in SEEDS:
        world = make("campus-roads", seed)
        assert has_size(world, 120.0, 90.0)
        assert 0.35 < (world.cells == FREE).mean() < 0.7
        side = round(4.5 / world.resolution)
        wide = ndimage.binary_opening(world.cells == FREE, np.ones((side, side), bool))
        yards.append(ndimage.label(wide)[1] - 1)
    assert np.mean(yards) > 1


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_the_hilbert_curve_visits_every_square_once_from_neighbor_to_neighbor(order: int) -> None:
    curve = hilbert_curve(order)
    side = 2**order
    assert sorted(curve) == [(x, y) for x in range(side) for y in range(side)]
    assert all(abs(x0 - x1) + abs(y0 - y1) == 1 for (x0, y0), (x1, y1) in pairwise(curve))
    assert (curve[0], curve[-1]) == ((0, side - 1), (side - 1, side - 1))
    for level in range(order):  # a Hilbert curve completes every quarter before it enters the next
        step = 4**level
        parts = [{(x >> level, y >> level) for x, y in curve[i : i + step]} for i in range(0, 4**order, step)]
        assert all(len(part) == 1 for part in parts)


def test_the_hilbert_curve_of_order_two_is_the_one_that_hilbert_drew() -> None:
    assert hilbert_curve(1) == [(0, 1), (0, 0), (1, 0), (1, 1)]
    assert hilbert_curve(2)[:8] == [(0, 3), (1, 3), (1, 2), (0, 2), (0, 1), (0, 0), (1, 0), (1, 1)]


def passages(world: Map, order: int) -> set[tuple[tuple[int, int], tuple[int, int]]]:
    """Return the pairs of neighboring squares of the board between which the way is free."""
    side = 2**order
    pitch = (world.width - 2) // side
    middle = [1 + i * pitch + pitch // 2 for i in range(side)]
    pairs = [((x, y), (x + 1, y)) for y in range(side) for x in range(side - 1)]
    pairs += [((x, y), (x, y + 1)) for y in range(side - 1) for x in range(side)]
    return {
        ((x0, y0), (x1, y1))
        for (x0, y0), (x1, y1) in pairs
        if (
            world.cells[
                middle[y0] : middle[y1] + 1, middle[x0] + 3 : middle[x1] + 4 if x0 != x1 else middle[x0] + 4
            ]
            == FREE
        ).all()
    }


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_the_hilbert_corridor_is_one_path_that_follows_the_curve(order: int) -> None:
    world = make(f"hilbert-{order}")
    path = {(min(pair), max(pair)) for pair in pairwise(hilbert_curve(order))}
    assert passages(world, order) == path
    assert len(path) == 4**order - 1


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_the_hilbert_wall_follows_the_curve_and_leaves_all_else_free(order: int) -> None:
    world = make(f"hilbert-walls-{order}")
    pitch = (world.width - 2) // 2**order
    for (x0, y0), (x1, y1) in pairwise(hilbert_curve(order)):
        y, x = (y0 + y1 + 1) * pitch // 2, (x0 + x1 + 1) * pitch // 2
        assert world.cells[y, x] == OCCUPIED
    wall = int((world.cells[2:-2, 2:-2] == OCCUPIED).sum())
    assert wall == 2 * (4**order - 1) * pitch + 4


# The leader paper


def arrivals(world: Map) -> float:
    """Return how often a robot reaches a goal if it always steps straight toward it."""
    free = world.cells == FREE
    places = np.argwhere(free)[::37]
    goals = places[::40]
    arrived = total = 0
    for goal in goals:
        for start in places[::9]:
            y, x = start
            while True:
                steps = [
                    (int((y + dy - goal[0]) ** 2 + (x + dx - goal[1]) ** 2), y + dy, x + dx)
                    for dy in (-1, 0, 1)
                    for dx in (-1, 0, 1)
                    if free[y + dy, x] and free[y, x + dx] and free[y + dy, x + dx]
                ]
                _, next_y, next_x = min(steps)
                if (next_y, next_x) == (y, x):
                    break
                y, x = next_y, next_x
            arrived += (y, x) == tuple(goal)
            total += 1
    return arrived / total


def test_trap_stops_robots_that_drive_straight_and_rooms_let_them_pass() -> None:
    trap, rooms = arrivals(make("leader-trap")), arrivals(make("leader-rooms"))
    assert trap < 0.35
    assert rooms > 0.65


def test_the_leader_environments_are_ten_meters_square_with_a_convex_border() -> None:
    for name in ("leader-obstacles", "leader-trap", "leader-rooms"):
        world = make(name)
        assert has_size(world, 10.0, 10.0)
        assert (world.cells != UNKNOWN).all()


def test_the_walls_of_the_trap_join_the_border_and_the_screens_stand_free() -> None:
    trap, rooms = make("leader-trap"), make("leader-rooms")
    assert len(objects(trap.cells)) == 0
    assert len(objects(make("leader-obstacles").cells)) == 4
    assert len(objects(rooms.cells)) == 4


# Burgard and others


@pytest.mark.parametrize("kind", ["office", "corridor", "unstructured"])
def test_burgards_environments_have_cells_of_15_centimeters(kind: str) -> None:
    assert make(f"burgard-{kind}").resolution == 0.15


@pytest.mark.parametrize(
    ("kind", "width_m", "height_m", "rooms", "doors"),
    [("five-rooms", 18.0, 14.0, 6, 5), ("two-rooms", 14.0, 8.0, 3, 3)],
)
def test_burgards_small_buildings_have_rooms_along_a_corridor(
    kind: str, width_m: float, height_m: float, rooms: int, doors: int
) -> None:
    world = make(f"burgard-{kind}")
    assert has_size(world, width_m, height_m)
    found = rooms_and_doors(world)
    assert (len(found[0]), len(found[1])) == (rooms, doors)
    assert all(is_empty_rectangle(room) for room in found[0])


def test_many_rooms_of_burgards_office_have_a_second_doorway() -> None:
    extra = []
    for seed in SEEDS:
        rooms, doors = rooms_and_doors(make("burgard-office", seed))
        offices = [room for room in rooms if is_empty_rectangle(room)]
        assert 20 <= len(offices) <= 60
        extra.append((len(doors) - len(offices)) / len(offices))
    assert np.mean(extra) > 0.2


def test_burgards_corridor_is_long_with_rooms_on_both_sides() -> None:
    for seed in SEEDS:
        world = make("burgard-corridor", seed)
        rooms, _ = rooms_and_doors(world)
        assert all(is_empty_rectangle(room) for room in rooms)
        assert 14 <= len(rooms) <= 36
        (lane,) = ((rows, columns) for (rows, columns), _ in rooms if columns.stop - columns.start > 300)
        assert any(rows.stop < lane[0].start for (rows, _), _ in rooms)
        assert any(rows.start > lane[0].stop for (rows, _), _ in rooms)


def test_burgards_unstructured_world_has_an_irregular_outline_and_objects() -> None:
    for seed in SEEDS:
        world = make("burgard-unstructured", seed)
        assert 0.05 < (world.cells == UNKNOWN).mean() < 0.45
        assert 25 <= len(objects(world.cells)) <= 60
