"""Agents drive the robots of `murmur serve-ros2`, all as processes, and share an office over serial modems."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from deploy.scenario import plan as plans
from deploy.scenario.scenario import parse
from protocol.transforms import Pose
from tests.agent.radios.modems import Modems, carrying
from tests.deploy.field.team_processes import assert_maps_are_true, explore, serial_radio, team_settings
from tests.system.served_robots import serving

ROBOTS = 2
SPEED, SENSOR_RANGE = 1.0, 5.0
LIMIT_S = 1200.0
"""Time limit; it is reached only if the test fails."""


@pytest.mark.long
def test_two_agents_share_an_office_over_modems_of_200_bytes_per_second_that_lose_a_tenth(
    tmp_path: Path,
) -> None:
    given = {
        "map": "office", "robots": ROBOTS, "speed": SPEED, "sensor_range": SENSOR_RANGE, "radius": 0.2,
        "start_spacing": 0.8,
    }  # fmt: skip
    plan, modems = plans.make(parse(given)), Modems(ROBOTS, loss=0.1)
    options = ("--robots", str(ROBOTS), "--speed", str(SPEED), "--sensor-range", str(SENSOR_RANGE))
    with carrying(modems), serving("--map", "office", *options, "--json") as served:
        places = [served.printed["robots"][f"r{number}"] for number in range(ROBOTS)]
        starts = [Pose(x, y, math.radians(degrees)) for x, y, degrees in places]
        router = served.printed["router"]
        team = team_settings(plan, router, starts, lambda number: serial_radio(modems, number))
        maps = explore(router, tmp_path, team, LIMIT_S)
    assert json.loads(served.output)["coverage"] > 0.95
    assert modems.lost > 0
    assert_maps_are_true(maps, plan)
