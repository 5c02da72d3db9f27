"""What is measured of a case: an exploration, or something else that a case's plan allows to be measured.

An experiment names one of `MEASURES`; ``exploration``, the default, runs the scenario on the memory bus. A measure
takes a plan and returns figures by name, which become columns of the table of runs. A new one is a function in this
file, its line in `MEASURES`, and the names of its figures in `FIGURES`.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.record.records import Records
from deploy.record.summary import summarise
from deploy.run import in_memory
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import UNLIMITED
from netshaper.ledger import KIND_NUMBER

EXPLORATION = "exploration"

Figures = dict[str, Any]
Measure = Callable[[Plan], Figures]

SERIES = ("explored", "carried")
"""Series over the steps: what share of the reachable cells the team has seen, and bytes on the air."""


def exploration(plan: Plan) -> Figures:
    """Run the plan's scenario; return its summary, nested figures with dotted names, and more about its medium."""
    began = time.perf_counter()
    records = in_memory.run(plan)
    figures: Figures = {}
    for name, value in summarise(plan, records, time.perf_counter() - began).items():
        if name in ("lost", "versions"):
            figures[name] = json.dumps(value, sort_keys=True)
        elif isinstance(value, dict):
            figures |= {f"{name}.{inner}": number for inner, number in value.items()}
        else:
            figures[name] = value
    carried = _carried(records)
    figures["explored"] = [round(report.seen / report.reachable, 6) for report in records.world]
    figures["carried"] = carried.tolist()
    return figures | _load(plan, records, carried)


def voronoi(plan: Plan) -> Figures:
    """Voronoi pixels for each contour pixel of the plan's map, as it is and smoothed (thesis, Table 3.1)."""
    from deploy.study.voronoi import free_space, pixels, smoothed  # noqa: PLC0415  scipy, which few measures need

    free = free_space(plan.map.cells)
    before, after = pixels(free), pixels(smoothed(free))
    return {
        "voronoi.ratio": before.ratio,
        "voronoi.ratio_smoothed": after.ratio,
        "voronoi.pixels": before.voronoi,
        "voronoi.contour": before.contour,
    }


MEASURES: dict[str, Measure] = {EXPLORATION: exploration, "voronoi": voronoi}

FIGURES: dict[str, tuple[str, ...]] = {
    "voronoi": ("voronoi.ratio", "voronoi.ratio_smoothed", "voronoi.pixels", "voronoi.contour"),
    EXPLORATION: ("load.first_quarter", "load.last_quarter", "load.emerging"),
}
"""Figures of each measure; `exploration` has those of a summary besides."""


def _carried(records: Records) -> NDArray[np.int64]:
    """Bytes on the air, by step."""
    rows = records.ledger()
    on_air: NDArray[np.int64] = np.zeros(max(records.step + 1, 1), np.int64)
    np.add.at(on_air, rows["step"], rows["bytes"] * (rows["carried"] == 1))
    return on_air[1:]


def _load(plan: Plan, records: Records, carried: NDArray[np.int64]) -> Figures:
    """Figures of the channel's load: what share of the budget was used in the first and the last quarter of the
    steps.

    ``load.emerging`` is the mean load of the steps in which most objects emerge (at least half of the most of
    them, after the first ten steps), over that of the other steps.
    """
    quarter = max(1, len(carried) // 4)
    budget = plan.scenario.bandwidth
    shares: Figures = {"load.first_quarter": None, "load.last_quarter": None, "load.emerging": None}
    if budget != UNLIMITED and budget and len(carried):
        shares["load.first_quarter"] = float(carried[:quarter].mean() / int(budget))
        shares["load.last_quarter"] = float(carried[-quarter:].mean() / int(budget))
    rows = records.ledger()
    born = np.zeros(len(carried) + 1, np.int64)
    chosen = rows[(rows["kind"] == KIND_NUMBER["em"]) & (rows["carried"] == 1)]
    np.add.at(born, chosen["step"], chosen["packets"])
    later, born = carried[10:], born[11:]
    many = born >= max(1, born.max(initial=0) / 2)
    if many.any() and not many.all() and later[~many].mean() > 0:
        shares["load.emerging"] = float(later[many].mean() / later[~many].mean())
    return shares
