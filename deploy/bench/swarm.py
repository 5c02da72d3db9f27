"""Benches of whole swarms: 8 robots on 300 x 300 cells, against the bus with participants that compute nothing."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from deploy.bench.ratios import Figure, compare
from deploy.bench.transcript import Script, play, play_hub, play_recorder, record
from deploy.record.records import Records
from deploy.run import launch
from deploy.run.process_table import ProcessTable
from deploy.run.rendezvous import on_loopback
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from protocol import keys as names
from worldsim import generators

ROBOTS = 8
STEPS = 150
REPEATS = 3
SIDE_M = 30.0

FLOOR = "bus with empty minds"


@dataclass(frozen=True)
class Case:
    """A swarm to measure, and its target value."""

    map_encoding: str
    bandwidth: int | Literal["unlimited"]
    aim_speed: str
    aim_work: str
    dissemination: str = "backoff"


CASES = (
    Case("scans", "unlimited", "at least 0.50", "at most 1"),
    Case("polygons", 1000, "at least 0.33", "at most 2"),
    Case("predictive", "unlimited", "at least 0.33", "at most 1 more than with laser", "gossip"),
)


def bus() -> Iterator[Figure]:
    """The floor alone: the steps a second that the bus could carry if no participant computed anything."""
    for case in CASES:
        plan = plan_of(case)
        scripts, records = record(plan)
        speeds = [_floor(plan, scripts, records.step) for _ in range(REPEATS)]
        yield Figure(f"{FLOOR}, {ROBOTS} robots, {case.map_encoding}", "steps/s", float(np.median(speeds)))


def swarm() -> Iterator[Figure]:
    """The real swarm against the floor, alternating; computing time, memory and start-up as well."""
    for case in CASES:
        plan = plan_of(case)
        scripts, records = record(plan)
        floors, speeds, starts, memories = [], [], [], []
        for _ in range(REPEATS):
            floors.append(_floor(plan, scripts, records.step))
            run = _Watched()
            _swarm(plan, run)
            speeds.append(run.speed())
            starts.append(run.first_step_s)
            memories.append(run.memory_mb)
        what = f"swarm of {ROBOTS}, {case.map_encoding}"
        yield Figure(f"{FLOOR}, {ROBOTS} robots, {case.map_encoding}", "steps/s", float(np.median(floors)))
        yield compare(what, "steps/s", speeds, FLOOR, floors, case.aim_speed)
        yield Figure(f"{what}: work a robot and step", "ms", _median_work(records), aim=case.aim_work)
        yield Figure(f"{what}: start to first step", "s", float(np.median(starts)), aim="at most 2")
        if any(memories):
            megabytes = float(np.median(memories))
            yield Figure(f"{what}: memory a robot, proportional", "MB", megabytes, aim="at most 100")


class _Watched:
    """What is measured from outside while a swarm runs."""

    def __init__(self) -> None:
        self.began = time.perf_counter()
        self.first_step_s = 0.0
        self.memory_mb = 0.0
        self._first: tuple[float, int] | None = None
        self._last: tuple[float, int] = (0.0, 0)

    def look(self, records: Records) -> None:
        now = time.perf_counter()
        if not records.step:
            return
        if self._first is None:
            self.first_step_s = now - self.began
            self._first = now, records.step
        self._last = now, records.step
        if not self.memory_mb:
            self.memory_mb = memory_of_robots()

    def speed(self) -> float:
        """Steps a second between the first and the last look."""
        if self._first is None or self._last == self._first:
            raise ConnectionError("the bench's swarm was over before it could be measured")
        return (self._last[1] - self._first[1]) / (self._last[0] - self._first[0])


def plan_of(case: Case) -> Plan:
    """The run of a case: eight robots in an office of 300 x 300 cells."""
    scenario = Scenario(
        robots=ROBOTS,
        steps=STEPS,
        strategy="meier",
        map_encoding=case.map_encoding,
        bandwidth=case.bandwidth,
        dissemination=case.dissemination,
    )
    return plans.make(scenario, generators.make("office", width_m=SIDE_M, height_m=SIDE_M))


def _swarm(plan: Plan, run: _Watched) -> None:
    outcome = launch.run(plan, None, run.look)
    if outcome.deaths:
        raise ConnectionError(f"the bench's swarm broke off: {outcome.deaths}")


def _floor(plan: Plan, scripts: dict[str, Script], steps: int) -> float:
    """Steps a second with participants that compute nothing."""
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessTable(Path(folder)) as processes,
    ):
        rendezvous = on_loopback(plan.scenario.robots)
        where = rendezvous.run, rendezvous.endpoint, rendezvous.credentials
        processes.start(names.RELAY, play_hub, *where, len(scripts) - 1, scripts[names.RELAY])
        for name, script in scripts.items():
            if name not in (names.RELAY, names.RECORDER):
                processes.start(name, play, rendezvous.credentials[name], script)
        seconds = play_recorder(
            rendezvous.credentials[names.RECORDER], scripts[names.RECORDER], _alarmed(processes)
        )
    return steps / seconds


def _alarmed(processes: ProcessTable) -> Callable[[], None]:
    """A check that keeps the laboratory from waiting for dead processes."""

    def check() -> None:
        if processes.look():
            raise ConnectionError(f"the bench's floor broke off: {processes.deaths}")

    return check


def _median_work(records: Records) -> float:
    """Median computing time per robot and step in milliseconds, of a run in one process, on one core."""
    return float(np.median([m.work_us for reports in records.statuses for m in reports])) / 1000


def memory_of_robots() -> float:
    """Median proportional set size of the robots' processes in MB; 0 where the system does not tell."""
    sizes = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            title = (folder / "cmdline").read_bytes()
            if title.startswith(b"murmur r") and title[8:9].isdigit():
                lines = (folder / "smaps_rollup").read_text().splitlines()
                sizes += [int(line.split()[1]) / 1000 for line in lines if line.startswith("Pss:")]
        except OSError:
            continue
    return float(np.median(sizes)) if sizes else 0.0
