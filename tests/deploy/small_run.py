"""A small run, shared by the tests of the dashboard, pictures and exports."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from PIL import Image

from deploy.after.archive import read
from deploy.after.figures import write_figures
from deploy.dashboard.process import ViewNode
from deploy.record import run_directory
from deploy.run.exploration import explore
from deploy.run.in_memory import MemoryRun
from deploy.run.result import Result
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse

SETTINGS = {
    "map": "office", "robots": 3, "map_encoding": "polygons", "strategy": "meier", "range": "30%", "steps": 40,
    "bus": "memory",
}  # fmt: skip


def hall(picture: Path, height: int, width: int) -> dict[str, object]:
    """Draw a hall of so many cells, and return the settings of a run there."""
    cells = np.zeros((height, width), np.uint8)
    cells[1:-1, 1:-1] = 255
    Image.fromarray(cells).save(picture)
    return {"map": str(picture), "map_options": {"resolution": 0.1}, "bus": "memory"}


@cache
def small_plan(**more: object) -> Plan:
    return plans.make(parse(SETTINGS | more))


class Listener:
    """A watcher that keeps all reports."""

    def __init__(self) -> None:
        self.reports: list[tuple[str, object]] = []

    def take(self, sender: str, report: object) -> None:
        self.reports.append((sender, report))


@cache
def reports(**more: object) -> list[tuple[str, object]]:
    """All that a viewer of the small run is reports."""
    listener = Listener()
    MemoryRun(small_plan(**more), view=ViewNode(listener.take)).complete()
    return listener.reports


@cache
def small_run() -> Result:
    """The small run in a directory, with its pictures."""
    result = explore(parse(SETTINGS), out=Path(mkdtemp(prefix="murmur-")) / "run")
    assert result.directory is not None
    run = read(result.directory)
    write_figures(run, result.directory / run_directory.PICTURES)
    return result


def small_directory() -> Path:
    directory = small_run().directory
    assert directory is not None
    return directory
