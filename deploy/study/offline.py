"""The steps of a team that knows the map, from the plan of a run: the yardstick of strategies."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from deploy.run.offline_bound import Cell, KnownBuilding, offline_steps
from deploy.scenario.plan import Plan


def known_map_steps(plan: Plan) -> int:
    """Return the steps of the offline plan for a plan's map, starts, and hardware.

    All robots are assumed to have the hardware of the first one. The last results are kept, because runs of different
    strategies share them.
    """
    body, cells = plan.world.bodies[0], plan.map.cells
    starts = tuple((int(x), int(y)) for x, y in plan.world.starts)
    hardware = float(body.range_cells), float(body.speed), plan.world.beams, float(body.radius_cells)
    return _known_map_steps(cells.tobytes(), cells.shape, starts, hardware)


@lru_cache(maxsize=8)
def _known_map_steps(
    cells: bytes, shape: tuple[int, ...], starts: tuple[Cell, ...], hardware: tuple[float, float, int, float]
) -> int:
    range_cells, speed, beams, radius_cells = hardware
    truth = np.frombuffer(cells, np.uint8).reshape(shape).copy()
    return offline_steps(KnownBuilding(truth, starts[0], range_cells, speed, beams, radius_cells), starts)
