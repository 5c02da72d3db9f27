"""Routes: around teammates that stand on them, without running from one to the other for good."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from agent.planning.route import MEMORY, Route
from agent.planning.ways import Ways
from protocol.grid import FREE
from tests.agent.planning_references import drawn

HALL = np.full((7, 9), FREE, np.uint8)
START, END = (0, 3), (8, 3)


def first_cell(route: Route) -> tuple[int, int]:
    return int(route.cells[0][0]), int(route.cells[0][1])


@given(st.sets(st.tuples(st.just(1), st.integers(1, 5)), min_size=1), st.integers(1, 1000))
def test_a_robot_finds_its_way_around_any_row_of_teammates(held: set[tuple[int, int]], step: int) -> None:
    route, ways = Route(), Ways(HALL)
    route.lead(ways, START, END)
    tries = 0
    while len(route.cells) and first_cell(route) in held:
        assert tries < len(held)
        route.detour(ways, START, END, 9.0, (0, 0, step + tries))
        tries += 1
    assert tuple(route.cells[-1].tolist()) == END


def test_a_cell_that_was_held_long_ago_is_driven_over_again() -> None:
    route, ways = Route(), Ways(HALL)
    route.cells = np.array([(1, 3)], np.int32)
    route.detour(ways, START, END, 9.0, (0, 0, 0))
    for step, is_forgotten in ((MEMORY - 1, False), (MEMORY, True)):
        route.cells = np.array([(1, 1)], np.int32)
        route.detour(ways, START, END, 9.0, (0, 0, step))
        assert ([1, 3] in route.cells.tolist()) == is_forgotten


def test_in_a_corridor_without_another_way_a_robot_steps_aside_at_random_and_repeatably() -> None:
    corridor = drawn("##############", "..............", "##############")
    places = set()
    for robot in range(20):
        ends = []
        for _ in range(2):
            route, ways = Route(), Ways(corridor)
            route.lead(ways, (5, 1), (13, 1))
            route.detour(ways, (5, 1), (13, 1), 3.0, (0, robot, 7))
            ends.append(int(route.cells[-1][0]) if len(route.cells) else 5)
        assert ends[0] == ends[1]
        places.add(ends[0])
    assert places == {2, 3, 4, 5}


def test_a_robot_shut_in_between_teammates_stays_where_it_is() -> None:
    corridor = drawn("##############", "..............", "##############")
    route, ways = Route(), Ways(corridor)
    for step, cell in enumerate((6, 4)):
        route.cells = np.array([(cell, 1)], np.int32)
        route.detour(ways, (5, 1), (13, 1), 3.0, (0, 0, step))
    assert not len(route.cells)
