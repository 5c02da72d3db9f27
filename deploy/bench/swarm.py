"""Benchmark of whole swarms: 8 robots on 300 x 300 cells, compared with the same run in one process."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from deploy.bench.explorations import office_plan
from deploy.bench.measurement import Measurement, compare
from deploy.bench.observer import Observer
from deploy.record.summary import median_work
from deploy.run import launch
from deploy.run.in_memory import MemoryRun

ROBOTS = 8
STEPS = 150
REPEATS = 3

IN_MEMORY = "the same run in one process"

CASES: tuple[dict[str, Any], ...] = (
    {"map_encoding": "scans", "bandwidth": "unlimited"},
    {"map_encoding": "polygons", "bandwidth": 1000},
    {"map_encoding": "predictive", "bandwidth": "unlimited"},
)


def swarm() -> Iterator[Measurement]:
    """Alternate runs in one process and as processes; measure speed, computing time, memory and start-up."""
    for case in CASES:
        plan = office_plan(robots=ROBOTS, steps=STEPS, **case)
        in_one, runs = [], []
        for _ in range(REPEATS):
            in_one.append(Observer())
            records = MemoryRun(plan).complete(in_one[-1].observe)
            runs.append(Observer())
            outcome = launch.run(plan, None, runs[-1].observe)
            if outcome.deaths:
                raise ConnectionError(f"the benchmark's swarm failed: {outcome.deaths}")
        name = f"swarm of {ROBOTS}, {case['map_encoding']}"
        references = [run.steps_per_s for run in in_one]
        yield Measurement(f"{name}: {IN_MEMORY}", "steps/s", float(np.median(references)))
        yield compare(name, "steps/s", [run.steps_per_s for run in runs], IN_MEMORY, references)
        yield Measurement(f"{name}: work per robot and step", "ms", (median_work(records) or 0.0) / 1000)
        start = float(np.median([run.first_step_s for run in runs]))
        yield Measurement(f"{name}: start to first step", "s", start)
        if memory := float(np.median([run.memory_mb for run in runs])):
            yield Measurement(f"{name}: memory per robot, proportional", "MB", memory)
