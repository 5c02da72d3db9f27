"""Input data of the benchmarks: a plan for a generated office, and the maps of its robots step by step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deploy.run.recording_bus import record_senses
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from protocol.cell_bytes import cells_from_bytes
from protocol.grid import FREE, UNKNOWN, Grid, RayTable, ray_table
from protocol.messages import Sense
from protocol.scans import Change, Scan, draw
from worldsim import generators
from worldsim.maps import Map

SIDE_M = 30.0
"""Side length of the office in meters: 300 cells."""

SAMPLES = 40
"""Number of moments of an exploration, evenly spaced, at which a kernel is measured."""

Cell = tuple[int, int]


@dataclass(frozen=True)
class Moment:
    """One robot's map after a step, its last scan, and the cells that the scan changed."""

    grid: Grid
    scan: Scan
    change: Change

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
    return [list(_moments(plan, senses)) for senses in record_senses(plan)]


def _moments(plan: Plan, senses: Sequence[Sense]) -> Iterator[Moment]:
    laser = beams(plan)
    grid = np.full(plan.map.cells.shape, UNKNOWN, np.uint8)
    for sense in senses:
        driven = cells_from_bytes(sense.driven)
        grid[driven[:, 1], driven[:, 0]] = FREE
        scan = Scan(sense.x, sense.y, np.frombuffer(sense.readings, np.uint16).copy())
        change = draw(grid, laser, scan.x, scan.y, scan.readings)
        yield Moment(grid.copy(), scan, change)


def beams(plan: Plan) -> RayTable:
    """The laser beams of the plan's robots."""
    return ray_table(plan.world.bodies[0].range_cells, plan.world.beams)


def samples(moments: Sequence[Moment]) -> list[Moment]:
    """Evenly spaced moments of an exploration, including the last one."""
    return [moments[i] for i in np.linspace(0, len(moments) - 1, SAMPLES).astype(int).tolist()]
