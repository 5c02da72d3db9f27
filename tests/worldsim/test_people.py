"""People in the building: they walk on free cells, never into robots, and lasers see them as discs."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from protocol.body import Body
from protocol.cell_bytes import cells_to_bytes
from protocol.grid import FREE, OCCUPIED, Grid, enlarge
from protocol.keyed_random import keyed_random
from protocol.messages import Move, Sense
from protocol.range_scans import NO_MEASUREMENT, TURN, Laser, decode_range_scan
from worldsim.motion import NOT_BLOCKED, PERSON
from worldsim.people import People, PeopleSettings, shortest_way
from worldsim.people_options import PeopleOptions
from worldsim.range_laser import RangeLaser
from worldsim.sensor_options import LaserOptions, PoseOptions
from worldsim.sensors import RobotSensors, SensorSettings
from worldsim.world import World, WorldSettings, scans_in

Cell = tuple[int, int]
CELL = 0.1
LASER = Laser(360, 0, TURN - TURN // 360, 5000)
BODY = Body(range_cells=50.0, field_of_view=360.0, speed=5.0, radius_cells=1.5)
WALKERS = PeopleSettings(4, 13.0, 2.5)


def building(seed: int = 0, side: int = 60) -> Grid:
    """Return rooms with doors between them, and some pillars."""
    rng = np.random.default_rng(seed)
    truth = np.full((side, side), FREE, np.uint8)
    truth[[0, -1]] = truth[:, [0, -1]] = OCCUPIED
    truth[side // 2, :], truth[:, side // 2] = OCCUPIED, OCCUPIED
    for at in (side // 4, 3 * side // 4):
        truth[side // 2, at - 4 : at + 5] = FREE
        truth[at - 4 : at + 5, side // 2] = FREE
    for x, y in rng.integers(2, side - 2, (5, 2)).tolist():
        truth[y, x] = OCCUPIED
    truth[8:13, 8:13] = FREE
    return truth


def world_of(
    truth: Grid,
    people: PeopleSettings | None,
    starts: tuple[Cell, ...] = ((10, 10),),
    seed: int = 0,
    rate: float = 1.0,
) -> World:
    own = RobotSensors(LaserOptions(range_error_m=0.01), PoseOptions(), LASER)
    sensors = SensorSettings((own,) * len(starts), CELL)
    bodies = (replace(BODY, scan_rate=rate),) * len(starts)
    return World(truth, WorldSettings(bodies, starts, seed=seed, sensors=sensors, people=people))


def plain_steps(truth: Grid, start: Cell, end: Cell) -> int | None:
    """Return the length of a shortest way between neighbors, none past a corner; None without a way."""
    free = {(x, y) for y, x in np.argwhere(truth == FREE).tolist()}
    found, queue = {start: 0}, deque([start])
    while queue:
        x, y = queue.popleft()
        for near in ((x + dx, y + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)):
            if {near, (near[0], y), (x, near[1])} <= free and near not in found:
                found[near] = found[x, y] + 1
                queue.append(near)
    return found.get(end)


@given(st.integers(0, 2**32 - 1))
def test_ways_are_as_short_as_those_of_a_plain_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = rng.choice(np.array([FREE, OCCUPIED], np.uint8), (12, 15), p=[0.75, 0.25])
    cells = [(int(x), int(y)) for y, x in np.argwhere(truth == FREE)]
    start, end = cells[rng.integers(len(cells))], cells[rng.integers(len(cells))]
    way = [(x, y) for x, y in shortest_way(truth, start, end).tolist()]
    steps = plain_steps(truth, start, end)
    assert len(way) == (steps or 0)
    if way:
        assert way[-1] == end
        assert all(plain_steps(truth, *pair) == 1 for pair in zip([start, *way], way, strict=False))


def test_a_way_in_the_open_does_not_zigzag() -> None:
    way = shortest_way(np.full((20, 20), FREE, np.uint8), (2, 5), (15, 9))
    steps = np.diff(np.concatenate([[(2, 5)], way]), axis=0)
    assert (steps[:, 0] == 1).all()
    assert np.abs(steps[:, 1]).sum() == 4


@given(st.integers(0, 2**32 - 1))
def test_people_walk_on_free_cells_at_their_speed(seed: int) -> None:
    truth = building(seed)
    world = world_of(truth, WALKERS, seed=seed)
    floor, walked = enlarge(truth, WALKERS.radius_cells), np.zeros(WALKERS.number)
    for _ in range(30):
        before = world.people
        world.advance({})
        for person, ((x, y), (was_x, was_y)) in enumerate(zip(world.people, before, strict=True)):
            assert floor[y, x] == FREE
            way = math.hypot(x - was_x, y - was_y)
            assert way <= WALKERS.speed + math.sqrt(2)
            walked[person] += way
    assert (walked > 0).all()


def random_moves(world: World, rng: np.random.Generator) -> dict[int, Move]:
    moves = {}
    for robot, (x, y) in world.cells.items():
        dx, dy = rng.integers(-1, 2, 2).tolist()
        path = np.array([(x + n * dx, y + n * dy) for n in range(1, 6)], np.int32)
        moves[robot] = Move(world.step, cells_to_bytes(path), 0, explored=False)
    return moves


@given(st.integers(0, 2**32 - 1))
def test_people_and_robots_never_touch_each_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = world_of(building(), PeopleSettings(8, 13.0, 2.5), ((10, 10), (15, 10), (10, 15)), seed)
    for _ in range(30):
        world.advance(random_moves(world, rng))
        for x, y in world.people:
            for robot_x, robot_y in world.cells.values():
                assert math.hypot(x - robot_x, y - robot_y) >= WALKERS.radius_cells + BODY.radius_cells


def hall(length: int = 60) -> Grid:
    """Return a corridor in which no person gets past a robot."""
    truth = np.full((9, length), OCCUPIED, np.uint8)
    truth[1:-1, 1:-1] = FREE
    return truth


def drive_on(world: World) -> Sense:
    """Drive robot 0 along the corridor."""
    x, y = world.cells[0]
    path = np.array([(x + n, y) for n in range(1, 7)], np.int32)
    return world.advance({0: Move(world.step, cells_to_bytes(path), 0, explored=False)})[0]


def test_a_robot_stops_before_a_person_is_told_and_drives_on() -> None:
    world = world_of(hall(), PeopleSettings(1, 0.0, 2.5), ((5, 4),))
    (person,) = world.people
    senses = [drive_on(world) for _ in range(12)]
    assert {sense.blocked for sense in senses[:2]} <= {NOT_BLOCKED}
    assert senses[-1].blocked == PERSON
    assert world.cells[0][0] == person[0] - 4
    settings = world.settings
    again = World(world.truth, WorldSettings(settings.bodies, (world.cells[0],), sensors=settings.sensors))
    assert drive_on(again).blocked == NOT_BLOCKED


def test_a_person_walks_around_a_robot_or_turns_back() -> None:
    open_space = building()
    world = world_of(open_space, WALKERS, ((10, 10),))
    seen: set[Cell] = set()
    for _ in range(150):
        world.advance({})
        seen |= set(world.people)
    assert len(seen) > 100
    truth = hall()
    corridor = world_of(truth, PeopleSettings(1, 13.0, 2.5), ((30, 4),))
    places = set()
    for _ in range(150):
        corridor.advance({})
        places.add(corridor.people[0])
    assert len(places) > 10, "the person does not wait forever"
    assert len({x < 30 for x, _ in places}) == 1, "no way leads past the robot"


def test_people_do_not_depend_on_the_order_of_robots_or_on_each_other() -> None:
    starts = ((10, 10), (50, 50))
    one, other = (world_of(building(), WALKERS, order, seed=3) for order in (starts, starts[::-1]))
    for _ in range(40):
        one.advance({})
        other.advance({})
        assert one.people == other.people
    assert one.people != world_of(building(), WALKERS, starts, seed=4).people


def test_the_true_map_has_no_people() -> None:
    empty, full = (world_of(building(), people) for people in (None, PeopleSettings(20, 13.0, 2.5)))
    truth = empty.truth.copy()
    for _ in range(20):
        empty.advance({})
        full.advance({})
        assert full.seen_cells == empty.seen_cells
    assert (full.truth == truth).all()
    assert (full.reachable == empty.reachable).all()


def test_a_beam_ends_at_the_border_of_the_nearest_disc() -> None:
    truth, no_robots = building(), np.zeros((60, 60), np.bool_)
    discs = np.array([(20.0, 10.5, 2.5), (25.0, 10.5, 2.5), (10.5, 20.0, 3.0)])
    laser = RangeLaser(LaserOptions(), LASER, CELL)
    empty, seen = (
        laser.ranges(truth, no_robots, (10.5, 10.5), 0, keyed_random(1, "laser"), people).astype(int)
        for people in (discs[:0], discs)
    )
    assert seen[0] == 700
    assert seen[90] == 650
    for beam in range(360):
        angle = 2 * math.pi * int(LASER.angles[beam]) / TURN
        steps = np.arange(0, empty[beam] / 100, 0.001)
        x, y = 10.5 + steps * math.cos(angle), 10.5 + steps * math.sin(angle)
        inside = ((x[:, None] - discs[:, 0]) ** 2 + (y[:, None] - discs[:, 1]) ** 2 < discs[:, 2] ** 2).any(
            axis=1
        )
        wanted = 100 * steps[inside.argmax()] if inside.any() else empty[beam]
        assert seen[beam] == pytest.approx(wanted, abs=1.5)


def test_a_person_in_front_of_a_teammate_is_seen_and_one_behind_it_is_not() -> None:
    truth, robots = building(), np.zeros((60, 60), np.bool_)
    robots[10, 16] = True
    laser = RangeLaser(LaserOptions(), LASER, CELL)
    for x, wanted in ((13.5, 200), (20.5, NO_MEASUREMENT)):
        people = np.array([(x, 10.5, 1.0)])
        ranges = laser.ranges(truth, robots, (10.5, 10.5), 0, keyed_random(1, "laser"), people)
        assert ranges[0] == wanted


def test_the_lasers_of_a_world_see_its_people() -> None:
    world = world_of(hall(), PeopleSettings(1, 0.0, 2.5), ((5, 4),))
    scan = decode_range_scan(world.advance({})[0].range_scan, LASER)
    distance = 100 * (world.people[0][0] - world.cells[0][0] - 2.5)
    assert scan.ranges[0] == pytest.approx(distance, abs=60)


def test_more_people_than_free_cells_are_refused() -> None:
    with pytest.raises(ValueError, match="200 people do not fit: there are 0 free cells"):
        world_of(hall(), PeopleSettings(200, 13.0, 4.5), ((5, 4),))
    with pytest.raises(ValueError, match="99 people do not fit"):
        People(hall(20), hall(20) == FREE, (), PeopleSettings(99, 1.0, 2.5), 0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"number": -1}, "0 to 100"),
        ({"number": 101}, "0 to 100"),
        ({"speed": -1}, "m/s"),
        ({"radius": 0}, "0.05"),
    ],
)
def test_impossible_people_are_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PeopleOptions(**values)  # type: ignore[arg-type]


@pytest.mark.parametrize("rate", [1.0, 0.5, 0.3, 0.1])
def test_a_laser_scans_as_often_as_its_rate_says(rate: float) -> None:
    world = world_of(building(), None, rate=rate)
    scans = [bool(decode_range_scan(world.advance({})[0].range_scan, LASER).ranges.any()) for _ in range(100)]
    assert scans == [scans_in(step, rate) for step in range(1, 101)]
    assert scans[0]
    assert sum(scans) == pytest.approx(100 * rate, abs=1)
