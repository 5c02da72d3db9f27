"""Offline exploration: in the simulated world its plan sees everything."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from deploy.run.offline_bound import KnownBuilding, offline_steps, offline_tours
from protocol.body import Body
from protocol.cell_bytes import cells_to_bytes
from protocol.grid import FREE, OCCUPIED, Cell, Grid
from protocol.messages import Move
from worldsim import generators
from worldsim.world import World, WorldSettings

RANGE, SPEED = 12.0, 2.5


def _building(truth: Grid, start: Cell, radius: float = 0.0) -> KnownBuilding:
    return KnownBuilding(truth, start, RANGE, SPEED, radius_cells=radius)


def _corridor(length: int) -> Grid:
    truth = np.full((3, length + 2), OCCUPIED, np.uint8)
    truth[1, 1:-1] = FREE
    return truth


def _drive(world: World, building: KnownBuilding, tour: list[Cell]) -> None:
    """Let the world's only robot drive to all its stops."""
    world.advance({})
    for start, stop in pairwise(tour):
        path = building.path(start, stop)
        while path:
            route = cells_to_bytes(np.array(path, np.int32))
            world.advance({0: Move(world.step, route, 0, False, True, False, b"")})
            path = path[path.index(world.cells[0]) + 1 :]


@pytest.mark.parametrize("radius", [0.0, 1.5])
def test_the_plan_of_one_robot_sees_everything_in_the_planned_number_of_steps(
    radius: float,
) -> None:
    truth = generators.make("office", width_m=14, height_m=14, seed=3).cells
    y, x = np.argwhere(truth == FREE)[400]
    body = Body(RANGE, 360.0, SPEED, radius_cells=radius)
    start = (int(x), int(y))
    world = World(truth, WorldSettings((body,), (start,)))
    building = _building(truth, start, radius)
    (tour,) = offline_tours(building, [start])
    _drive(world, building, tour)
    assert world.step == building.steps([tour])
    if radius == 0:
        assert world.seen_cells == world.reachable_cells
    scans = [start, *(cell for one, other in pairwise(tour) for cell in building.scan_positions(one, other))]
    seen = np.zeros(truth.size, np.bool_)
    for cell in scans:
        seen[building.seen(cell)] = True
    reached = building.floor == FREE
    assert seen.reshape(truth.shape)[reached].all()
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        beside = np.roll(reached, (dy, dx), (0, 1))
        assert seen.reshape(truth.shape)[beside].all()


def test_robots_share_the_work() -> None:
    truth = generators.make("office", width_m=14, height_m=14, seed=3).cells
    y, x = np.argwhere(truth == FREE)[400]
    building = _building(truth, (int(x), int(y)))
    one, four = (offline_steps(building, [(int(x), int(y))] * robots) for robots in (1, 4))
    assert four < 0.6 * one


def test_in_a_corridor_the_plan_is_known() -> None:
    # The robot has to come within 12 cells of cell 101: 88 cells at 2.5 a step, and a scan before it drives. The
    # beams are a degree apart, so they see all walls beside the last cells only from somewhat nearer.
    building = _building(_corridor(101), (1, 1))
    steps = 1 + int(np.ceil((101 - 1 - RANGE) / SPEED))
    assert steps <= offline_steps(building, [(1, 1)]) <= steps + 4


def test_a_building_seen_from_the_start_takes_one_step() -> None:
    building = _building(_corridor(8), (3, 1))
    assert offline_steps(building, [(3, 1)]) == 1
