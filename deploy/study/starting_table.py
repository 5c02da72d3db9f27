"""The counts with which predictive's streams begin, learnt on generated maps.

``python -m deploy.study.starting_table FILE.npz`` writes them to a file.

Explorations of generated maps are run, and told again in units as the predictive exchange tells them. What came how often
in each context is summed up over all robots and runs, and scaled down, so that a robot's own building soon counts more.
What is written is shipped as `agent.predictive.contexts.TABLE`; whoever reads a stream must have the one that it was
written with.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent.encodings.predictive import ENOUGH_STEPS
from agent.predictive import contexts
from agent.predictive.history import History
from agent.predictive.stream import Stream
from deploy.run import in_memory
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse
from protocol import keys as names
from protocol.boxes import Box, bounding_box
from protocol.bus import Bus, Message
from protocol.grid import UNKNOWN, ray_table
from protocol.messages import Sense, cells_from_bytes, unpack
from protocol.scans import draw

MAPS = ("office", "mixed", "burgard-office", "autolab-like", "jh-like", "unstructured", "office-plain")
TEAMS = (3, 6)
SPEEDS = (0.5, 1.0)
STEPS = 400

CELLS_WEIGHT = 24
"""Sum of the counts with which a cell's context begins at most; and that of all others."""
REST_WEIGHT = 96


class _Listener:
    """A robot's end of the bus; what its body senses is kept."""

    def __init__(self, inner: Bus, senses: list[Sense]) -> None:
        self._inner = inner
        self._senses = senses
        self.put = inner.put
        self.close = inner.close

    def receive(self, timeout_s: float | None = None) -> Message | None:
        message = self._inner.receive(timeout_s)
        if message is not None and names.parts(message.key)[0] == "body":
            said = unpack(message.payload)
            if isinstance(said, Sense):
                self._senses.append(said)
        return message


def explored(plan: Plan) -> list[list[Sense]]:
    """Run an exploration; return what each robot sensed, step by step."""
    senses: list[list[Sense]] = [[] for _ in range(plan.scenario.robots)]

    def wrap(name: str, bus: Bus) -> Bus:
        return _Listener(bus, senses[names.number(name)]) if names.is_robot(name) else bus

    in_memory.run(plan, wrap=wrap)
    return senses


def counted(plan: Plan, senses: list[list[Sense]]) -> Iterator[NDArray[np.uint16]]:
    """Tell an exploration again; yield the counts of each robot's stream at its end."""
    robots, shape = len(senses), plan.map.cells.shape
    ray_tables = [ray_table(body.range_cells, plan.world.beams) for body in plan.world.bodies]
    grids = np.zeros((robots, *shape), np.uint8)
    histories = [History() for _ in senses]
    scratch = np.empty((2 * shape[0] * shape[1], 3), np.int32)
    even = np.zeros((contexts.CONTEXTS, 2), np.uint16)
    streams = [
        Stream(n, grids[n], ray_tables[n], histories, scratch, team=True, counts=even.copy())
        for n in range(robots)
    ]
    own = np.full((robots, *shape), UNKNOWN, np.uint8)
    poses: list[list[tuple[int, int]]] = [[] for _ in senses]
    boxes: list[list[Box]] = [[] for _ in senses]
    for step in range(max(map(len, senses))):
        for robot in range(robots):
            sense = senses[robot][step]
            readings = np.frombuffer(sense.readings, np.uint16).copy()
            driven = cells_from_bytes(sense.driven)
            change = draw(own[robot], ray_tables[robot], sense.x, sense.y, readings, driven)
            if change.cells:
                poses[robot].append((sense.x, sense.y))
                boxes[robot].append(change.box)
            if poses[robot] and (step + robot) % ENOUGH_STEPS == 0:
                streams[robot].encode(own[robot], poses[robot], bounding_box(boxes[robot]))
                poses[robot], boxes[robot] = [], []
    for stream in streams:
        yield stream.counts


def learn() -> NDArray[np.uint16]:
    """Learn the counts, of shape (CONTEXTS, 2)."""
    total = np.zeros((contexts.CONTEXTS, 2))
    for number, (name, robots, speed) in enumerate(product(MAPS, TEAMS, SPEEDS)):
        settings = {
            "map": name, "map_seed": number, "seed": number, "robots": robots, "speed": speed, "steps": STEPS,
            "strategy": "meier", "map_encoding": "scans", "bandwidth": "unlimited", "bus": "memory",
        }  # fmt: skip
        plan = plans.make(parse(settings))
        for counts in counted(plan, explored(plan)):
            total += counts
        print(f"{number + 1:3} {name} {robots} {speed}", flush=True)
    most = np.full(contexts.CONTEXTS, REST_WEIGHT)
    most[: contexts.SEEN] = CELLS_WEIGHT
    most[contexts.SEEN : contexts.MORE] = contexts.REST_MOST // 2
    weight = np.minimum(1, most / np.maximum(total.sum(axis=1), 1))
    learnt: NDArray[np.uint16] = np.rint(total * weight[:, None]).astype(np.uint16)
    return learnt


def main(path: Path) -> None:
    """Learn the table and write it."""
    counts = learn()
    used = np.flatnonzero(counts.any(axis=1)).astype(np.uint16)
    np.savez_compressed(path, contexts=used, counts=counts[used].astype(np.uint16))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
