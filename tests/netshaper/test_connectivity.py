"""Connectivity: links are symmetric; walls, shadowing and partitions only remove links of the disc."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from netshaper.connectivity import (
    Cell,
    disc,
    line_of_sight,
    log_distance,
    named,
    parted,
    places_of,
    shadowing,
    walls_crossed,
)
from netshaper.radio_options import Partition, PathLossOptions
from protocol.grid import FREE, OCCUPIED, Grid


def in_range(cells: dict[int, Cell], range_cells: float) -> dict[int, list[int]]:
    return named(sorted(cells), disc(places_of(cells), range_cells))


places = st.dictionaries(
    st.integers(0, 20), st.tuples(st.integers(0, 30), st.integers(0, 30)), min_size=1, max_size=12
)


@given(places, st.floats(0, 50) | st.integers(0, 50).map(float))
def test_a_robot_receives_exactly_the_robots_within_the_range(
    cells: dict[int, tuple[int, int]], range_cells: float
) -> None:
    reachable = in_range(cells, range_cells)
    assert list(reachable) == sorted(cells)
    for one, peers in reachable.items():
        assert peers == [
            other
            for other in sorted(cells)
            if other != one and math.dist(cells[one], cells[other]) <= range_cells > 0
        ]


@given(places, st.floats(0, 50))
def test_reception_is_mutual(cells: dict[int, tuple[int, int]], range_cells: float) -> None:
    reachable = in_range(cells, range_cells)
    assert all(one in reachable[other] for one, peers in reachable.items() for other in peers)


def test_a_robot_exactly_at_the_range_is_received() -> None:
    assert in_range({0: (0, 0), 1: (3, 4)}, 5.0) == {0: [1], 1: [0]}
    assert in_range({0: (0, 0), 1: (3, 4)}, math.nextafter(5.0, 0)) == {0: [], 1: []}


@pytest.mark.parametrize("count", [1, 3])
def test_without_a_limit_all_robots_receive_each_other(count: int) -> None:
    cells = {robot: (2000 * robot, 0) for robot in range(count)}
    assert in_range(cells, math.inf) == {r: [o for o in range(count) if o != r] for r in range(count)}


def test_at_range_0_no_robot_receives_another_even_in_its_own_cell() -> None:
    places = np.array([(1, 1), (1, 1), (1, 2)])
    walls = np.full((4, 4), FREE, np.uint8)
    loss = PathLossOptions(exponent=3.0, db_per_wall=9.0)
    assert not line_of_sight(places, 0.0, walls).any()
    assert not log_distance(places, 0.0, walls, 0.1, loss).any()
    assert line_of_sight(places, 0.1, walls).sum() == log_distance(places, 0.1, walls, 0.1, loss).sum() == 5


ROOMS = np.array(
    [
        [OCCUPIED if cell == "#" else FREE for cell in row]
        for row in (
            "############",
            "#....#.....#",
            "#....#.....#",
            "#..........#",
            "#....##....#",
            "############",
        )
    ],
    np.uint8,
)
inside = st.tuples(st.integers(1, 10), st.integers(1, 4))


def plain_walls(grid: Grid, one: Cell, other: Cell) -> int:
    """Count the walls between two cells, border by border in exact fractions."""
    (x, y), (end_x, end_y) = sorted((one, other))
    way = [(x, y)]
    while (x, y) != (end_x, end_y):
        (x0, y0), _ = sorted((one, other))
        along_x, along_y = abs(end_x - x0), abs(end_y - y0)
        next_x = Fraction(2 * abs(x - x0) + 1, 2 * along_x) if along_x else math.inf
        next_y = Fraction(2 * abs(y - y0) + 1, 2 * along_y) if along_y else math.inf
        if next_x <= next_y:
            x += 1 if end_x > x0 else -1
        else:
            y += 1 if end_y > y0 else -1
        way.append((x, y))
    solid = [grid[y, x] == OCCUPIED for x, y in way]
    return sum(now and not before for before, now in pairwise([False, *solid]))


@given(st.lists(inside, min_size=2, max_size=5))
def test_walls_are_counted_as_on_a_walk_with_fractions(cells: list[Cell]) -> None:
    counted = walls_crossed(ROOMS, np.array(cells, np.int64))
    for (a, one), (b, other) in product(enumerate(cells), repeat=2):
        assert counted[a, b] == (plain_walls(ROOMS, one, other) if a != b else 0)


def test_a_wall_ends_a_line_of_sight_and_a_door_opens_it() -> None:
    places = np.array([(3, 1), (8, 1), (3, 3), (8, 3)])
    open_links = line_of_sight(places, 20.0, ROOMS)
    assert not open_links[0, 1]
    assert open_links[2, 3]
    assert (open_links <= disc(places, 20.0)).all()
    assert not line_of_sight(places, 4.9, ROOMS)[2, 3]


@given(st.lists(inside, min_size=1, max_size=5), st.floats(0, 12), st.floats(1, 4), st.floats(0, 3))
def test_without_walls_and_shadowing_the_logarithmic_model_is_the_disc(
    cells: list[Cell], range_cells: float, exponent: float, per_meter: float
) -> None:
    places = np.array(cells, np.int64)
    away = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
    assume((np.abs(away - range_cells) > 0.01).all())  # at the very border thousandths of a dB decide
    links = log_distance(
        places,
        range_cells,
        np.full_like(ROOMS, FREE),
        0.1,
        PathLossOptions(exponent, per_meter, db_per_wall=9.0),
    )
    assert (links == disc(places, range_cells)).all()


@given(st.lists(inside, min_size=2, max_size=5), st.integers(0, 99))
def test_walls_only_remove_links_and_links_are_mutual_and_constant(cells: list[Cell], seed: int) -> None:
    places = np.array(cells, np.int64)
    options = PathLossOptions(shadowing_db=8.0, shadowing_m=2.0)
    extra = shadowing(places, 0.5, seed, options)
    assert (extra == extra.T).all()
    assert (extra == shadowing(places, 0.5, seed, options)).all()
    walls = log_distance(places, 6.0, ROOMS, 0.5, options, extra)
    without = log_distance(places, 6.0, ROOMS, 0.5, replace(options, db_per_wall=0.0), extra)
    assert (walls == walls.T).all()
    assert (walls <= without).all()


def test_a_wall_of_6_db_halves_the_range() -> None:
    wall = np.full((1, 30), FREE, np.uint8)
    wall[0, 3] = OCCUPIED
    for length in range(4, 25):
        places = np.array([(0, 0), (length, 0)])
        options = PathLossOptions(db_per_wall=20 * math.log10(2))
        reachable = log_distance(places, 20.0, wall, 1.0, options)[0, 1]
        assert reachable == (length <= 10)


def test_shadowing_has_the_given_deviation() -> None:
    places = np.array([(x, y) for x in range(0, 60, 4) for y in range(0, 24, 4)])
    drawn = shadowing(places, 1.0, 3, PathLossOptions(shadowing_db=8.0, shadowing_m=2.0))[
        np.triu_indices(len(places), 1)
    ]
    assert abs(drawn.mean()) < 0.5
    assert drawn.std() == pytest.approx(8.0, rel=0.05)


def test_a_partition_keeps_groups_apart_while_it_lasts() -> None:
    partition = Partition(5, 7, ((0, 1), (2,)))
    robots = [0, 1, 2, 4, 5]
    assert parted(robots, [partition], 4).all()
    assert parted(robots, [partition], 8).all()
    links = named(robots, parted(robots, [partition], 5))
    assert links == {0: [1], 1: [0], 2: [], 4: [5], 5: [4]}
