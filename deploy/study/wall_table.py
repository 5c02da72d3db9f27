"""Train the initial model of walls, with which the predictive encoding codes scans on narrow media.

``python -m deploy.study.wall_table FILE.npz`` writes it to a file.

The program runs explorations of generated maps, and encodes them again as the predictive encoding does for a team of
`TURNS` robots on a narrow medium. A model passes from update to update, of all robots and runs. At the end it forgets
how often each context has occurred beyond `OLDEST_START` (`deploy.study.tile_table`), so that a robot's own map soon
outweighs the training. The result is shipped as `agent.predictive.wall_model.TABLE`; encoder and decoder must have the
same table.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from agent.predictive.mixer import Model, new_model
from agent.predictive.model_table import packed
from agent.predictive.scan_stream import NarrowBand, ScanStream
from agent.predictive.wall_model import CONTEXTS
from deploy.scenario.plan import Plan
from deploy.study.tile_table import shortened
from deploy.study.training import OwnMap, explorations, scan_streams
from protocol.boxes import bounding_box
from protocol.messages import Sense

MAPS = (
    "office", "mixed", "unstructured", "burgard-office", "jh-like", "autolab-like", "caves", "warehouse", "maze",
    "office-plain", "office", "wings", "burgard-unstructured", "mixed",
)  # fmt: skip

FIRST_SEED = 100
"""Seed of the first run. Experiments use the seeds below."""

TURNS = 8
"""Robots, and steps from one update of a robot to the next."""

BYTES = 20
"""The limit of an update."""

RUNS = [{"map": name, "robots": TURNS, "speed": 0.5, "steps": 400, "strategy": "meier"} for name in MAPS]
"""The settings of the explorations."""


def make_streams(
    plan: Plan, kind: Callable[..., ScanStream] = ScanStream, **options: Any
) -> list[ScanStream]:
    """Make the empty stream of each robot, with the limit `BYTES` of an update."""
    return scan_streams(plan, lambda body: options | {"narrow": NarrowBand(body.speed, BYTES)}, kind)


def train_on(
    streams: Sequence[ScanStream], senses: list[list[Sense]], model: Model
) -> tuple[Model, list[tuple[int, bytes]]]:
    """Encode an exploration with a model; return the model after the last update, and all updates with their robots.

    `streams` and `senses` are the empty stream and the sensor messages of each robot, one message per step.
    """
    updates: list[tuple[int, bytes]] = []
    maps = [OwnMap(stream.grid.shape, stream.ray_table) for stream in streams]
    for step in range(max(map(len, senses))):
        for robot, (own, stream) in enumerate(zip(maps, streams, strict=True)):
            own.add(senses[robot][step])
            if not own.poses or (step + robot) % TURNS:
                continue
            box = bounding_box(own.boxes)
            stream.model = model
            encoded = stream.encode(own.grid, own.poses, box)
            model = stream.model
            sent = len(own.poses)
            if encoded is not None:
                stream.commit()
                updates.append((robot, encoded[0]))
                sent = encoded[2]
            del own.poses[:sent]
            own.boxes = [box] if own.poses else []
    return model, updates


def train() -> Model:
    """Train the model."""
    model = new_model(CONTEXTS, 1)
    for title, plan, senses in explorations(RUNS, FIRST_SEED):
        model, updates = train_on(make_streams(plan), senses, model)
        print(f"{title}, {sum(len(message) for _, message in updates)} bytes", flush=True)
    return model


if __name__ == "__main__":
    np.savez_compressed(sys.argv[1], **packed(shortened(train())))  # type: ignore[arg-type]
