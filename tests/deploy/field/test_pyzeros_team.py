"""Murmur agents explore with robots that an independent library plays: pyzeros speaks for our simulator's robots."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.radios.team_key import create_key
from deploy.record.map_quality import TrueWalls, walls_held
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.ros2.messages import OCCUPANCY_GRID
from protocol.ros2.node import Ros2Node
from protocol.ros2.qos import LATCHED
from protocol.transforms import Pose
from tests.deploy.field.pyzeros_robots import PyzerosSwarm, skip_without_compiler
from tests.deploy.field.robot_processes import RobotProcess, write
from tests.deploy.serve.small_house import house_plan

BYTES_PER_S = 50
"""What all robots in the office may send together, seals included."""
LIMIT_S = 90.0
"""Time limit of the house; it is reached only if the test fails."""
OFFICE_LIMIT_S = 1200.0
"""The same for the office."""
TOLERANCE = 1


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    skip_without_compiler()


def settings(plan: Plan, number: int, start: Pose, router: str, port: int) -> dict[str, Any]:
    """Return the settings of one robot, in the form of robot.toml."""
    scenario, cell = plan.scenario, plan.map.resolution
    return {
        "robot": number, "robots": scenario.robots, "sensor_range": scenario.sensor_range,
        "speed": scenario.speed, "radius": scenario.radius, "step_s": 0.5, "tolerance": TOLERANCE,
        "grid": {
            "x": 0.0, "y": 0.0, "width_m": plan.map.width * cell, "height_m": plan.map.height * cell,
            "resolution": cell,
        },
        "ros2": {
            "map_pose": [start.x, start.y, math.degrees(start.yaw)], "namespace": f"r{number}", "router": router,
            "navigate_to_pose": "",
        },
        "radio": {
            "medium": "udp", "interface": "lo", "udp_port": port, "key": "../team.key", "sessions": ".",
        },
    }  # fmt: skip


def explore(
    plan: Plan,
    router: str,
    folder: Path,
    limit_s: float,
    radio: dict[str, Any],
    without_scans: Sequence[int] = (),
    **changes: Any,
) -> dict[int, Grid]:
    """Let agents explore until all of them have ended by themselves; return the last team map of each.

    Robots in `without_scans` offer only their map and their transforms to their agents.
    """
    create_key(folder / "team.key")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    maps: dict[int, Any] = {}
    with ExitStack() as stack:
        played = PyzerosSwarm(router, plan)
        stack.callback(played.close)
        observer = stack.enter_context(Ros2Node("observer", router=router))
        processes = []
        for number, robot in enumerate(played.swarm.robots):
            observer.subscription(
                f"/r{number}/team_map", OCCUPANCY_GRID, LATCHED,
                lambda message, _, number=number: maps.__setitem__(number, message),
            )  # fmt: skip
            data = settings(plan, number, robot.start, router, port) | changes
            data["radio"] |= radio
            data["ros2"] |= {"scan": ""} if number in without_scans else {}
            processes.append(RobotProcess(write(folder / f"r{number}", data)))
            stack.callback(processes[-1].close)
        end = time.monotonic() + limit_s
        while any(each.process.poll() is None for each in processes):
            assert time.monotonic() < end, "\n".join(each.output for each in processes)
            observer.spin(time.time_ns(), 0.1)
        observer.spin(time.time_ns(), 1.0)
        assert [each.process.returncode for each in processes] == [0] * len(processes), [
            each.output for each in processes
        ]
        assert played.ignored == []
        assert played.swarm.world.coverage > 0.95
    return {number: cells_of(message, plan) for number, message in sorted(maps.items())}


def cells_of(message: Any, plan: Plan) -> Grid:
    """Return the cells of a team map, which has the same cells as the true map."""
    assert (message.info.width, message.info.height) == (plan.map.width, plan.map.height)
    values = np.asarray(message.data).reshape(plan.map.cells.shape)[::-1]
    found = np.full(values.shape, UNKNOWN, np.uint8)
    found[values == 0], found[values == 100] = FREE, OCCUPIED
    return found


def assert_maps_are_true(maps: dict[int, Grid], plan: Plan, reachable: np.ndarray) -> None:
    """Compare each agent's map with the true one, and with those of its teammates.

    Copies of walls have the tolerance once the author is certain of them, so a few others are left out.
    """
    assert len(maps) == plan.scenario.robots
    true_walls = TrueWalls(plan.map.cells != FREE, reachable)
    for grid in maps.values():
        score = true_walls.score(grid)
        assert score.precision is not None
        assert score.recall is not None
        assert score.precision > 0.95
        assert score.recall > 0.97
        assert np.mean(grid[reachable] != UNKNOWN) > 0.98
        assert np.mean(grid[reachable] == FREE) > 0.95
    held = walls_held({number: grid == OCCUPIED for number, grid in maps.items()}, maps, TOLERANCE)
    assert min(share for shares in held.values() for share in shares.values()) > 0.95


def test_two_agents_explore_a_house_although_one_robot_offers_only_its_map(
    router: str, tmp_path: Path
) -> None:
    plan = house_plan((1.5, 2.0), (0.7, 3.2), speed=2.0, sensor_range=4.0)
    radio = {"bytes_per_s": 500, "interval_s": 0.2}
    maps = explore(plan, router, tmp_path, LIMIT_S, radio, without_scans=(1,), step_s=0.2, finish_s=10.0)
    assert_maps_are_true(maps, plan, plan.make_world().reachable)


@pytest.mark.long
def test_three_agents_share_an_office_over_50_bytes_per_second(router: str, tmp_path: Path) -> None:
    """Three robots, which pyzeros plays, get goals over `goal_pose` only; their agents share 50 B per second."""
    plan = plans.make(
        parse(
            {
                "map": "office",
                "robots": 3,
                "radius": 0.2,
                "speed": 1.0,
                "start_spacing": 0.8,
                "sensor_range": 5.0,
            }
        )
    )
    maps = explore(plan, router, tmp_path, OFFICE_LIMIT_S, {"bytes_per_s": BYTES_PER_S // 3})
    assert_maps_are_true(maps, plan, plan.make_world().reachable)
