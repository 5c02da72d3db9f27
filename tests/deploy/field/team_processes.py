"""Teams of `murmur robot` processes: their settings, and the maps that they publish at the end."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.radios.team_key import create_key
from deploy.record.map_quality import TrueWalls, walls_held
from deploy.scenario.plan import Plan
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.ros2.messages import OCCUPANCY_GRID
from protocol.ros2.node import Ros2Node
from protocol.ros2.qos import LATCHED
from protocol.transforms import Pose
from tests.agent.radios.modems import LONGEST, RATE, Modems
from tests.deploy.field.robot_processes import RobotProcess, write

TOLERANCE = 1


def team_settings(
    plan: Plan, router: str, starts: Sequence[Pose], radio: Callable[[int], dict[str, Any]], **changes: Any
) -> list[dict[str, Any]]:
    """Return the settings of all robots, in the form of robot.toml; `radio` returns that of a robot."""
    scenario, cell = plan.scenario, plan.map.resolution
    grid = {
        "x": 0.0, "y": 0.0, "width_m": plan.map.width * cell, "height_m": plan.map.height * cell,
        "resolution": cell,
    }  # fmt: skip
    return [
        {
            "robot": number, "robots": scenario.robots, "sensor_range": scenario.sensor_range,
            "speed": scenario.speed, "radius": scenario.radius, "step_s": 0.5, "tolerance": TOLERANCE,
            "grid": grid,
            "ros2": {
                "map_pose": [start.x, start.y, math.degrees(start.yaw)], "namespace": f"r{number}", "router": router,
            },
            "radio": {"key": "../team.key", "sessions": "."} | radio(number),
        } | changes
        for number, start in enumerate(starts)
    ]  # fmt: skip


def udp_radio(**options: Any) -> dict[str, Any]:
    """Return the radio of a team over UDP on loopback, at a free port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    return {"medium": "udp", "interface": "lo", "udp_port": port} | options


def serial_radio(modems: Modems, number: int, **options: Any) -> dict[str, Any]:
    """Return the radio of a robot with a modem; the robots of a team share the rate of the modems."""
    rate = RATE // len(modems.terminals)
    port = str(modems.terminals[number].path)
    return {"medium": "serial", "serial_port": port, "bytes_per_s": rate, "frame_bytes": LONGEST} | options


def explore(router: str, folder: Path, team: Sequence[dict[str, Any]], limit_s: float) -> dict[int, Any]:
    """Let agents explore until all have ended by themselves; return the last team map of each, as messages."""
    create_key(folder / "team.key")
    maps: dict[int, Any] = {}

    def keep(number: int) -> Callable[[Any, object], None]:
        return lambda message, _: maps.__setitem__(number, message)

    with ExitStack() as stack:
        observer = stack.enter_context(Ros2Node("observer", router=router))
        processes = []
        for data in team:
            number = data["robot"]
            observer.subscription(f"/r{number}/team_map", OCCUPANCY_GRID, LATCHED, keep(number))
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
    return dict(sorted(maps.items()))


def cells_of(message: Any, plan: Plan) -> Grid:
    """Return the cells of a team map, which has the same cells as the true map."""
    assert (message.info.width, message.info.height) == (plan.map.width, plan.map.height)
    values = np.asarray(message.data).reshape(plan.map.cells.shape)[::-1]
    found = np.full(values.shape, UNKNOWN, np.uint8)
    found[values == 0], found[values == 100] = FREE, OCCUPIED
    return found


def assert_maps_are_true(messages: dict[int, Any], plan: Plan) -> None:
    """Compare each agent's map with the true one, and with those of its teammates.

    Copies of walls have the tolerance once the author is certain of them, so a few others are left out.
    """
    assert len(messages) == plan.scenario.robots
    maps = {number: cells_of(message, plan) for number, message in messages.items()}
    reachable: NDArray[np.bool_] = plan.make_world().reachable
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
