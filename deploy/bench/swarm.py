"""Benches of whole swarms: 8 robots on 300 x 300 cells, against the bus with empty minds."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from deploy import launch
from deploy import plan as plans
from deploy.bench import Figure, compare
from deploy.bench.transcript import play, play_hub, play_lab, record
from deploy.family import Family
from deploy.plan import Plan
from deploy.records import Records
from deploy.scenario import Scenario
from protocol import keys as names
from worldsim import generators

ROBOTS = 8
STEPS = 150
REPEATS = 3
SIDE_M = 30.0

FLOOR = "bus with empty minds"


def bus() -> Iterator[Figure]:
    """The floor alone: how many steps a second the bus could carry if nobody had to think."""
    plan = _plan()
    speeds = [_floor(plan) for _ in range(REPEATS)]
    yield Figure(f"{FLOOR}, {ROBOTS} robots", "steps/s", float(np.median(speeds)))


def swarm() -> Iterator[Figure]:
    """The real thing against the floor, turn by turn; thinking time, memory and start as well."""
    plan = _plan()
    floors, speeds, works, starts, memories = [], [], [], [], []
    for _ in range(REPEATS):
        floors.append(_floor(plan))
        run = _Watched()
        outcome = _swarm(plan, run)
        speeds.append(run.speed(outcome))
        works.append(_median_work(outcome))
        starts.append(run.first_step_s)
        memories.append(run.memory_mb)
    yield Figure(f"{FLOOR}, {ROBOTS} robots", "steps/s", float(np.median(floors)))
    yield compare(f"swarm of {ROBOTS}", "steps/s", speeds, FLOOR, floors, "at least 0.50")
    yield Figure("work a robot and step, median", "ms", float(np.median(works)), aim="at most 1")
    yield Figure("start to first step", "s", float(np.median(starts)), aim="at most 2")
    if any(memories):
        yield Figure(
            "proportional memory a robot process", "MB", float(np.median(memories)), aim="at most 100"
        )


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
            self.memory_mb = _memory_of_robots()

    def speed(self, records: Records) -> float:
        """Steps a second between the first and the last look."""
        assert self._first is not None
        del records
        return (self._last[1] - self._first[1]) / (self._last[0] - self._first[0])


def _plan() -> Plan:
    scenario = Scenario(robots=ROBOTS, steps=STEPS)
    world_map = generators.make("office", width_m=SIDE_M, height_m=SIDE_M)
    return plans.make(scenario, world_map)


def _swarm(plan: Plan, run: _Watched) -> Records:
    with tempfile.TemporaryDirectory() as folder:
        outcome = launch.run(plan, Path(folder), run.look)
    if outcome.deaths:
        raise ConnectionError(f"the bench's swarm broke off: {outcome.deaths}")
    return outcome.records


def _floor(plan: Plan) -> float:
    """Steps a second with empty minds."""
    scripts, steps = record(plan)
    with tempfile.TemporaryDirectory() as folder, Family(Path(folder), plan.scenario.robots) as family:
        meeting = family.run, family.endpoint, family.credentials
        family.start(names.RELAY, play_hub, *meeting, len(scripts) - 1, scripts[names.RELAY])
        for name, script in scripts.items():
            if name not in (names.RELAY, names.LAB):
                family.start(name, play, family.credentials[name], script)
        seconds = play_lab(family.credentials[names.LAB], scripts[names.LAB], _alarmed(family))
    return steps / seconds


def _alarmed(family: Family) -> Callable[[], None]:
    """A check that does not let the laboratory wait for the dead."""

    def check() -> None:
        if family.look():
            raise ConnectionError(f"the bench's floor broke off: {family.deaths}")

    return check


def _median_work(records: Records) -> float:
    return float(np.median([m.work_us for reports in records.minds for m in reports])) / 1000


def _memory_of_robots() -> float:
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
