"""The environments have the features that their names promise, measured over many seeds."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from worldsim.generators import describe, make, names
from worldsim.generators.alkhawaldah import hilbert_curve
from worldsim.map_error import MapError
from worldsim.maps import Map

ALIKE_FOR_ALL_SEEDS = {
    "em",
    "leader-obstacles",
    "leader-trap",
    "leader-rooms",
    "two-circles",
    "burgard-five-rooms",
    "burgard-two-rooms",
    *(name for name in names() if name.startswith("hilbert")),
}
WITH_SOLID_OBJECTS = {
    "two-circles",
    "unstructured",
    "mixed",
    "potholes",
    "office-obstacles",
    "campus",
    "burgard-unstructured",
    "warehouse",
    "caves",
    "wings",
    "office-campus",
}
SOURCES = ("Meier", "Faigl", "Al-khawaldah", "leader paper", "Burgard", "Roodbergen", "Murmur")
SEEDS = range(12)
ALL_AROUND = np.ones((3, 3), bool)


# Measuring a plan: rooms and corridors are the morphological opening of the free space by a square wider than any
# door; doors are the remainder.


def rooms_and_doors(world: Map, widest_door_m: float = 1.2) -> tuple[list[Any], list[Any]]:
    """Return the slices of all rooms and corridors, and the (short, long) sides of all doors in cells."""
    side = round(widest_door_m / world.resolution) // 2 * 2 + 1
    free = world.cells == FREE
    wide = ndimage.binary_opening(free, np.ones((side, side), bool))
    rooms = ndimage.find_objects(ndimage.label(wide)[0])
    gaps = ndimage.find_objects(ndimage.label(free & ~wide)[0])
    doors = [sorted((gap[0].stop - gap[0].start, gap[1].stop - gap[1].start)) for gap in gaps]
    return [(box, wide) for box in rooms], doors


def is_empty_rectangle(room: Any) -> bool:
    box, wide = room
    return bool(wide[box].all())


def area_m2(world: Map, room: Any) -> float:
    box, _ = room
    return float((box[0].stop - box[0].start) * (box[1].stop - box[1].start) * world.resolution**2)


def objects(cells: Grid) -> list[Any]:
    """Return (slices, area in cells) of all that is not free and does not touch the border."""
    labels, count = ndimage.label(np.pad(cells != FREE, 1, constant_values=True), ALL_AROUND)
    areas = np.bincount(labels.ravel(), minlength=count + 1)
    outside = labels[0, 0]
    boxes = ndimage.find_objects(labels)
    return [(boxes[label - 1], int(areas[label])) for label in range(1, count + 1) if label != outside]


def has_size(world: Map, width_m: float, height_m: float) -> bool:
    return (world.width, world.height) == (
        round(width_m / world.resolution),
        round(height_m / world.resolution),
    )


# All of them


@pytest.mark.parametrize("name", names())
def test_every_environment_is_enclosed_and_connected(name: str) -> None:
    for seed in range(3):
        check_enclosed_and_connected(make(name, seed))


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(names()), st.integers(0, 2**40), st.sampled_from([0.1, 0.15, 0.25, 0.4]))
def test_every_seed_and_resolution_gives_an_enclosed_and_connected_world(
    name: str, seed: int, resolution: float
) -> None:
    world = make(name, seed, resolution=resolution)
    assert world.resolution == resolution
    check_enclosed_and_connected(world)


def check_enclosed_and_connected(world: Map) -> None:
    free = world.cells == FREE
    assert ndimage.label(free)[1] == 1
    assert not (ndimage.binary_dilation(free, ALL_AROUND) & (world.cells == UNKNOWN)).any()
    border = np.ones(free.shape, bool)
    border[1:-1, 1:-1] = False
    assert not (free & border).any()
    assert world.cells.flags.c_contiguous


@pytest.mark.parametrize("name", names())
def test_a_robot_of_half_a_meter_gets_everywhere(name: str) -> None:
    """Less than a thousandth of the places where it fits may be niches that it cannot reach."""
    world = make(name, seed=5, resolution=0.1)
    fits = ndimage.distance_transform_edt(world.cells == FREE) > 2.5
    areas = np.bincount(ndimage.label(fits)[0].ravel())[1:]
    assert areas.max() >= 0.999 * areas.sum()


@pytest.mark.parametrize("name", names())
def test_the_same_seed_draws_the_same_world_and_another_seed_another(name: str) -> None:
    first, again, other = make(name, 1), make(name, 1), make(name, 2)
    assert first.cells.tobytes() == again.cells.tobytes()
    assert (first.cells.tobytes() == other.cells.tobytes()) == (name in ALIKE_FOR_ALL_SEEDS)
    assert first.name == name
    assert first.origin == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("name", names())
def test_every_environment_is_described_in_one_line_with_its_source(name: str) -> None:
    line = describe(name)
    assert "\n" not in line
    assert len(line) <= 110
    assert any(source in line for source in SOURCES)


@pytest.mark.parametrize("name", sorted(set(names()) - WITH_SOLID_OBJECTS))
def test_walls_are_one_or_two_cells_thick(name: str) -> None:
    for seed in range(3):
        walls = make(name, seed).cells == OCCUPIED
        assert not ndimage.binary_erosion(walls, ALL_AROUND).any()


def test_an_unknown_name_lists_the_known_ones() -> None:
    for ask in (make, describe):
        with pytest.raises(
            MapError,
            match=r"unknown map 'offce'; did you mean office[?] There are: unstructured, mixed",
        ):
            ask("offce")


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("office", {"seed": -1}, "seed is -1; give 0 or more"),
        ("office", {"rooms": 3}, "office has no parameter 'rooms'; it has width_m, height_m, resolution"),
        ("hilbert-2", {"width_m": 3}, "hilbert-2 has no parameter 'width_m'; it has side_m, resolution"),
        (
            "hilbert-2",
            {"side_m": 1.0},
            r"side_m is 1\.0 m; with cells of 0\.1 m it must be at least 1\.6 m and at most 204\.8 m, 2048",
        ),
        (
            "leader-trap",
            {"resolution": 0.0},
            r"resolution is 0\.0; it must be above 0 and at most 0\.4 m per cell",
        ),
        ("em", {"resolution": float("nan")}, "resolution is nan"),
        ("office", {"resolution": 0.5}, r"resolution is 0\.5; it must be above 0 and at most 0\.4"),
        (
            "em",
            {"resolution": 0.001},
            r"width_m is 21\.0 m; with cells of 0\.001 m it must be at least 2 m and at most 2\.048 m",
        ),
        (
            "mixed",
            {"height_m": 5.0},
            r"height_m is 5\.0 m; with cells of 0\.1 m it must be at least 18 m and at most 204\.8 m",
        ),
        ("mixed", {"width_m": float("nan")}, "width_m is nan"),
        ("office", {"clutter": 1}, "office has no parameter 'clutter'; it has width_m, height_m, resolution"),
        ("warehouse", {"clutter": 21}, "clutter is 21; it must be 0 to 20 pallets per 100 square meters"),
        ("warehouse", {"clutter": float("nan")}, "clutter is nan; it must be 0 to 20 pallets"),
        ("caves", {"clutter": -1}, "clutter is -1; it must be 0 to 20 rocks per 100 square meters"),
        ("maze", {"clutter": 21}, "clutter is 21; it must be 0 to 20 crates"),
        ("wings", {"clutter": 21}, "clutter is 21; it must be 0 to 20 pieces of furniture"),
        ("office-campus", {"clutter": 21}, "clutter is 21; it must be 0 to 20 trees"),
        ("caves", {"width_m": 14.0}, r"width_m is 14\.0 m; .* at least 15 m"),
        ("maze", {"height_m": 7.0}, r"height_m is 7\.0 m; .* at least 8 m"),
        ("wings", {"height_m": 29.0}, r"height_m is 29\.0 m; .* at least 30 m"),
        ("office-campus", {"width_m": 29.0}, r"width_m is 29\.0 m; .* at least 30 m"),
    ],
)
def test_error_states_the_valid_range_of_a_parameter(
    name: str, parameters: dict[str, Any], message: str
) -> None:
    with pytest.raises(MapError, match=message):
        make(name, **parameters)


def test_parameters_change_the_size() -> None:
    world = make("unstructured", width_m=30.0, height_m=20.0, resolution=0.2)
    assert (world.width, world.height, world.resolution) == (150, 100, 0.2)


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
