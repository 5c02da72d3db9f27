"""Train the initial models of the predictive encoding's tiles on generated maps.

``python -m deploy.study.tile_table cells FILE.npz`` writes the model of tiles of cells to a file,
``python -m deploy.study.tile_table blocks FILE.npz`` that of tiles at half resolution.

The program runs explorations with noisy lasers, lets each robot map its scans again, and encodes these maps as the
predictive encoding does. A model passes from update to update, of all robots and runs. At the end it forgets how often
each context has occurred beyond `OLDEST_START`, so that a robot's own map soon outweighs the training. Exact tiles are
rare on narrow media, so the training of blocks begins with the shipped model of cells. The results are shipped as
`agent.predictive.tiles.TABLE` and `agent.predictive.block_tiles.TABLE`; encoder and decoder must have the same tables.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from agent.encodings.update_packets import FAIR_SHARE
from agent.mapping.block_bound import BlockBound
from agent.mapping.bound import Bound
from agent.mapping.estimator import SETTLED
from agent.mapping.mapper import make_mapper
from agent.predictive.block_tiles import untrained_model
from agent.predictive.history import History
from agent.predictive.mixer import Model, new_model
from agent.predictive.model_table import packed
from agent.predictive.narrow_tile_author import NarrowTileAuthor
from agent.predictive.tile_author import TileAuthor
from agent.predictive.tile_stream import BlockTileStream, TileStream
from agent.predictive.tiles import CONTEXTS, SETS
from agent.predictive.urgent_tile_author import UrgentTileAuthor
from deploy.scenario.plan import Plan
from deploy.study.starting_table import MAPS
from deploy.study.training import explorations
from protocol.grid import UNKNOWN
from protocol.messages import Sense

TEAMS = (3, 8)
SENSORS: tuple[dict[str, Any], ...] = (
    {"laser": {"preset": "utm-30lx"}, "pose": {"preset": "graph-slam"}},
    {"laser": {"preset": "rplidar-a1"}, "pose": {"preset": "particle-filter"}, "people": {"number": 3}},
)


@dataclass(frozen=True)
class Encoder:
    """How the robots of an exploration encode their maps."""

    author: type[TileAuthor]
    """Decides when tiles are encoded."""
    turns: int
    """Steps from one update of a robot to the next."""
    stream: type[TileStream] = TileStream
    most: float = FAIR_SHARE
    """Approximate limit of the bytes of an update."""


ENCODERS = {
    "cells": (Encoder(TileAuthor, 1), Encoder(UrgentTileAuthor, 3)),
    "blocks": (
        Encoder(NarrowTileAuthor, 16, BlockTileStream, 40),
        Encoder(NarrowTileAuthor, 16, BlockTileStream, 80),
    ),
}
"""Of cells: with an unlimited, and with a limited budget, as in a team of eight with 60 bytes per step. Of blocks: as
in a team of eight with 15 to 40 bytes per step."""

FIRST_SEED = 100
"""Seed of the first run. Experiments use the seeds below."""

STEPS = 300

OLDEST_START = 16
"""Bits that a context has seen at most, before the first one of a log."""

LEAST_SEEN = 2
"""Contexts that have seen fewer bits in training are left out."""


def train_on(plan: Plan, senses: list[list[Sense]], encoder: Encoder, model: Model) -> tuple[Model, int]:
    """Encode an exploration with a model; return the model after the last update, and the bytes of all updates.

    `senses` are the sensor messages of each robot, one per step.
    """
    robots, shape = len(senses), plan.map.cells.shape
    histories, size = [History() for _ in senses], 0
    scratch = np.empty((2 * shape[0] * shape[1], 2), np.int32)
    mappers = [make_mapper(plan.robot_settings[robot]) for robot in range(robots)]
    received = np.full(shape, UNKNOWN, np.uint8)
    bound = BlockBound if issubclass(encoder.stream, BlockTileStream) else Bound
    authors = [
        encoder.author(
            encoder.stream(robot, np.zeros(shape, np.uint8), histories, scratch, team=True),
            bound(plan.robot_settings[robot].encoding.tolerance, SETTLED),
        )
        for robot in range(robots)
    ]
    for step in range(max(map(len, senses))):
        for robot, (mapper, author) in enumerate(zip(mappers, authors, strict=True)):
            scan, change = mapper.add(senses[robot][step])
            author.add(scan, change)
            is_turn = (step + robot) % encoder.turns == 0
            if not (is_turn and author.is_due(mapper.states, mapper.log_odds, received)):
                continue
            author.stream.model = model
            encoded = author.encode(mapper.states, mapper.log_odds, encoder.most)
            model = author.stream.model
            if encoded is not None:
                author.stream.commit()
                received.reshape(-1)[encoded[1].places] = encoded[1].states
                size += len(encoded[0])
    return model, size


def train(model: Model, encoders: Sequence[Encoder]) -> Model:
    """Train a model, and return it shortened; each exploration is encoded once by each encoder."""
    runs = [
        {"map": name, "robots": robots, "steps": STEPS, **sensors}
        for name, robots, sensors in product(MAPS, TEAMS, SENSORS)
    ]
    for title, plan, senses in explorations(runs, FIRST_SEED):
        sizes = []
        for encoder in encoders:
            model, size = train_on(plan, senses, encoder, model)
            sizes.append(size)
        print(f"{title}, bytes {sizes}", flush=True)
    return shortened(model)


def shortened(model: Model) -> Model:
    """Return the model with which logs start: contexts adapt to a new building."""
    chances, ages, weights = model
    rare = ages < LEAST_SEEN
    return (
        np.where(rare, 1 << 15, chances).astype(np.uint16),
        np.where(rare, 0, np.minimum(ages, OLDEST_START)).astype(np.uint8),
        weights,
    )


if __name__ == "__main__":
    unit, file = sys.argv[1:]
    untrained = untrained_model() if unit == "blocks" else new_model(CONTEXTS, SETS)
    np.savez_compressed(file, **packed(train(untrained, ENCODERS[unit])))  # type: ignore[arg-type]
