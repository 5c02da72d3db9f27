"""Benchmark of teams of many sizes: the same office, the same radio, more and more robots.

Robots send polygons at 1 kB a step, and predictive scans by gossip. Polygon packets can name 64 maps; larger teams send
targets only. Each size explores for some seconds on the memory bus, and with polygons also as processes on Zenoh.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from typing import Any

from agent.strategies import registry
from deploy.bench.explorations import office_plan
from deploy.bench.measurement import Measurement
from deploy.bench.observer import Observer
from deploy.record.records import RecorderNode
from deploy.run import launch
from deploy.run.in_memory import MemoryRun
from protocol.packets import MAX_MAPS

ROBOTS = (2, 4, 8, 16, 32, 64, 128, 256)
STRATEGIES = ("meier",)
MAX_PROCESSES = 64
"""Largest team that also runs as processes."""
MAX_STEPS = 400
MIN_STEPS = 4
ENOUGH_S = 8.0
"""Seconds after which a run ends, if it has made `MIN_STEPS`."""
SETTINGS = {"steps": MAX_STEPS, "bandwidth": 1000}
CONTENTS = {
    "polygons": {"map_encoding": "polygons"},
    "targets": {"map_encoding": "none"},
    "predictive": {"map_encoding": "predictive"},
}
SPEED, WORK = "speed", "processor time per robot and step"
MEMORY, TRANSMITTED = "memory per robot, proportional", "transmitted per step"


def scale(robots: Sequence[int] = ROBOTS, strategies: Sequence[str] = STRATEGIES) -> Iterator[Measurement]:
    """Measure the cost of a step by team size, relative to the smallest team; ValueError if a strategy is unknown."""
    for name in strategies:
        registry.strategy(name)
    for name in strategies:
        yield from _team_sizes(robots, name)


def _team_sizes(robots: Sequence[int], strategy: str) -> Iterator[Measurement]:
    smallest: dict[str, float] = {}
    for size in robots:
        maps = "polygons" if size <= MAX_MAPS else "targets"
        for content in (maps, "predictive"):
            observer = Observer()
            plan = office_plan(strategy, robots=size, bus="memory", **SETTINGS, **CONTENTS[content])
            records = MemoryRun(plan, io.BytesIO()).complete(observer.observe, heed=_stop_after(observer))
            name = f"{size} robots, {strategy}, {content}, memory"
            step_ms = observer.processor_ms_per_step
            work = step_ms / size
            reference = smallest.setdefault("polygons" if content == "targets" else content, work)
            yield Measurement(f"{name}: {SPEED}", "steps/s", 1000 / step_ms)
            yield Measurement(f"{name}: {WORK}", "ms", work, f"team of {robots[0]}", work / reference)
            transmitted = records.ledger()["bytes"][records.ledger()["carried"] == 1].sum()
            yield Measurement(f"{name}: {TRANSMITTED}", "bytes", transmitted / max(1, records.step))
        if size <= MAX_PROCESSES:
            yield from _processes(size, strategy, maps)


def _processes(size: int, strategy: str, content: str) -> Iterator[Measurement]:
    observer = Observer()
    plan = office_plan(strategy, robots=size, **SETTINGS, **CONTENTS[content])
    outcome = launch.run(plan, None, observer.observe, io.BytesIO(), heed=_stop_after(observer))
    if outcome.deaths:
        raise ConnectionError(f"the benchmark's swarm of {size} failed: {outcome.deaths}")
    name = f"{size} robots, {strategy}, {content}, Zenoh"
    yield Measurement(f"{name}: {SPEED}", "steps/s", observer.steps_per_s)
    if observer.memory_mb:
        yield Measurement(f"{name}: {MEMORY}", "MB", observer.memory_mb)


def _stop_after(observer: Observer) -> Any:
    """A callback that ends the run once the observer has enough samples."""

    def heed(recorder: RecorderNode) -> bool:
        if len(observer.samples) < 2 or recorder.records.end is not None:
            return False
        first, last = observer.samples[0], observer.samples[-1]
        enough = last.step - first.step >= MIN_STEPS and last.wall_s - first.wall_s > ENOUGH_S
        if enough:
            recorder.stop("measured long enough")
        return enough

    return heed
