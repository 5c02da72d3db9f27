"""Input data of the benchmarks: a plan for a generated office, and the maps of its robots step by step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agent.mapping.mapper import ExactMapper
from agent.settings import Settings
from deploy.run.recording_bus import record_senses
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from protocol.grid import Cell, Grid, RayTable, ray_table
from protocol.messages import Sense
from protocol.scans import GridChange, Scan
from worldsim import generators
from worldsim.maps import Map

SIDE_M = 30.0
"""Side length of the office in meters: 300 cells."""

SAMPLES = 40
"""Number of moments of an exploration, evenly spaced, at which a kernel is measured."""


@dataclass(frozen=True)
class Moment:
    """One robot's map after a step, its last scan, and the cells that the scan changed."""

    grid: Grid
    scan: Scan
    change: GridChange

    @property
    def cell(self) -> Cell:
        """The robot's cell."""
        return self.scan.x, self.scan.y


def office(side_m: float | None = None) -> Map:
    """Generate a square office, by default with sides of `SIDE_M`."""
    side_m = side_m or SIDE_M
    return generators.make("office", width_m=side_m, height_m=side_m)


def office_plan(strategy: str = "meier", **settings: Any) -> Plan:
    """Plan a run of the strategy in the office."""
    return plans.make(Scenario(strategy=strategy, **settings), office())


def explore(plan: Plan) -> list[list[Moment]]:
    """Run the plan in memory; return the moments of each robot."""
    return [
        list(_moments(plan.robot_settings[robot], senses)) for robot, senses in enumerate(record_senses(plan))
    ]


def _moments(settings: Settings, senses: Sequence[Sense]) -> Iterator[Moment]:
    mapper = ExactMapper(settings)
    for sense in senses:
        scan, change = mapper.add(sense)
        yield Moment(mapper.states.copy(), scan, change)


def beams(plan: Plan) -> RayTable:
    """The laser beams of the plan's robots."""
    return ray_table(plan.world.bodies[0].range_cells, plan.world.beams)


def samples(moments: Sequence[Moment]) -> list[Moment]:
    """Evenly spaced moments of an exploration, including the last one."""
    return [moments[i] for i in np.linspace(0, len(moments) - 1, SAMPLES).astype(int).tolist()]
