"""Benchmark of whole swarms: 8 robots on 300 x 300 cells, compared with the replay of their messages."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from deploy.bench.measurement import Measurement, compare
from deploy.bench.observer import Observer
from deploy.bench.transcript import record, replay
from deploy.record.records import Records
from deploy.run import launch
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from worldsim import generators

ROBOTS = 8
STEPS = 150
REPEATS = 3
SIDE_M = 30.0

REPLAY = "replay of its messages"


@dataclass(frozen=True)
class Case:
    """A swarm to measure, and its target values."""

    map_encoding: str
    bandwidth: int | Literal["unlimited"]
    target_speed: str
    target_work: str
    dissemination: str = "backoff"


CASES = (
    Case("scans", "unlimited", "at least 0.50", "at most 1"),
    Case("polygons", 1000, "at least 0.33", "at most 2"),
    Case("predictive", "unlimited", "at least 0.33", "at most 1 more than scans", "gossip"),
)


def swarm() -> Iterator[Measurement]:
    """Alternate swarm and replay; measure speed, computing time, memory and start-up."""
    for case in CASES:
        plan = plan_of(case)
        scripts, records = record(plan)
        replays, speeds, starts, memories = [], [], [], []
        for _ in range(REPEATS):
            replays.append(records.step / replay(plan, scripts))
            run = Observer(processes=True)
            outcome = launch.run(plan, None, run.observe)
            if outcome.deaths:
                raise ConnectionError(f"the benchmark's swarm failed: {outcome.deaths}")
            speeds.append(run.steps_per_s)
            starts.append(run.first_step_s)
            memories.append(run.memory_mb)
        name = f"swarm of {ROBOTS}, {case.map_encoding}"
        yield Measurement(f"{name}: {REPLAY}", "steps/s", float(np.median(replays)))
        yield compare(name, "steps/s", speeds, REPLAY, replays, case.target_speed)
        yield Measurement(
            f"{name}: work per robot and step", "ms", _median_work_ms(records), target=case.target_work
        )
        yield Measurement(f"{name}: start to first step", "s", float(np.median(starts)), target="at most 2")
        if any(memories):
            megabytes = float(np.median(memories))
            yield Measurement(
                f"{name}: memory per robot, proportional", "MB", megabytes, target="at most 100"
            )


def plan_of(case: Case) -> Plan:
    """The run of a case: an office of 300 x 300 cells."""
    scenario = Scenario(
        robots=ROBOTS,
        steps=STEPS,
        strategy="meier",
        map_encoding=case.map_encoding,
        bandwidth=case.bandwidth,
        dissemination=case.dissemination,
    )
    return plans.make(scenario, generators.make("office", width_m=SIDE_M, height_m=SIDE_M))


def _median_work_ms(records: Records) -> float:
    """Median computing time per robot and step in milliseconds, from a run in one process."""
    return float(np.median([m.work_us for reports in records.statuses for m in reports])) / 1000
