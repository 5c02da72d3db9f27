"""The world: invariants of random teams that drive at random."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.body import Body
from protocol.cell_bytes import cells_from_bytes, cells_to_bytes, points_to_bytes
from protocol.grid import FREE, OCCUPIED, disc, ray_table
from protocol.messages import FaultEvent, Move, Sense
from protocol.range_scans import TURN, Laser
from protocol.scans import HIT, NONE, Readings, check_readings, draw
from tests.worldsim.random_walls import random_walls
from worldsim.motion import INTERFERENCE, NOT_BLOCKED, ROBOT, WALL
from worldsim.sensor_options import LaserOptions, PoseOptions
from worldsim.sensors import RobotSensors, SensorSettings
from worldsim.starts import start_cells
from worldsim.world import MOVES_AS_PLANNED, World, WorldSettings

Cell = tuple[int, int]
seeds = st.integers(0, 2**32 - 1)
NEIGHBORS = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1) if dx or dy]


@st.composite
def teams(draw_: st.DrawFn, /) -> World:
    seed, robots = draw_(seeds), draw_(st.integers(1, 5))
    rng = np.random.default_rng(seed)
    truth = random_walls(seed)
    bodies = tuple(
        Body(float(rng.uniform(1, 8)), float(rng.choice([360.0, 180.0])), float(rng.uniform(0.2, 3.5)))
        for _ in range(robots)
    )
    starts = tuple(start_cells(truth, robots, seed, 1, (10, 10)))
    return World(truth, WorldSettings(bodies, starts, 36, seed))


def random_move(rng: np.random.Generator, world: World, robot: int) -> Move:
    x, y = world.cells[robot]
    path = []
    for _ in range(rng.integers(0, 7)):
        dx, dy = NEIGHBORS[rng.integers(8)]
        x, y = x + dx, y + dy
        path.append((x, y))
    return Move(
        world.step, cells_to_bytes(np.array(path, np.int32).reshape(-1, 2)), int(rng.integers(-9, 9)), False
    )


def random_steps(world: World, seed: int, steps: int = 12) -> list[tuple[dict[int, Cell], dict[int, Sense]]]:
    """Drive at random; return the cells and scans of all robots for each step."""
    rng = np.random.default_rng(seed)
    history = []
    for _ in range(steps):
        moves = {robot: random_move(rng, world, robot) for robot in world.cells if rng.random() < 0.9}
        senses = world.advance(moves)
        history.append((dict(world.cells), senses))
    return history


def readings_of(sense: Sense) -> Readings:
    return np.frombuffer(sense.readings, np.uint16).copy()


@given(teams(), seeds)
def test_no_robot_ever_stands_in_a_wall_and_never_two_in_one_place(world: World, seed: int) -> None:
    for cells, _ in random_steps(world, seed):
        assert all(world.truth[y, x] == FREE for x, y in cells.values())
        assert len(set(cells.values())) == len(cells)


@given(teams(), seeds)
def test_no_robot_leaves_the_part_of_the_world_that_it_can_reach(world: World, seed: int) -> None:
    for cells, _ in random_steps(world, seed):
        assert all(world.reachable[y, x] for x, y in cells.values())


@given(teams(), seeds)
def test_no_robot_drives_further_than_its_speed_allows(world: World, seed: int) -> None:
    for number in range(1, 13):
        random_steps(world, seed + number, 1)
        for body, driven in zip(world.settings.bodies, world.driven, strict=True):
            assert driven <= number * body.speed + 1e-6


@given(teams(), seeds)
def test_robot_receives_its_true_position_and_path(world: World, seed: int) -> None:
    before = dict(world.cells)
    for cells, senses in random_steps(world, seed):
        assert list(senses) == sorted(cells)
        for robot, sense in senses.items():
            assert (sense.x, sense.y) == cells[robot]
            assert 0 <= sense.heading < 8
            driven = [(int(x), int(y)) for x, y in cells_from_bytes(sense.driven)]
            assert all(world.truth[y, x] == FREE for x, y in driven)
            assert driven[-1:] == [cells[robot]] or (not driven and cells[robot] == before[robot])
            assert all(
                abs(x0 - x1) + abs(y0 - y1) <= 2 for (x0, y0), (x1, y1) in pairwise([before[robot], *driven])
            )
            check_readings(readings_of(sense), ray_table(world.settings.bodies[robot].range_cells, 36))
        before = cells


@given(teams(), seeds)
def test_cells_drawn_from_scans_are_true_and_equal_the_cells_that_the_world_counts(
    world: World, seed: int
) -> None:
    drawn = np.zeros_like(world.truth)
    for _, senses in random_steps(world, seed):
        for robot, sense in senses.items():
            for x, y in cells_from_bytes(sense.driven):
                drawn[y, x] = FREE
            draw(
                drawn,
                ray_table(world.settings.bodies[robot].range_cells, 36),
                sense.x,
                sense.y,
                readings_of(sense),
            )
        assert (world.truth[drawn == FREE] == FREE).all()
        assert (world.truth[drawn == OCCUPIED] != FREE).all()
    assert (drawn == world.seen).all()
    assert world.seen_cells == np.count_nonzero((drawn == FREE) & world.reachable) <= world.reachable_cells


@given(teams(), seeds)
def test_the_same_moves_give_the_same_world(world: World, seed: int) -> None:
    other = World(world.truth, world.settings)
    assert random_steps(world, seed) == random_steps(other, seed)


@given(teams(), seeds)
def test_lost_robot_blocks_no_other(world: World, seed: int) -> None:
    world.remove(0)
    for cells, senses in random_steps(world, seed, 3):
        assert 0 not in cells
        assert 0 not in senses


def corridor(robots: int = 2, length: int = 12, speed: float = 1.0, **settings: Any) -> World:
    truth = np.full((1, length), FREE, np.uint8)
    bodies = tuple(Body(3.0, 360.0, speed) for _ in range(robots))
    return World(truth, WorldSettings(bodies, tuple((3 * n, 0) for n in range(robots)), 4, **settings))


def along(*xs: int) -> bytes:
    return cells_to_bytes(np.array([(x, 0) for x in xs], np.int32))


def go(path: bytes, heading: int = 0, **more: Any) -> Move:
    return Move(1, path, heading, explored=False, **more)


def test_robots_move_in_the_order_of_their_numbers() -> None:
    world = corridor()
    world.cells = {0: (3, 0), 1: (4, 0)}
    senses = world.advance({0: go(along(4)), 1: go(along(5))})
    assert world.cells == {0: (3, 0), 1: (5, 0)}
    assert (senses[0].blocked, senses[1].blocked) == (ROBOT, NOT_BLOCKED)
    world.advance({0: go(along(4)), 1: go(along(4))})
    assert world.cells == {0: (4, 0), 1: (5, 0)}


def test_two_robots_cannot_swap_cells() -> None:
    world = corridor()
    world.cells = {0: (3, 0), 1: (4, 0)}
    world.advance({0: go(along(4)), 1: go(along(3))})
    assert world.cells == {0: (3, 0), 1: (4, 0)}


def test_robot_receives_the_reason_for_its_stop() -> None:
    world = corridor(1, 4, 9.0)
    assert world.advance({0: go(along(1, 2, 3, 4))})[0].blocked == WALL
    assert world.cells == {0: (3, 0)}
    assert world.advance({})[0].blocked == NOT_BLOCKED


def test_slow_robot_carries_unused_distance_over() -> None:
    world = corridor(1, 12, 0.4)
    where = [0]
    for _ in range(10):
        x = where[-1]
        world.advance({0: go(along(x + 1, x + 2))})
        where.append(world.cells[0][0])
    assert where == [0, 0, 0, 1, 1, 2, 2, 2, 3, 3, 4]


def test_robots_may_differ_in_speed_and_sensor() -> None:
    truth = np.full((3, 40), FREE, np.uint8)
    bodies = (Body(2.0, 360.0, 1.0), Body(9.0, 180.0, 3.0))
    world = World(truth, WorldSettings(bodies, ((0, 0), (0, 2)), 8))
    for _ in range(4):
        moves = {
            robot: go(
                cells_to_bytes(
                    np.array([(world.cells[robot][0] + n, 2 * robot) for n in range(1, 6)], np.int32)
                )
            )
            for robot in range(2)
        }
        senses = world.advance(moves)
    assert world.cells == {0: (4, 0), 1: (12, 2)}
    slow, fast = readings_of(senses[0]), readings_of(senses[1])
    assert (slow[0], fast[0]) == (2, 9)
    assert slow[4] == 2
    assert fast[4] == NONE


def test_resting_robot_chooses_its_heading_and_driving_robot_faces_ahead() -> None:
    world = corridor(1)
    assert world.advance({0: go(b"", 3)})[0].heading == 3
    assert world.advance({0: go(b"", -1)})[0].heading == 7
    assert world.advance({0: go(along(1), 3)})[0].heading == 0
    assert world.advance({0: go(along(0), 3)})[0].heading == 4


def test_a_robot_that_a_wall_stops_keeps_its_heading_unless_its_laser_is_real() -> None:
    laser = Laser(4, 0, TURN - TURN // 4, 3000)
    sensors = SensorSettings((RobotSensors(LaserOptions(range_error_m=0.01), PoseOptions(), laser),), 0.1)
    exact, real = corridor(1, 2), corridor(1, 2, sensors=sensors)
    for world, heading in ((exact, 3), (real, 0)):
        world.cells = {0: (1, 0)}
        sense = world.advance({0: go(along(2), 3)})[0]
        assert (sense.blocked, sense.heading) == (WALL, heading)


def test_a_scanner_that_is_off_reads_nothing() -> None:
    world = corridor(1)
    assert (readings_of(world.advance({0: go(b"", look=False)})[0]) == NONE).all()
    assert (readings_of(world.advance({0: go(b"", look=True)})[0]) != NONE).all()


def test_a_turning_scanner_has_read_every_beam_once_after_a_turn() -> None:
    truth = np.full((9, 9), FREE, np.uint8)
    world = World(truth, WorldSettings((Body(3.0, 360.0, 1.0, 72.0),), ((4, 4),), 360))
    read = [np.flatnonzero(readings_of(world.advance({})[0]) != NONE) for _ in range(6)]
    assert [len(beams) for beams in read] == 6 * [72]
    assert sorted(np.concatenate(read[:5]).tolist()) == list(range(360))
    assert read[5].tolist() == read[0].tolist()


@pytest.mark.parametrize(("distance", "hinders"), [(2, True), (5, False)])
def test_robots_close_to_each_other_move_as_planned_seven_times_in_ten(distance: int, hinders: bool) -> None:
    moved = 0
    trials = 1500
    for seed in range(trials):
        truth = np.full((3, 12), FREE, np.uint8)
        bodies = 2 * (Body(1.0, 360.0, 1.0),)
        starts = ((2, 1), (2 + distance, 1))
        world = World(truth, WorldSettings(bodies, starts, 4, seed, interference_cells=4.0))
        sense = world.advance({0: go(cells_to_bytes(np.array([(2, 2)], np.int32)))})[0]
        assert sense.blocked == (NOT_BLOCKED if world.cells[0] == (2, 2) else INTERFERENCE)
        moved += world.cells[0] == (2, 2)
    if hinders:
        deviation = math.sqrt(trials * MOVES_AS_PLANNED * (1 - MOVES_AS_PLANNED))
        assert abs(moved - trials * MOVES_AS_PLANNED) < 4 * deviation
        assert MOVES_AS_PLANNED == 0.7
    else:
        assert moved == trials


def test_without_interference_no_robot_is_hindered() -> None:
    world = corridor(2)
    world.cells = {0: (3, 0), 1: (4, 0)}
    assert all(world.advance({0: go(along(2))})[0].blocked != INTERFERENCE for _ in range(30))


def test_faults_occur_at_the_start_of_their_step_and_temporary_faults_end() -> None:
    stop, kill = FaultEvent(2, 0, "stop", 2), FaultEvent(3, 1, "kill")
    world = corridor(2, faults=(kill, stop))
    seen = []
    for _ in range(4):
        seen.append((world.due_faults(), world.active_robots()))
        assert sorted(world.advance({})) == world.active_robots()
    assert seen == [([], [0, 1]), ([stop], [1]), ([kill], [1]), ([], [0, 1])]


def test_restored_robot_returns_to_its_last_cell_or_beside_the_robot_there() -> None:
    world = corridor(2)
    places = dict(world.cells)
    world.remove(0)
    world.remove(0)
    assert list(world.cells) == [1]
    world.restore(0)
    assert world.cells == places
    world.remove(0)
    world.cells[1] = places[0]
    world.restore(0)
    (x, y), (there_x, there_y) = world.cells[0], places[0]
    assert abs(x - there_x) + abs(y - there_y) == 1
    assert world.truth[y, x] == FREE


# Robots with a radius, and continuous motion.


@given(seeds, st.floats(0.6, 1.9))
def test_no_disc_ever_overlaps_a_wall_or_another_disc(seed: int, radius: float) -> None:
    truth = random_walls(seed, 0.97)
    truth[4:17, 4:17] = FREE
    bodies = 3 * (Body(4.0, 360.0, 2.0, 0.0, radius),)
    spacing = math.ceil(2 * radius)
    starts = ((10, 10), (10 + spacing, 10), (10, 10 + spacing))
    world = World(truth, WorldSettings(bodies, starts, 8, seed))
    touched = np.argwhere(disc(radius)) - disc(radius).shape[0] // 2
    for cells, _ in random_steps(world, seed):
        for x, y in cells.values():
            for dy, dx in touched:
                inside = 0 <= y + dy < 20 and 0 <= x + dx < 20
                assert not inside or truth[y + dy, x + dx] != OCCUPIED
        places = list(cells.values())
        for n, (x, y) in enumerate(places):
            assert all(math.hypot(x - ox, y - oy) >= 2 * radius for ox, oy in places[:n])


@given(teams(), seeds)
def test_gliding_robots_stay_on_free_cells_one_robot_per_cell(world: World, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(12):
        moves, before = {}, dict(world.cells)
        for robot, (x, y) in world.cells.items():
            points = (1000 * np.array([[x, y]]) + rng.integers(-4000, 4000, (3, 2))).astype(np.int32)
            moves[robot] = go(b"", points=points_to_bytes(points))
        driven = list(world.driven)
        senses = world.advance(moves)
        assert len(set(world.cells.values())) == len(world.cells)
        for robot, (x, y) in world.cells.items():
            assert world.truth[y, x] == FREE
            assert world.reachable[y, x]
            ox, oy = world.offsets[robot]
            assert max(abs(ox), abs(oy)) <= 500
            assert world.driven[robot] - driven[robot] <= world.settings.bodies[robot].speed + 1e-9
            way = [(int(cx), int(cy)) for cx, cy in cells_from_bytes(senses[robot].driven)]
            assert all(world.truth[cy, cx] == FREE for cx, cy in way)
            assert (x, y) == before[robot] or (x, y) in way


def test_diagonal_step_counts_one_with_cell_steps() -> None:
    truth = np.full((30, 30), FREE, np.uint8)
    path = np.array([(n, n) for n in range(1, 21)], np.int32)
    for cell_steps, steps in ((True, 20), (False, 29)):
        world = World(truth, WorldSettings((Body(3.0, 360.0, 1.0),), ((0, 0),), 4, cell_steps=cell_steps))
        world.advance({})
        while world.cells[0] != (20, 20):
            ahead = path[path[:, 0] > world.cells[0][0]]
            world.advance({0: Move(world.step, cells_to_bytes(ahead), 0, explored=False)})
        assert world.step - 1 == steps
        assert world.driven[0] == pytest.approx(20 * 2**0.5)


def test_robots_that_do_not_collide_pass_through_and_see_through_each_other() -> None:
    truth = np.full((1, 9), FREE, np.uint8)
    for collide in (True, False):
        bodies = 2 * (Body(8.0, 360.0, 4.0),)
        world = World(truth, WorldSettings(bodies, ((0, 0), (2, 0)), 4, robots_collide=collide))
        path = cells_to_bytes(np.array([(n, 0) for n in range(1, 5)], np.int32))
        world.advance({})
        senses = world.advance({0: Move(1, path, 0, explored=False)})
        assert world.cells[0] == ((1, 0) if collide else (4, 0))
        assert (senses[0].blocked == "robot") == collide
        assert (np.frombuffer(senses[1].readings, np.uint16)[2] & HIT > 0) != collide


def test_smallest_robots_are_chosen_among_those_in_the_world() -> None:
    truth = np.full((9, 9), FREE, np.uint8)
    bodies = tuple(Body(4.0, 360.0, 1.0, 0.0, radius) for radius in (1.0, 0.0, 0.0))
    world = World(truth, WorldSettings(bodies, ((4, 4), (0, 0), (8, 8)), 4))
    assert world.smallest_robots() == [1, 2]
    world.remove(1)
    world.remove(2)
    assert world.smallest_robots() == [0]
