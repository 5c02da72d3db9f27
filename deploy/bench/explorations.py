"""Input data of the kernel benches: an exploration by a whole team, as each robot saw it step by step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from deploy.run import in_memory
from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol.bus import Bus, Message
from protocol.grid import FREE, UNKNOWN, Grid, RayTable, ray_table
from protocol.messages import Sense, cells_from_bytes, unpack
from protocol.scans import Change, Scan, draw

SAMPLES = 40
"""Moments of an exploration, spread evenly, at which a part is measured."""

Cell = tuple[int, int]


@dataclass(frozen=True)
class Moment:
    """One robot's map after a step, the scan that it drew last, and the cells that this changed."""

    grid: Grid
    scan: Scan
    change: Change

    @property
    def cell(self) -> Cell:
        """Where the robot is."""
        return self.scan.x, self.scan.y


class _Listener:
    """A robot's end of the bus that records its sensor messages."""

    def __init__(self, inner: Bus) -> None:
        self.senses: list[Sense] = []
        self._inner = inner

    def put(self, key: str, payload: bytes) -> None:
        self._inner.put(key, payload)

    def receive(self, timeout_s: float | None = None) -> Message | None:
        message = self._inner.receive(timeout_s)
        if message is not None and names.parts(message.key)[0] == "body":
            said = unpack(message.payload)
            if isinstance(said, Sense):
                self.senses.append(said)
        return message

    def close(self) -> None:
        self._inner.close()


def explore(plan: Plan) -> list[list[Moment]]:
    """Run the plan in memory; return what every robot saw, step by step."""
    listeners: dict[str, _Listener] = {}

    def listen(name: str, bus: Bus) -> Bus:
        listeners[name] = _Listener(bus)
        return listeners[name]

    in_memory.run(plan, wrap=listen)
    robots = map(names.robot, range(plan.scenario.robots))
    return [list(_seen(plan, listeners[name].senses)) for name in robots]


def _seen(plan: Plan, senses: Sequence[Sense]) -> Iterator[Moment]:
    laser = beams(plan)
    grid = np.full(plan.map.cells.shape, UNKNOWN, np.uint8)
    for sense in senses:
        driven = cells_from_bytes(sense.driven)
        grid[driven[:, 1], driven[:, 0]] = FREE
        scan = Scan(sense.x, sense.y, np.frombuffer(sense.readings, np.uint16).copy())
        change = draw(grid, laser, scan.x, scan.y, scan.readings)
        yield Moment(grid.copy(), scan, change)


def beams(plan: Plan) -> RayTable:
    """The beams of the plan's robots."""
    return ray_table(plan.world.bodies[0].range_cells, plan.world.beams)


def samples(walk: Sequence[Moment]) -> list[Moment]:
    """Some moments of an exploration, including the last one."""
    return [walk[i] for i in np.linspace(0, len(walk) - 1, SAMPLES).astype(int).tolist()]
