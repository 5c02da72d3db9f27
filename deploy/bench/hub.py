"""Benchmark for planning a run on several hosts: the work of each process per step, by team size.

The benchmark measures processor time of relay, world, recorder, robots and routers, and the bytes on the hub's
connections. It extrapolates what grows with the team to a planned team, on a straight line through the measured sizes.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from deploy.bench.measurement import Measurement
from deploy.bench.observer import Observer
from deploy.dashboard.windows import LOOPBACK
from deploy.record.records import Records
from deploy.run import launch
from deploy.run.rendezvous import Rendezvous, by_certificates, on_loopback
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from protocol import keys as names
from worldsim import generators

STEPS = 120
SIDE_M = 30.0
TEAMS = (4, 8, 16, 32)
ROBOTS_PER_ROUTER = 8
PLANNED_ROBOTS, PLANNED_HOSTS = 1000, 50
MAIN_THREAD = "relay, main thread"
"""The Python thread of the relay; its other threads belong to Zenoh."""
ROBOT, ROUTER, HUB_BYTES = "robot", "router", "bytes at the hub"
CERTIFICATES, ROUTERS = "certificates", f"routers of {ROBOTS_PER_ROUTER}"


def hub() -> Iterator[Measurement]:
    """Measure the work per step by team size and by connection type; then extrapolate to the planned team."""
    measured: dict[str, dict[str, list[float]]] = {}
    for robots in TEAMS:
        plan = _plan(robots)
        for connection, rendezvous in _connections(robots).items():
            for process, spent in _by_kind(_run(plan, rendezvous), robots).items():
                measured.setdefault(connection, {}).setdefault(process, []).append(spent)
                name = f"{robots} robots, {connection}: {process}, per step"
                yield Measurement(name, _unit(process), spent)
    for connection in (CERTIFICATES, ROUTERS):
        name = f"{PLANNED_ROBOTS} robots on {PLANNED_HOSTS} hosts, {connection}"
        yield from _extrapolated(measured[connection], name)


def _extrapolated(measured: dict[str, list[float]], name: str) -> Iterator[Measurement]:
    """The work of a step with the planned team, and the number of steps per second that it permits."""
    per_host = PLANNED_ROBOTS // PLANNED_HOSTS
    for process, spent in measured.items():
        if process == ROUTER:
            work, of = per_host * spent[-1] / ROBOTS_PER_ROUTER, f"a host's router, of {per_host} robots"
        elif process == ROBOT:
            work, of = per_host * spent[-1], f"a host's {per_host} robots, on one core"
        else:
            slope, start = np.polyfit(TEAMS, spent, 1)
            work, of = start + slope * PLANNED_ROBOTS, process
        yield Measurement(f"{name}: {of}, per step", _unit(process), work)
        if process != HUB_BYTES:
            yield Measurement(f"{name}: {of}, alone", "steps/s", 1000 / work)


def _connections(robots: int) -> dict[str, Rendezvous]:
    """How robots join: by passwords on the loopback, by certificates, or by certificates through routers."""
    all_robots = list(map(names.robot, range(robots)))
    groups = [all_robots[first : first + ROBOTS_PER_ROUTER] for first in range(0, robots, ROBOTS_PER_ROUTER)]
    routers = {names.router(f"h{number}"): group for number, group in enumerate(groups)}
    return {
        "passwords": on_loopback(robots),
        CERTIFICATES: by_certificates(LOOPBACK, None, robots),
        ROUTERS: by_certificates(LOOPBACK, None, robots, routers),
    }


def _by_kind(spent: dict[str, float], robots: int) -> dict[str, float]:
    """The work of each kind of process; the mean for robots and routers."""
    kinds = {name: spent[name] for name in (names.RELAY, MAIN_THREAD, names.WORLD, names.RECORDER)}
    kinds[ROBOT] = float(np.mean([spent[name] for name in map(names.robot, range(robots)) if name in spent]))
    routers = [ms for name, ms in spent.items() if name.startswith(names.ROUTER)]
    if routers:
        kinds[ROUTER] = float(np.mean(routers))
    return kinds | {HUB_BYTES: spent[HUB_BYTES]}


def _unit(process: str) -> str:
    return "bytes" if process == HUB_BYTES else "ms"


def _run(plan: Plan, rendezvous: Rendezvous) -> dict[str, float]:
    """Run the plan; return the growth of processor time and hub bytes per step."""
    moved: list[float] = [0.0]
    observer = Observer(lambda: processor_ms() | {HUB_BYTES: moved[0]})

    def observe(records: Records) -> None:
        moved[0] = float(records.wire_bytes or 0)
        if records.step < plan.scenario.steps:  # at the end robots send their maps
            observer.observe(records)

    outcome = launch.run(plan, None, observe, rendezvous=rendezvous)
    if outcome.deaths:
        raise ConnectionError(f"the benchmark's swarm failed: {outcome.deaths}")
    return observer.per_step


def _plan(robots: int) -> Plan:
    scenario = Scenario(robots=robots, steps=STEPS, strategy="meier", map_encoding="polygons", bandwidth=1000)
    return plans.make(scenario, generators.make("office", width_m=SIDE_M, height_m=SIDE_M))


def processor_ms() -> dict[str, float]:
    """Processor time in milliseconds of this run's processes, by name, and of the relay's main thread; Linux only.

    This process is the recorder.
    """
    parents: dict[int, int] = {}
    spent: dict[int, tuple[str, float]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            pid, (parents[pid], ms) = int(folder.name), _stat(folder)
            title = (folder / "cmdline").read_bytes().split(b"\0")[0].decode().split()
        except OSError:
            continue
        if len(title) == 2 and title[0] == "murmur":
            spent[pid] = title[1], ms
    times = {names.RECORDER: 1000 * time.process_time()}
    for pid, (name, ms) in spent.items():
        if parents.get(parents[pid]) == os.getpid():  # the fork server stands between
            times[name] = ms
            if name == names.RELAY:
                with contextlib.suppress(OSError):
                    times[MAIN_THREAD] = _stat(Path(f"/proc/{pid}/task/{pid}"))[1]
    return times


def _stat(folder: Path) -> tuple[int, float]:
    """Parent, and processor time in milliseconds, of a process or thread."""
    fields = (folder / "stat").read_text().rpartition(")")[2].split()
    return int(fields[1]), 1000 * (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
