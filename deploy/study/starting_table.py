"""Train the initial symbol counts of the predictive encoding's streams on generated maps.

``python -m deploy.study.starting_table FILE.npz`` writes them to a file.

The program runs explorations of generated maps, encodes them again as the predictive encoding does, and sums the symbol
counts of each context over all robots and runs. It scales the sums down, so that a robot's own map soon outweighs
them. The result is shipped as `agent.predictive.contexts.TABLE`; encoder and decoder must have the same table.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from agent.encodings.update_packets import ENOUGH_STEPS
from agent.predictive import contexts
from agent.predictive.history import History
from agent.predictive.scan_stream import ScanStream
from deploy.run.recording_bus import record_run
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse
from protocol import keys as names
from protocol.boxes import Box, bounding_box
from protocol.cell_bytes import cells_from_bytes
from protocol.grid import UNKNOWN, ray_table
from protocol.messages import Sense
from protocol.scans import draw
from worldsim.generators.seeds import check_training_seeds

MAPS = ("office", "mixed", "burgard-office", "autolab-like", "jh-like", "unstructured", "office-plain")
TEAMS = (3, 6)
SPEEDS = (0.5, 1.0)
STEPS = 400

CELLS_WEIGHT = 24
"""Maximum sum of the initial counts of a cell's context."""
REST_WEIGHT = 96
"""The same for all other contexts."""


def counted(plan: Plan, senses: list[list[Sense]]) -> Iterator[NDArray[np.uint16]]:
    """Encode an exploration; yield the final counts of each robot's stream."""
    robots, shape = len(senses), plan.map.cells.shape
    ray_tables = [ray_table(body.range_cells, plan.world.beams) for body in plan.world.bodies]
    grids = np.zeros((robots, *shape), np.uint8)
    histories = [History() for _ in senses]
    scratch = np.empty((2 * shape[0] * shape[1], 3), np.int32)
    even = np.zeros((contexts.CONTEXTS, 2), np.uint16)
    streams = [
        ScanStream(n, grids[n], ray_tables[n], histories, scratch, team=True, counts=even.copy())
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


def train() -> NDArray[np.uint16]:
    """Train the counts, shape (CONTEXTS, 2)."""
    total = np.zeros((contexts.CONTEXTS, 2))
    runs = list(product(MAPS, TEAMS, SPEEDS))
    check_training_seeds(range(len(runs)))
    for number, (name, robots, speed) in enumerate(runs):
        settings = {
            "map": name, "map_seed": number, "seed": number, "robots": robots, "speed": speed, "steps": STEPS,
            "strategy": "meier", "map_encoding": "scans", "bandwidth": "unlimited", "bus": "memory",
        }  # fmt: skip
        plan = plans.make(parse(settings))
        buses, _ = record_run(plan, list(map(names.robot, range(robots))))
        total += np.sum(list(counted(plan, [bus.senses for bus in buses.values()])), axis=0, dtype=float)
        print(f"{number + 1:3} {name} {robots} {speed}", flush=True)
    most = np.full(contexts.CONTEXTS, REST_WEIGHT)
    most[: contexts.OBSERVED] = CELLS_WEIGHT
    most[contexts.OBSERVED : contexts.MORE_SCANS] = contexts.REST_MOST // 2
    weight = np.minimum(1, most / np.maximum(total.sum(axis=1), 1))
    trained: NDArray[np.uint16] = np.rint(total * weight[:, None]).astype(np.uint16)
    return trained


if __name__ == "__main__":
    trained = train()
    used = np.flatnonzero(trained.any(axis=1)).astype(np.uint16)
    np.savez_compressed(sys.argv[1], contexts=used, counts=trained[used])
