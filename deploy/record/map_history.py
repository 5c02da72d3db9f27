"""The robots' maps over time, from the changes that robots report every few steps.

The run directory holds them as ``map_changes.parquet``, one row per cell that changed, and ``outlines.parquet``, one
row per set of outlines that changed. Pictures, reports, films and exports read them.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deploy.record.arrow_tables import Values, table, write_table
from deploy.record.columns import MAP_CHANGES as CHANGE_COLUMNS
from deploy.record.columns import OUTLINES as OUTLINE_COLUMNS
from protocol.errors import ProtocolError
from protocol.grid import OCCUPIED, Grid
from protocol.messages import MapChanges, Outlines

MAP_CHANGES, OUTLINES = "map_changes.parquet", "outlines.parquet"
PER_STEP = 2
"""Reports of one map per step: one at its end, and one more if the run ends there."""


@dataclass
class _Grids:
    """The changes of one robot's two grids, and the grids after the first `applied` of them."""

    now: NDArray[np.uint8]
    steps: list[int] = field(default_factory=list)
    changes: list[tuple[NDArray[np.uint32], NDArray[np.uint8]]] = field(default_factory=list)
    applied: int = 0

    def at(self, step: int) -> NDArray[np.uint8]:
        """Both grids at a step, as `protocol.messages.MapChanges` packs them; fast if steps are asked in order."""
        wanted = bisect_right(self.steps, step)
        if wanted < self.applied:
            self.applied = 0
            self.now[:] = 0
        for cells, values in self.changes[self.applied : wanted]:
            self.now[cells] = values
        self.applied = wanted
        return self.now


class MapHistory:
    """The maps of all robots over time, on grids of `shape` (h, w)."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self._grids: dict[int, _Grids] = {}
        self._outlines: dict[tuple[int, int], list[Outlines]] = {}

    def take(self, robot: int, report: MapChanges | Outlines) -> None:
        """Add a robot's report; ProtocolError if it is out of order or does not fit the map."""
        if isinstance(report, Outlines):
            held = self._outlines.setdefault((robot, report.map_id), [])
            _check_order(report, [each.step for each in held[-PER_STEP:]])
            held.append(report)
            return
        cells, values = np.frombuffer(report.cells, "<u4"), np.frombuffer(report.values, np.uint8)
        if cells.max(initial=0) >= self._shape[0] * self._shape[1]:
            raise ProtocolError("MapChanges", 0, "a cell outside the map")
        if max(int((values & 3).max(initial=0)), int((values >> 2).max(initial=0))) > OCCUPIED:
            raise ProtocolError("MapChanges", 0, "a cell that is not free, occupied or unknown")
        _check_order(report, self._of(robot).steps[-PER_STEP:])
        self._add(robot, report.step, cells, values)

    def steps(self, robot: int) -> list[int]:
        """Steps at which a robot's maps changed."""
        return self._of(robot).steps

    def own(self, robot: int, step: int) -> Grid | None:
        """The robot's own map at a step: what it has seen itself; None before its first report."""
        return self._at(robot, step, 0)

    def planning(self, robot: int, step: int) -> Grid | None:
        """The robot's planning map at a step; None before its first report."""
        return self._at(robot, step, 2)

    def outlines(self, robot: int, map_id: int, step: int) -> bytes:
        """Outlines of map `map_id` as `robot` held them at a step (`protocol.messages.Outlines`)."""
        held = self._outlines.get((robot, map_id), [])
        at = bisect_right(held, step, key=lambda each: each.step)
        return held[at - 1].vertices if at else b""

    def maps_held(self, robot: int) -> list[int]:
        """Maps of which a robot has held outlines."""
        return sorted(map_id for holder, map_id in self._outlines if holder == robot)

    def outline_changes(self) -> list[tuple[int, Outlines]]:
        """All reports of outlines, each with its robot, by robot and map."""
        return [(robot, each) for (robot, _), held in sorted(self._outlines.items()) for each in held]

    def write(self, folder: Path) -> None:
        """Write both files atomically; that of the outlines only if there are any."""
        reports = [
            (robot, step, cells, values)
            for robot, grids in sorted(self._grids.items())
            for step, (cells, values) in zip(grids.steps, grids.changes, strict=True)
        ]
        sizes = [len(cells) for _, _, cells, _ in reports]
        cells = np.concatenate([np.empty(0, np.uint32), *(cells for _, _, cells, _ in reports)])
        values = np.concatenate([np.empty(0, np.uint8), *(values for *_, values in reports)])
        changes: dict[str, Values] = {
            "robot": np.repeat(np.array([robot for robot, *_ in reports], np.int16), sizes),
            "step": np.repeat(np.array([step for _, step, *_ in reports], np.int32), sizes),
            "x": cells % self._shape[1], "y": cells // self._shape[1],
            "own": values & 3, "planning": values >> 2,
        }  # fmt: skip
        write_table(folder / MAP_CHANGES, table(changes, CHANGE_COLUMNS), "zstd")
        if held := self.outline_changes():
            outlines: dict[str, Values] = {
                "robot": [robot for robot, _ in held], "step": [each.step for _, each in held],
                "map": [each.map_id for _, each in held], "vertices": [each.vertices for _, each in held],
            }  # fmt: skip
            write_table(folder / OUTLINES, table(outlines, OUTLINE_COLUMNS), "zstd")

    @classmethod
    def read(cls, folder: Path, shape: tuple[int, int]) -> MapHistory:
        """Read the files that `write` wrote."""
        from pyarrow import parquet  # noqa: PLC0415  half a second to import

        history = cls(shape)
        read = parquet.read_table(folder / MAP_CHANGES)
        columns = {name: read[name].to_numpy() for name in read.column_names}
        cells = columns["y"].astype(np.uint32) * shape[1] + columns["x"]
        values = columns["own"] | columns["planning"] << 2
        key = columns["robot"].astype(np.int64) << 32 | columns["step"]
        starts = np.flatnonzero(np.diff(key, prepend=-1))
        for first, end in pairwise([*starts, len(key)]):
            robot, step = int(columns["robot"][first]), int(columns["step"][first])
            history._add(robot, step, cells[first:end], values[first:end])
        if (folder / OUTLINES).is_file():
            rows = parquet.read_table(folder / OUTLINES).to_pylist()
            for row in rows:
                report = Outlines(row["step"], row["map"], row["vertices"])
                history._outlines.setdefault((row["robot"], row["map"]), []).append(report)
        return history

    def _of(self, robot: int) -> _Grids:
        if robot not in self._grids:
            self._grids[robot] = _Grids(np.zeros(self._shape[0] * self._shape[1], np.uint8))
        return self._grids[robot]

    def _add(self, robot: int, step: int, cells: NDArray[np.uint32], values: NDArray[np.uint8]) -> None:
        grids = self._of(robot)
        grids.steps.append(step)
        grids.changes.append((cells, values))

    def _at(self, robot: int, step: int, shift: int) -> Grid | None:
        grids = self._of(robot)
        if not grids.steps or grids.steps[0] > step:
            return None
        return (grids.at(step) >> np.uint8(shift) & np.uint8(3)).reshape(self._shape)


def _check_order(report: MapChanges | Outlines, before: Sequence[int]) -> None:
    """Raise ProtocolError if a report is older than the last one, or one too many of its step."""
    if (before and report.step < before[-1]) or before.count(report.step) >= PER_STEP:
        raise ProtocolError(type(report).__name__, 0, f"step {report.step} after step {before[-1]}")
