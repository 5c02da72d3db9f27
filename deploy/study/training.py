"""What the training of the predictive encoding's tables shares: explorations, streams, and maps to encode again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
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
from worldsim.generators.seeds import check_training_seeds

UNLIMITED = {"map_encoding": "scans", "bandwidth": "unlimited", "bus": "memory"}


def explorations(
    runs: Sequence[dict[str, Any]], first_seed: int
) -> Iterator[tuple[str, Plan, list[list[Sense]]]]:
    """Run explorations without a limit of the radio, each with a seed of its own from `first_seed` on.

    Yields a title, the plan, and the sensor messages of each robot.
    """
    check_training_seeds(range(first_seed, first_seed + len(runs)))
    for number, settings in enumerate(runs):
        seeds = {"map_seed": first_seed + number, "seed": first_seed + number}
        plan = plans.make(parse({**UNLIMITED, **seeds, **settings}))
        title = f"{number + 1:3} of {len(runs)} {plan.map.name}, {plan.scenario.robots} robots"
        yield title, plan, record_senses(plan)


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
