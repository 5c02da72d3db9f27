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
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from agent.predictive.history import History
from agent.predictive.mixer import Model, new_model
from agent.predictive.model_table import packed
from agent.predictive.scan_stream import NarrowBand, ScanStream
from agent.predictive.wall_model import CONTEXTS
from deploy.run.recording_bus import record_run
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse
from deploy.study.tile_table import shortened
from protocol import keys as names
from protocol.boxes import Box, bounding_box
from protocol.grid import UNKNOWN, ray_table
from protocol.messages import Sense, cells_from_bytes
from protocol.scans import draw
from worldsim.generators.seeds import check_training_seeds

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

STEPS = 400


def make_streams(
    plan: Plan, kind: Callable[..., ScanStream] = ScanStream, **options: Any
) -> list[ScanStream]:
    """Make the empty stream of each robot, with the limit `BYTES` of an update."""
    shape, bodies = plan.map.cells.shape, plan.world.bodies
    histories = [History() for _ in bodies]
    scratch = np.empty((2 * shape[0] * shape[1], 2), np.int32)
    beams = [ray_table(body.range_cells, plan.world.beams) for body in bodies]
    narrow = [NarrowBand(body.speed, BYTES) for body in bodies]
    return [
        kind(
            n, np.zeros(shape, np.uint8), beams[n], histories, scratch, team=True, narrow=narrow[n], **options
        )
        for n in range(len(bodies))
    ]


def train_on(
    streams: Sequence[ScanStream], senses: list[list[Sense]], model: Model
) -> tuple[Model, list[tuple[int, bytes]]]:
    """Encode an exploration with a model; return the model after the last update, and all updates with their robots.

    `streams` and `senses` are the empty stream and the sensor messages of each robot, one message per step.
    """
    robots, shape = len(senses), streams[0].grid.shape
    updates: list[tuple[int, bytes]] = []
    own = np.full((robots, *shape), UNKNOWN, np.uint8)
    poses: list[list[tuple[int, int]]] = [[] for _ in senses]
    boxes: list[list[Box]] = [[] for _ in senses]
    for step in range(max(map(len, senses))):
        for robot in range(robots):
            sense = senses[robot][step]
            readings = np.frombuffer(sense.readings, np.uint16).copy()
            beams = streams[robot].ray_table
            change = draw(own[robot], beams, sense.x, sense.y, readings, cells_from_bytes(sense.driven))
            if change.cells:
                poses[robot].append((sense.x, sense.y))
                boxes[robot].append(change.box)
            if not poses[robot] or (step + robot) % TURNS:
                continue
            stream, box = streams[robot], bounding_box(boxes[robot])
            stream.model = model
            encoded = stream.encode(own[robot], poses[robot], box)
            model = stream.model
            sent = len(poses[robot])
            if encoded is not None:
                stream.commit()
                updates.append((robot, encoded[0]))
                sent = encoded[2]
            del poses[robot][:sent]
            boxes[robot] = [box] if poses[robot] else []
    return model, updates


def explorations() -> Iterator[tuple[str, Plan, list[list[Sense]]]]:
    """Run the explorations of the training maps; yield a title, the plan, and the sensor messages of each robot."""
    check_training_seeds(range(FIRST_SEED, FIRST_SEED + len(MAPS)))
    for number, name in enumerate(MAPS):
        seed = FIRST_SEED + number
        settings = {
            "map": name, "map_seed": seed, "seed": seed, "robots": TURNS, "speed": 0.5, "steps": STEPS,
            "strategy": "meier", "map_encoding": "scans", "bandwidth": "unlimited", "bus": "memory",
        }  # fmt: skip
        plan = plans.make(parse(settings))
        senses = [bus.senses for bus in record_run(plan, list(map(names.robot, range(TURNS))))[0].values()]
        yield f"{number + 1:2} of {len(MAPS)} {name}", plan, senses


def train() -> Model:
    """Train the model."""
    model = new_model(CONTEXTS, 1)
    for title, plan, senses in explorations():
        model, updates = train_on(make_streams(plan), senses, model)
        print(f"{title}, {sum(len(message) for _, message in updates)} bytes", flush=True)
    return model


if __name__ == "__main__":
    np.savez_compressed(sys.argv[1], **packed(shortened(train())))  # type: ignore[arg-type]
