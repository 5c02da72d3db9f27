"""Bench of teams of many sizes: the same office, the same radio, more and more robots.

Robots tell each other polygons at 1 kB a step, and looks by gossip; beyond the 64 maps that packets of polygons can
name they tell each other targets only. Each size explores for a while on the bus in memory, and with polygons as
processes on Zenoh as well.
"""

from __future__ import annotations

import io
import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from deploy.bench.ratios import Figure
from deploy.bench.swarm import memory_of_robots
from deploy.record.records import RecorderNode, Records
from deploy.run import in_memory, launch
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from netshaper.ledger import ROW
from protocol.packets import MAX_MAPS
from worldsim import generators

ROBOTS = (2, 4, 8, 16, 32, 64, 128, 256)
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
POLYGONS, TARGETS, PREDICTIVE = "polygons", "targets", "looks by gossip"
RADIOS = {
    POLYGONS: {"map_encoding": "polygons"},
    TARGETS: {"map_encoding": "none"},
    PREDICTIVE: {"map_encoding": "predictive", "dissemination": "gossip"},
}
WORK, MEMORY = "processor time a robot and step", "memory a robot, proportional"
CORE = "speed on a core of its own"
"""Which is the speed in memory where nothing else runs."""
AIR, BUS = "on the air a step", "moved by the bus a step"


def scale(robots: Sequence[int] = ROBOTS) -> Iterator[Figure]:
    """What a step costs with teams of these sizes, against the smallest of them."""
    first: dict[str, float] = {}
    for size in robots:
        maps = POLYGONS if size <= MAX_MAPS else TARGETS
        for radio in (maps, PREDICTIVE):
            run = _Measured()
            records = in_memory.run(_plan(size, radio, "memory"), run.look, io.BytesIO(), heed=run.heed)
            what = f"{size} robots, {radio}, memory"
            work = run.work_ms / size
            smallest = first.setdefault(POLYGONS if radio == TARGETS else radio, work)
            yield Figure(f"{what}: speed", "steps/s", run.speed)
            yield Figure(f"{what}: {CORE}", "steps/s", 1000 / run.work_ms)
            yard = f"that of {robots[0]}"
            yield Figure(f"{what}: {WORK}", "ms", work, yard, work / smallest)
            if run.megabytes:
                yield Figure(f"{what}: memory a robot", "MB", run.megabytes / size)
            yield Figure(f"{what}: {AIR}", "bytes", _carried(records) / max(1, records.step))
        if size <= PROCESSES:
            yield from _processes(size, maps)


def _processes(size: int, radio: str) -> Iterator[Figure]:
    run = _Measured(proportional=True)
    outcome = launch.run(_plan(size, radio, "zenoh"), None, run.look, io.BytesIO(), heed=run.heed)
    if outcome.deaths:
        raise ConnectionError(f"the bench's swarm of {size} broke off: {outcome.deaths}")
    what = f"{size} robots, {radio}, Zenoh"
    yield Figure(f"{what}: speed", "steps/s", run.speed)
    if run.megabytes:
        yield Figure(f"{what}: {MEMORY}", "MB", run.megabytes, aim="at most 40")
    moved = outcome.records.wire_bytes
    if moved is not None:
        yield Figure(f"{what}: {BUS}", "bytes", moved / max(1, outcome.records.step))


def draw(figures: Sequence[dict[str, Any]], file: Path) -> None:
    """Draw what `scale` measured, as `run_benches` returns it, against the size of the team."""
    from matplotlib.figure import Figure as Drawing  # noqa: PLC0415  slow to import

    series: dict[str, dict[tuple[str, str], list[tuple[int, float]]]] = {}
    for figure in figures:
        parts = re.fullmatch(r"(\d+) robots, (.*), (memory|Zenoh): (.*)", figure["name"])
        if parts is not None:
            size, radio, bus, what = parts.groups()
            if (bus, what) == ("memory", "speed"):
                continue  # how busy the machine was
            panel = series.setdefault({BUS: AIR, CORE: "speed"}.get(what, what), {})
            panel.setdefault(_line(radio, bus, what), []).append((int(size), figure["value"]))
    panels = {
        "speed": "steps a second",
        WORK: f"ms of {WORK}",
        MEMORY: "MB a robot's process",
        AIR: "bytes a step",
    }
    drawing = Drawing((10, 7), layout="constrained")
    for axes, (what, label) in zip(drawing.subplots(2, 2).flat, panels.items(), strict=True):
        for (line, color), points in series.get(what, {}).items():
            axes.plot(*zip(*points, strict=True), "o-", color=color, label=line)
        axes.set(xscale="log", yscale="linear" if what == MEMORY else "log", xlabel="robots", ylabel=label)
        axes.set_xticks(ROBOTS, [str(size) for size in ROBOTS])
        axes.minorticks_off()
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_ylim(bottom=0 if what == MEMORY else None)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(visible=True, color="#e6e6e6")
        if series.get(what):
            axes.legend(frameon=False)
    drawing.savefig(file, dpi=110)


def _line(radio: str, bus: str, what: str) -> tuple[str, str]:
    """Name and colour of the line that a figure belongs to."""
    if what == BUS:
        return "moved by the bus", "#c06a2b"
    if bus == "Zenoh":
        return f"{radio}, as processes", "#c06a2b"
    return (
        (PREDICTIVE, "#4f8a5b")
        if radio == PREDICTIVE
        else (f"{POLYGONS} to {MAX_MAPS}, then {TARGETS}", "#2f5f95")
    )


def _plan(size: int, radio: str, bus: Literal["memory", "zenoh"]) -> Plan:
    settings = RADIOS[radio]
    scenario = Scenario.model_validate(
        {"robots": size, "steps": STEPS, "strategy": "meier", "bandwidth": BUDGET, "bus": bus} | settings
    )
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

    def heed(self, recorder: RecorderNode) -> bool:
        """End the run once it has been measured well enough."""
        if len(self._looks) < 2 or recorder.records.end is not None:
            return False
        first, last = self._looks[0], self._looks[-1]
        enough = last.step - first.step >= FEWEST and last.wall_s - first.wall_s > ENOUGH_S
        if enough:
            recorder.stop("measured well enough")
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
