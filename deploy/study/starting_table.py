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
from deploy.scenario.plan import Plan
from deploy.study.training import OwnMap, explorations, scan_streams
from protocol.boxes import bounding_box
from protocol.messages import Sense

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
    streams = scan_streams(plan, lambda _: {"counts": np.zeros((contexts.CONTEXTS, 2), np.uint16)})
    maps = [OwnMap(stream.grid.shape, stream.ray_table) for stream in streams]
    for step in range(max(map(len, senses))):
        for robot, (own, stream) in enumerate(zip(maps, streams, strict=True)):
            own.add(senses[robot][step])
            if own.poses and (step + robot) % ENOUGH_STEPS == 0:
                stream.encode(own.grid, own.poses, bounding_box(own.boxes))
                own.poses, own.boxes = [], []
    for stream in streams:
        yield stream.counts


def train() -> NDArray[np.uint16]:
    """Train the counts, shape (CONTEXTS, 2)."""
    total = np.zeros((contexts.CONTEXTS, 2))
    runs = [
        {"map": name, "robots": robots, "speed": speed, "steps": STEPS, "strategy": "meier"}
        for name, robots, speed in product(MAPS, TEAMS, SPEEDS)
    ]
    for title, plan, senses in explorations(runs, 0):
        total += np.sum(list(counted(plan, senses)), axis=0, dtype=float)
        print(title, flush=True)
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
