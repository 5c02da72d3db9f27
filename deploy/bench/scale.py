"""Benchmark of teams of many sizes: the same office, the same radio, more and more robots.

Robots send polygons at 1 kB a step, and predictive scans by gossip. Polygon packets can name 64 maps; larger teams send
targets only. Each size explores for some seconds on the memory bus, and with polygons also as processes on Zenoh.
"""

from __future__ import annotations

import io
import re
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

from deploy.bench.measurement import Measurement
from deploy.bench.observer import Observer
from deploy.record.records import RecorderNode, Records
from deploy.run import in_memory, launch
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from protocol.packets import MAX_MAPS
from worldsim import generators

ROBOTS = (2, 4, 8, 16, 32, 64, 128, 256)
MAX_PROCESSES = 64
"""Largest team that also runs as processes."""
MAX_STEPS = 400
MIN_STEPS = 4
ENOUGH_S = 8.0
"""Seconds after which a run ends, if it has made `MIN_STEPS`."""
SIDE_M = 30.0
BUDGET = 1000
POLYGONS, TARGETS, PREDICTIVE = "polygons", "targets", "predictive by gossip"
CONTENTS = {
    POLYGONS: {"map_encoding": "polygons"},
    TARGETS: {"map_encoding": "none"},
    PREDICTIVE: {"map_encoding": "predictive", "dissemination": "gossip"},
}
WORK, MEMORY = "processor time per robot and step", "memory per robot, proportional"
CORE = "speed on a core of its own"
"""Speed in memory on a machine without other load."""
AIR, BUS = "transmitted per step", "moved by the bus per step"


def scale(robots: Sequence[int] = ROBOTS) -> Iterator[Measurement]:
    """Measure the cost of a step for teams of these sizes, relative to the smallest team."""
    smallest: dict[str, float] = {}
    for size in robots:
        maps = POLYGONS if size <= MAX_MAPS else TARGETS
        for content in (maps, PREDICTIVE):
            before = _resident_mb()
            observer = Observer(_own_counters)
            plan = _plan(size, content, "memory")
            records = in_memory.run(plan, observer.observe, io.BytesIO(), heed=_stop_after(observer))
            name = f"{size} robots, {content}, memory"
            step_ms = observer.per_step["ms"]
            work = step_ms / size
            reference = smallest.setdefault(POLYGONS if content == TARGETS else content, work)
            yield Measurement(f"{name}: speed", "steps/s", observer.steps_per_s)
            yield Measurement(f"{name}: {CORE}", "steps/s", 1000 / step_ms)
            yield Measurement(f"{name}: {WORK}", "ms", work, f"team of {robots[0]}", work / reference)
            growth = max(sample.counters["resident_mb"] for sample in observer.samples) - before
            if growth > 0:
                yield Measurement(f"{name}: memory per robot", "MB", growth / size)
            yield Measurement(f"{name}: {AIR}", "bytes", _transmitted(records) / max(1, records.step))
        if size <= MAX_PROCESSES:
            yield from _processes(size, maps)


def _processes(size: int, content: str) -> Iterator[Measurement]:
    observer = Observer(processes=True)
    plan = _plan(size, content, "zenoh")
    outcome = launch.run(plan, None, observer.observe, io.BytesIO(), heed=_stop_after(observer))
    if outcome.deaths:
        raise ConnectionError(f"the benchmark's swarm of {size} failed: {outcome.deaths}")
    name = f"{size} robots, {content}, Zenoh"
    yield Measurement(f"{name}: speed", "steps/s", observer.steps_per_s)
    if observer.memory_mb:
        yield Measurement(f"{name}: {MEMORY}", "MB", observer.memory_mb, target="at most 40")
    moved = outcome.records.wire_bytes
    if moved is not None:
        yield Measurement(f"{name}: {BUS}", "bytes", moved / max(1, outcome.records.step))


def draw(measurements: Sequence[dict[str, Any]], file: Path) -> None:
    """Draw measurements of `scale`, as `run_benchmarks` returns them, over the size of the team."""
    from matplotlib.figure import Figure  # noqa: PLC0415  slow to import

    series: dict[str, dict[tuple[str, str], list[tuple[int, float]]]] = {}
    for measurement in measurements:
        parts = re.fullmatch(r"(\d+) robots, (.*), (memory|Zenoh): (.*)", measurement["name"])
        if parts is None:
            continue
        size, content, bus, quantity = parts.groups()
        if (bus, quantity) == ("memory", "speed"):
            continue  # it depends on the other load of the machine
        panel = series.setdefault({BUS: AIR, CORE: "speed"}.get(quantity, quantity), {})
        panel.setdefault(_line(content, bus, quantity), []).append((int(size), measurement["value"]))
    panels = {
        "speed": "steps a second",
        WORK: f"ms of {WORK}",
        MEMORY: "MB per robot's process",
        AIR: "bytes a step",
    }
    figure = Figure((10, 7), layout="constrained")
    for axes, (quantity, label) in zip(figure.subplots(2, 2).flat, panels.items(), strict=True):
        for (line, color), points in series.get(quantity, {}).items():
            axes.plot(*zip(*points, strict=True), "o-", color=color, label=line)
        linear = quantity == MEMORY
        axes.set(xscale="log", yscale="linear" if linear else "log", xlabel="robots", ylabel=label)
        axes.set_xticks(ROBOTS, [str(size) for size in ROBOTS])
        axes.minorticks_off()
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_ylim(bottom=0 if linear else None)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(visible=True, color="#e6e6e6")
        if series.get(quantity):
            axes.legend(frameon=False)
    figure.savefig(file, dpi=110)


def _line(content: str, bus: str, quantity: str) -> tuple[str, str]:
    """Name and color of the line that a measurement belongs to."""
    if quantity == BUS:
        return "moved by the bus", "#c06a2b"
    if bus == "Zenoh":
        return f"{content}, as processes", "#c06a2b"
    if content == PREDICTIVE:
        return PREDICTIVE, "#4f8a5b"
    return f"{POLYGONS} to {MAX_MAPS}, then {TARGETS}", "#2f5f95"


def _plan(size: int, content: str, bus: Literal["memory", "zenoh"]) -> Plan:
    settings = {"robots": size, "steps": MAX_STEPS, "strategy": "meier", "bandwidth": BUDGET, "bus": bus}
    scenario = Scenario.model_validate(settings | CONTENTS[content])
    return plans.make(scenario, generators.make("office", width_m=SIDE_M, height_m=SIDE_M))


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


def _own_counters() -> dict[str, float]:
    """Processor time and memory of this process."""
    return {"ms": 1000 * time.process_time(), "resident_mb": _resident_mb()}


def _transmitted(records: Records) -> int:
    """Bytes transmitted during the run."""
    rows = records.ledger()
    return int(rows["bytes"][rows["carried"] == 1].sum())


def _resident_mb() -> float:
    """Memory of this process in megabytes; 0 if the system does not report it."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1000 for line in lines if line.startswith("VmRSS:")), 0.0)
