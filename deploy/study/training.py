"""What the training of the predictive encoding's tables shares: explorations, streams, and maps to encode again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from agent.predictive.history import History
from agent.predictive.scan_stream import ScanStream
from deploy.run.recording_bus import record_senses
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse
from protocol.body import Body
from protocol.boxes import Box
from protocol.cell_bytes import cells_from_bytes
from protocol.grid import UNKNOWN, RayTable, ray_table
from protocol.messages import Sense
from protocol.scans import draw


def explored(**settings: Any) -> tuple[Plan, list[list[Sense]]]:
    """Run an exploration without a limit of the radio; return its plan, and the sensor messages of each robot."""
    plan = plans.make(parse({"map_encoding": "scans", "bandwidth": "unlimited", "bus": "memory", **settings}))
    return plan, record_senses(plan)


def scan_streams(
    plan: Plan, options: Callable[[Body], dict[str, Any]], kind: Callable[..., ScanStream] = ScanStream
) -> list[ScanStream]:
    """Make the empty stream of each robot; `options` returns the further arguments of a stream for its robot's body."""
    shape, world = plan.map.cells.shape, plan.world
    histories = [History() for _ in world.bodies]
    scratch = np.empty((2 * shape[0] * shape[1], 2), np.int32)
    return [
        kind(
            robot, np.zeros(shape, np.uint8), ray_table(body.range_cells, world.beams), histories, scratch,
            team=True, **options(body),
        )
        for robot, body in enumerate(world.bodies)
    ]  # fmt: skip


class OwnMap:
    """A robot's map of its exact scans, and the scans that it has yet to encode."""

    def __init__(self, shape: tuple[int, ...], beams: RayTable) -> None:
        self.grid = np.full(shape, UNKNOWN, np.uint8)
        self.poses: list[tuple[int, int]] = []
        """Poses of the scans that have changed the map."""
        self.boxes: list[Box] = []
        """The boxes of the changed cells."""
        self._beams = beams

    def add(self, sense: Sense) -> None:
        """Draw a scan."""
        readings = np.frombuffer(sense.readings, np.uint16).copy()
        change = draw(self.grid, self._beams, sense.x, sense.y, readings, cells_from_bytes(sense.driven))
        if change.cells:
            self.poses.append((sense.x, sense.y))
            self.boxes.append(change.box)
