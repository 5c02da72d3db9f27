"""Murmur agents explore with robots that an independent library plays: pyzeros speaks for our simulator's robots."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse
from protocol.transforms import Pose
from tests.agent.radios.modems import Modems, carrying
from tests.deploy.field.pyzeros_robots import PyzerosSwarm, skip_without_compiler
from tests.deploy.field.team_processes import (
    assert_maps_are_true,
    explore,
    serial_radio,
    team_settings,
    udp_radio,
)
from tests.deploy.serve.small_house import house_plan

BYTES_PER_S = 50
"""What all robots in the office may send together, seals included."""
LIMIT_S = 90.0
"""Time limit of the house; it is reached only if the test fails."""
OFFICE_LIMIT_S = 1200.0
"""The same for the office."""
HOUSE: dict[str, Any] = {"step_s": 0.2, "finish_s": 10.0}
"""Settings of agents in the house."""


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    skip_without_compiler()


@contextmanager
def pyzeros_robots(router: str, plan: Plan) -> Iterator[list[Pose]]:
    """Let pyzeros play the robots of a plan; yield their start poses. At the end, they must have seen the building."""
    with closing(PyzerosSwarm(router, plan)) as played:
        yield [robot.start for robot in played.swarm.robots]
        assert played.ignored == []
        assert played.swarm.world.coverage > 0.95


def house() -> Plan:
    """Return the house with two robots."""
    return house_plan((1.5, 2.0), (0.7, 3.2), speed=2.0, sensor_range=4.0)


@pytest.mark.long
def test_two_agents_explore_a_house_although_one_robot_offers_only_its_map(
    router: str, tmp_path: Path
) -> None:
    plan, radio = house(), udp_radio(bytes_per_s=500, interval_s=0.2)
    with pyzeros_robots(router, plan) as starts:
        team = team_settings(plan, router, starts, lambda _: radio, **HOUSE)
        team[1]["ros2"]["scan"] = ""
        maps = explore(router, tmp_path, team, LIMIT_S)
    assert_maps_are_true(maps, plan)


@pytest.mark.long
def test_two_agents_share_a_house_over_modems_of_200_bytes_per_second_that_lose_a_tenth(
    router: str, tmp_path: Path
) -> None:
    plan, modems = house(), Modems(2, loss=0.1)
    with carrying(modems), pyzeros_robots(router, plan) as starts:
        team = team_settings(plan, router, starts, partial(serial_radio, modems, interval_s=1.0), **HOUSE)
        maps = explore(router, tmp_path, team, LIMIT_S)
    assert modems.lost > 0
    assert_maps_are_true(maps, plan)


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
    radio = udp_radio(bytes_per_s=BYTES_PER_S // 3)
    with pyzeros_robots(router, plan) as starts:
        maps = explore(router, tmp_path, team_settings(plan, router, starts, lambda _: radio), OFFICE_LIMIT_S)
    assert_maps_are_true(maps, plan)
