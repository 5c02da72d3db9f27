"""YieldBehavior: past teammates in the way, without oscillating between them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.planning.path_planner import PathPlanner
from agent.planning.route import Route
from agent.planning.yielding import FARTHEST, GIVE_UP, MEMORY, WAIT, YieldBehavior
from murmur import steps
from protocol.grid import FREE, OCCUPIED
from tests.agent.planning.planning_references import drawn
from worldsim import maps

HALL = PathPlanner(np.full((7, 9), FREE, np.uint8))
START, END = (0, 3), (8, 3)
CORRIDOR = PathPlanner(drawn("#" * 60, "." * 60, "#" * 60))


def first_cell(route: Route) -> tuple[int, int]:
    return int(route.cells[0][0]), int(route.cells[0][1])


def stopped_at(
    yielding: YieldBehavior, cell: tuple[int, int], step: int = 0, here: tuple[int, int] = START
) -> None:
    route = Route()
    route.cells = np.array([cell], np.int32)
    yielding.note(route, here, step, stopped=True)


@given(st.sets(st.tuples(st.just(1), st.integers(1, 5)), min_size=1), st.integers(1, 1000))
def test_a_robot_finds_its_way_around_any_row_of_teammates(held: set[tuple[int, int]], step: int) -> None:
    route, yielding = Route(), YieldBehavior(0, 0, 9.0, 1.0)
    route.plan(HALL, START, END)
    tries = 0
    while first_cell(route) in held:
        assert tries < len(held)
        yielding.note(route, START, step + tries, stopped=True)
        yielding.pass_by(route, HALL, START, END, step + tries)
        tries += 1
    assert tuple(route.cells[-1].tolist()) == END


def test_a_cell_that_was_held_long_ago_is_driven_over_again() -> None:
    route, yielding = Route(), YieldBehavior(0, 0, 9.0, 1.0)
    stopped_at(yielding, (1, 3))
    for step, is_forgotten in ((MEMORY - 1, False), (MEMORY, True)):
        yielding.pass_by(route, HALL, START, END, step)
        assert ([1, 3] in route.cells.tolist()) == is_forgotten


def test_a_robot_waits_before_it_takes_a_detour() -> None:
    yielding = YieldBehavior(0, 0, 9.0, 1.0)
    for step in range(1, WAIT + 1):
        assert not yielding.has_waited
        stopped_at(yielding, (1, 3), step)
    assert yielding.has_waited
    yielding.note(Route(), START, WAIT + 1, stopped=False)
    assert not yielding.has_waited


def waiting_steps(robot: int, speed: float) -> int:
    """For how many steps a robot waits for a teammate that stops it in step 1."""
    yielding, step = YieldBehavior(0, robot, 9.0, speed), 0
    while not yielding.has_waited:
        step += 1
        stopped_at(yielding, (1, 3), step)
    return step


def test_robots_that_take_several_steps_for_a_cell_wait_for_different_times() -> None:
    assert {waiting_steps(robot, speed) for robot in range(9) for speed in (1.0, 5.0)} == {WAIT}
    assert {waiting_steps(robot, 0.5) for robot in range(60)} == set(range(WAIT, WAIT + 4))


@pytest.mark.parametrize("seed", range(3))
def test_two_slow_robots_do_not_turn_aside_in_the_same_steps_for_ever(seed: int, tmp_path: Path) -> None:
    # Two rooms, and a door that is two cells wide. Robots drive half a cell per step.
    rooms = np.full((22, 42), OCCUPIED, np.uint8)
    rooms[1:21, 1:20] = rooms[1:21, 22:41] = rooms[10:12, 19:23] = FREE
    maps.save(maps.Map("rooms", rooms, 0.1), tmp_path / "rooms.yaml")
    *_, last = steps(
        map=tmp_path / "rooms.yaml", robots=2, strategy="scan-replan", sensor_range=1.0, speed=0.05, steps=300,
        seed=seed,
    )  # fmt: skip
    assert last.explored == 1


def test_without_a_detour_a_robot_yields_to_a_random_but_reproducible_cell() -> None:
    places = set()
    for robot in range(40):
        ends = []
        for _ in range(2):
            route, yielding = Route(), YieldBehavior(0, robot, 3.0, 1.0)
            stopped_at(yielding, (31, 1), 7, (30, 1))
            yielding.pass_by(route, CORRIDOR, (30, 1), (59, 1), 7)
            ends.append(int(route.cells[-1][0]) if len(route.cells) else 30)
        assert ends[0] == ends[1]
        places.add(ends[0])
    assert places == {27, 28, 29, 30}


def farthest_room(asides: int, *, begins_anew: bool = False) -> int:
    """How far a robot goes, at most, when it makes room for the last of so many times."""
    longest = 0
    for robot in range(60):
        route, yielding = Route(), YieldBehavior(0, robot, 1.0, 1.0)
        stopped_at(yielding, (31, 1), 0, (30, 1))
        for _ in range(asides - 1):
            yielding.pass_by(route, CORRIDOR, (30, 1), (59, 1), 0)
        if begins_anew:
            yielding.begin()
        yielding.pass_by(route, CORRIDOR, (30, 1), (59, 1), 0)
        longest = max(longest, len(route.cells))
    return longest


def test_the_yield_distance_grows_until_the_next_target() -> None:
    assert [farthest_room(asides) for asides in range(1, FARTHEST + 3)] == [1, 2, 4, 8, 16, 16]
    assert farthest_room(4, begins_anew=True) == 1


def test_a_robot_shut_in_between_teammates_stays_where_it_is() -> None:
    route, yielding = Route(), YieldBehavior(0, 0, 3.0, 1.0)
    stopped_at(yielding, (31, 1), 0, (30, 1))
    stopped_at(yielding, (29, 1), 1, (30, 1))
    yielding.pass_by(route, CORRIDOR, (30, 1), (59, 1), 2)
    assert not len(route.cells)


def test_repeated_stops_in_one_cell_end_in_another_target() -> None:
    yielding = YieldBehavior(0, 0, 3.0, 1.0)
    for step in range(GIVE_UP):
        assert not yielding.gives_up()
        stopped_at(yielding, (1, 3), 2 * step)
        yielding.note(Route(), START, 2 * step + 1, stopped=False)
    assert yielding.gives_up()
    assert not yielding.gives_up()
    for step in range(2 * GIVE_UP):
        stopped_at(yielding, (step % 2, 3), step, (step % 2, 4))
    assert not yielding.gives_up()
