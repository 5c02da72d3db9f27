"""Input data of the kernel benchmarks: the map of each robot of a team, step by step through an exploration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from deploy.run.recording_bus import record_run
from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol.grid import FREE, UNKNOWN, Grid, RayTable, ray_table
from protocol.messages import Sense, cells_from_bytes
from protocol.scans import Change, Scan, draw

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


def explore(plan: Plan) -> list[list[Moment]]:
    """Run the plan in memory; return the moments of each robot."""
    robots = list(map(names.robot, range(plan.scenario.robots)))
    buses, _ = record_run(plan, robots)
    return [list(_moments(plan, buses[name].senses)) for name in robots]


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
