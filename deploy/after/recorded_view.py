"""The recording for the dashboard (``run.rrd``) of a run that is over, from its records."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from deploy.record.records import Records
from deploy.scenario.plan import Plan
from netshaper.ledger import ROW
from protocol import keys as names
from protocol.cell_bytes import grid_to_bytes
from protocol.messages import Missed, Outlines, RadioReport, Snapshot


def record_view(plan: Plan, records: Records, path: Path, links: Mapping[int, bytes]) -> None:
    """Write the recording of a run, as if the dashboard had watched it; `links`: those of each step (`RadioReport`)."""
    from deploy.dashboard.recording import recording  # noqa: PLC0415  imports Rerun

    maps = _maps(records)
    rows = {int(np.frombuffer(each, ROW)["step"][0]): each for each in records.rows if each}
    missed: defaultdict[int, list[Missed]] = defaultdict(list)
    for each in records.missed:
        missed[each.step].append(each)
    statuses = {(robot, status.step): status for robot, own in enumerate(records.statuses) for status in own}
    with recording(plan, path, None) as recorder:
        for report in records.world:
            step = report.step
            recorder.take(names.WORLD, report)
            for robot in range(records.robots):
                if (status := statuses.get((robot, step))) is not None:
                    recorder.take(names.robot(robot), status)
                for shown in maps.get((robot, step), []):
                    recorder.take(names.robot(robot), shown)
            for late in missed[step]:
                recorder.take(names.WORLD, late)
            of_step = rows.get(step, b"")
            table = np.frombuffer(of_step, ROW)
            carried = int(table["bytes"][table["carried"] == 1].sum())
            recorder.take(names.RELAY, RadioReport(step, of_step, carried, b"", links.get(step, b"")))
        if records.end is not None:
            recorder.take(names.WORLD, records.end)


def _maps(records: Records) -> dict[tuple[int, int], list[Snapshot | Outlines]]:
    """Return the changed maps by robot and step."""
    maps: defaultdict[tuple[int, int], list[Snapshot | Outlines]] = defaultdict(list)
    for robot in range(records.robots):
        for step in records.maps.steps(robot):
            grid = records.maps.planning(robot, step)
            if grid is not None:
                maps[robot, step].append(Snapshot(step, grid.shape[1], grid.shape[0], grid_to_bytes(grid)))
    for robot, outlines in records.maps.outline_changes():
        maps[robot, outlines.step].append(outlines)
    return maps
