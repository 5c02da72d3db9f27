"""Bench of teams of many sizes: the same office, the same radio, more and more robots.

Robots tell each other polygons at 1 kB a step; beyond the 64 maps that packets can name they tell each other targets
only. Each size explores for a while on the bus in memory, and up to 64 robots as processes on Zenoh as well.
"""

from __future__ import annotations

import io
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from deploy.bench.ratios import Figure
from deploy.bench.swarm import memory_of_robots
from deploy.record.records import LabNode, Records
from deploy.run import in_memory, launch
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from netshaper.ledger import ROW
from protocol.packets import MAX_MAPS
from worldsim import generators

ROBOTS = (2, 4, 8, 16, 32, 64)
PROCESSES = 64
"""Robots that are also run as processes at most."""
STEPS = 400
"""Steps at most: small teams make hundreds a second."""
ENOUGH_S = 8.0
"""Seconds after which a size has been measured well enough, however few steps that were."""
FEWEST = 4
"""Steps that are measured all the same."""
SIDE_M = 30.0
BUDGET = 1000


def scale(robots: Sequence[int] = ROBOTS) -> Iterator[Figure]:
    """What a step costs with teams of these sizes, against the smallest of them."""
    first: float | None = None
    for size in robots:
        run = _Measured()
        records = in_memory.run(_plan(size, "memory"), run.look, io.BytesIO(), heed=run.heed)
        what = f"{size} robots, memory"
        work = run.work_ms / size
        first = work if first is None else first
        yield Figure(f"{what}: speed", "steps/s", run.speed)
        smallest = f"that of {robots[0]}"
        yield Figure(f"{what}: processor time a robot and step", "ms", work, smallest, work / first)
        if run.megabytes:
            yield Figure(f"{what}: memory a robot", "MB", run.megabytes / size)
        yield Figure(f"{what}: on the air a step", "bytes", _carried(records) / max(1, records.step))
        if size <= PROCESSES:
            yield from _processes(size)


def _processes(size: int) -> Iterator[Figure]:
    run = _Measured(proportional=True)
    outcome = launch.run(_plan(size, "zenoh"), None, run.look, io.BytesIO(), heed=run.heed)
    if outcome.deaths:
        raise ConnectionError(f"the bench's swarm of {size} broke off: {outcome.deaths}")
    what = f"{size} robots, Zenoh"
    yield Figure(f"{what}: speed", "steps/s", run.speed)
    if run.megabytes:
        yield Figure(f"{what}: memory a robot, proportional", "MB", run.megabytes, aim="at most 40")
    moved = outcome.records.wire_bytes
    if moved is not None:
        yield Figure(f"{what}: moved by the bus a step", "bytes", moved / max(1, outcome.records.step))


def _plan(size: int, bus: Literal["memory", "zenoh"]) -> Plan:
    exchange = "polygon" if size <= MAX_MAPS else "none"
    scenario = Scenario(robots=size, steps=STEPS, exchange=exchange, bandwidth=BUDGET, bus=bus)
    return plans.make(scenario, generators.make("office", width_m=SIDE_M, height_m=SIDE_M))


@dataclass(frozen=True)
class _Look:
    """When a step had been reached."""

    step: int
    wall_s: float
    processor_s: float


class _Measured:
    """What is measured of one run, between the first look at it and the last.

    `proportional`: memory is that of the robots' processes, in the median; else what this one has grown by.
    """

    def __init__(self, *, proportional: bool = False) -> None:
        self.megabytes = 0.0
        self._proportional = proportional
        self._before = _resident_mb()
        self._looks: list[_Look] = []

    def look(self, records: Records) -> None:
        """Note how far the run is."""
        if not records.step:
            return
        self._looks.append(_Look(records.step, time.perf_counter(), time.process_time()))
        if not self._proportional:
            self.megabytes = max(self.megabytes, _resident_mb() - self._before)
        elif not self.megabytes:
            self.megabytes = memory_of_robots()

    def heed(self, lab: LabNode) -> bool:
        """End the run once it has been measured well enough."""
        if len(self._looks) < 2 or lab.records.end is not None:
            return False
        first, last = self._looks[0], self._looks[-1]
        enough = last.step - first.step >= FEWEST and last.wall_s - first.wall_s > ENOUGH_S
        if enough:
            lab.stop("measured well enough")
        return enough

    @property
    def speed(self) -> float:
        """Steps a second."""
        first, last = self._span()
        return (last.step - first.step) / (last.wall_s - first.wall_s)

    @property
    def work_ms(self) -> float:
        """Milliseconds of this process' processor time a step."""
        first, last = self._span()
        return 1000 * (last.processor_s - first.processor_s) / (last.step - first.step)

    def _span(self) -> tuple[_Look, _Look]:
        first, last = self._looks[0], self._looks[-1]
        if first.step == last.step:
            raise ConnectionError("the bench's run was over before it could be measured")
        return first, last


def _carried(records: Records) -> int:
    """Bytes that were on the air."""
    rows = records.ledger()
    assert rows.dtype == ROW
    return int(rows["bytes"][rows["carried"] == 1].sum())


def _resident_mb() -> float:
    """Megabytes of memory that this process has; 0 where the system does not tell."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1000 for line in lines if line.startswith("VmRSS:")), 0.0)
