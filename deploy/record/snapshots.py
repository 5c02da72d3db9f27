"""Robots' maps over time: what a viewer was shown, kept as ``snapshots.parquet`` in the run directory.

A row is a planning grid (`map_id` is -1) or the outlines of one robot's map, as `robot` held them at `step`.
Each robot sends only what has changed; everything else remains valid.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from protocol import keys as names
from protocol.grid import Grid
from protocol.messages import Outlines, Snapshot, grid_from_bytes
from worldsim.atomic_files import write_whole

SNAPSHOTS = "snapshots.parquet"
PLANNING = -1
"""The value of `map_id` in a row with a planning grid."""

COLUMNS = ("step", "robot", "map_id", "width", "height", "data")


@dataclass
class Snapshots:
    """All snapshots of robots' maps, in the order of steps."""

    steps: dict[tuple[int, int], list[int]] = field(default_factory=dict)
    shown: dict[tuple[int, int], list[Snapshot | Outlines]] = field(default_factory=dict)

    def take(self, sender: str, said: object) -> None:
        """Keep a robot's snapshots; ignore everything else."""
        if isinstance(said, Snapshot | Outlines):
            map_id = said.map_id if isinstance(said, Outlines) else PLANNING
            self._add((names.number(sender), map_id), said)

    def planning(self, robot: int, step: int) -> Grid | None:
        """The planning grid of a robot at a step; None if it has shown none by then."""
        said = self._latest((robot, PLANNING), step)
        return grid_from_bytes(said.planning, said.width, said.height) if isinstance(said, Snapshot) else None

    def outlines(self, robot: int, map_id: int, step: int) -> bytes:
        """Outlines of robot `map_id`'s map as `robot` held them at a step (`protocol.messages.Outlines`)."""
        said = self._latest((robot, map_id), step)
        return said.vertices if isinstance(said, Outlines) else b""

    def told_steps(self, robot: int, map_id: int = PLANNING) -> list[int]:
        """Steps at which a robot has sent its planning grid, or its outlines of `map_id`'s map."""
        return self.steps.get((robot, map_id), [])

    @property
    def has_outlines(self) -> bool:
        """Whether robots have shown any outlines."""
        return any(map_id != PLANNING for _, map_id in self.steps)

    def write(self, path: Path) -> None:
        """Write them as a parquet file, atomically."""
        import pyarrow as pa  # noqa: PLC0415  half a second that the command line need not wait for
        from pyarrow import parquet  # noqa: PLC0415

        rows = [_row(robot, map_id, said) for (robot, map_id), told in self.shown.items() for said in told]
        rows.sort(key=lambda row: row[:3])
        kinds = (pa.int32(), pa.int32(), pa.int32(), pa.int32(), pa.int32(), pa.binary())
        columns: Any = list(zip(*rows, strict=True)) if rows else [[] for _ in COLUMNS]
        arrays = [pa.array(column, kind) for column, kind in zip(columns, kinds, strict=True)]
        table = pa.table(arrays, list(COLUMNS))
        write_whole(path, lambda file: parquet.write_table(table, file, compression="zstd"))

    @classmethod
    def read(cls, path: Path) -> Snapshots:
        """Read what `write` wrote."""
        from pyarrow import parquet  # noqa: PLC0415

        snapshots = cls()
        table = parquet.read_table(path)
        for step, robot, map_id, width, height, data in zip(
            *(table[name].to_pylist() for name in COLUMNS), strict=True
        ):
            said = Snapshot(step, width, height, data) if map_id == PLANNING else Outlines(step, map_id, data)
            snapshots._add((robot, map_id), said)
        return snapshots

    def _add(self, key: tuple[int, int], said: Snapshot | Outlines) -> None:
        self.steps.setdefault(key, []).append(said.step)
        self.shown.setdefault(key, []).append(said)

    def _latest(self, key: tuple[int, int], step: int) -> Snapshot | Outlines | None:
        at = bisect_right(self.steps.get(key, []), step)
        return self.shown[key][at - 1] if at else None


def _row(robot: int, map_id: int, said: Snapshot | Outlines) -> tuple[int, int, int, int, int, bytes]:
    if isinstance(said, Snapshot):
        return said.step, robot, map_id, said.width, said.height, said.planning
    return said.step, robot, map_id, 0, 0, said.vertices
