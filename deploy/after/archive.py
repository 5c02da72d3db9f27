"""A run directory, read back: the input of figures, reports, films and exports."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.after.capture import opened
from deploy.record import run_directory
from deploy.record.columns import FILES
from deploy.record.ledger_figures import budgets
from deploy.record.map_history import MAP_CHANGES, OUTLINES, MapHistory
from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import Plan
from netshaper import capture
from netshaper.ledger import EVERYONE
from netshaper.pcapng import CaptureError
from netshaper.topology import links
from worldsim.maps import to_cell

Table = dict[str, NDArray[Any]]
"""Columns by name."""


SETTINGS = ("robots", "seed", "strategy", "map_encoding", "bandwidth")
"""Settings that a run's scenario and its summary both have."""

AFTER_BORDER = 0.5 + 1e-6
"""From the border of a cell to its center, in cells, with a margin above rounding errors of floats: as in
`protocol.grid.cell_of`, a border belongs to the cell on its right, or below."""


@dataclass(frozen=True)
class Archive:
    """One run, as recorded in its directory."""

    directory: Path
    plan: Plan
    """The plan derived from its scenario."""
    summary: dict[str, Any]
    """The figures of ``summary.json``."""

    @cached_property
    def steps(self) -> Table:
        """``steps.parquet``: one row per step and robot, meters in the map's frame."""
        return _read_table(self.directory / run_directory.STEPS)

    @cached_property
    def ledger(self) -> Table:
        """``ledger.parquet``: one row per frame and packet kind."""
        return _read_table(self.directory / run_directory.LEDGER)

    @cached_property
    def maps(self) -> MapHistory:
        """The robots' maps over time (``map_changes.parquet``, ``outlines.parquet``)."""
        return MapHistory.read(self.directory, self.plan.map.cells.shape)

    @cached_property
    def budgets(self) -> NDArray[np.float64]:
        """Bytes that the team may transmit in each step, from step 0; infinite without a limit."""
        radio = self.plan.radio
        return budgets(radio.budget, radio.changes, self.last_step + 1)

    @cached_property
    def links(self) -> dict[int, set[tuple[int, int]]]:
        """Who received bytes from whom, by step: pairs of sender and receiver.

        They are in the capture. Without it, those of broadcasts are unknown, and left out.
        """
        found: defaultdict[int, set[tuple[int, int]]] = defaultdict(set)
        try:
            with opened(self.directory) as reader:
                for frame in capture.read(reader):
                    found[frame.step].update((frame.sender, robot) for robot in frame.receivers)
        except CaptureError:
            rows = self.ledger["carried"].astype(bool) & (self.ledger["receiver"] != EVERYONE)
            columns = (self.ledger[name][rows].tolist() for name in ("step", "sender", "receiver"))
            for step, sender, receiver in zip(*columns, strict=True):
                found[step].add((sender, receiver))
        return found

    def in_range(self, step: int) -> set[tuple[int, int]]:
        """Pairs of robots that receive each other in a step, by the radio's model (lower number first)."""
        world, rows = self.plan.map, self.rows_of(step)
        cells = {
            int(robot): (math.floor(column + AFTER_BORDER), math.floor(row + AFTER_BORDER))
            for robot, x, y in zip(rows["robot"], rows["x"], rows["y"], strict=True)
            for column, row in [to_cell(world, x, y)]
        }
        settings = replace(self.plan.radio, range_cells=self.range_m(step) / world.resolution)
        near = links(settings, step, cells)
        return {(a, b) for a, others in near.items() for b in others if a < b}

    def rows_of(self, step: int) -> Table:
        """The rows of `steps` of one step."""
        first, end = np.searchsorted(self.steps["step"], (step, step + 1))
        return {name: column[first:end] for name, column in self.steps.items()}

    def range_m(self, step: int) -> float:
        """The communication range in a step, in meters."""
        changes = (each.range_mm for each in self.plan.radio.changes if each.step <= step)
        changed = [range_mm for range_mm in changes if range_mm is not None]
        return changed[-1] / 1000 if changed else self.plan.range_m

    @property
    def last_step(self) -> int:
        """The last step of the run."""
        return int(self.steps["step"].max(initial=0))

    def of_robot(self, robot: int) -> Table:
        """The rows of `steps` of one robot, in the order of steps."""
        rows = self.steps["robot"] == robot
        return {name: column[rows] for name, column in self.steps.items()}


def read(directory: Path) -> Archive:
    """Read a run directory.

    Raises ScenarioError if it is not a run directory, a table is missing or damaged, or its scenario is not that of the
    run.
    """
    plan = run_directory.read_plan(directory)
    summary = run_directory.read_summary(directory)
    for key in SETTINGS:
        now, then = getattr(plan.scenario, key), summary.get(key)
        if key in summary and then != now:
            raise ScenarioError(
                f"{directory}: {key} = {now!r} in {run_directory.SCENARIO}, but the run had {then!r}, by "
                f"{run_directory.SUMMARY}; change a scenario in another directory"
            )
    digests = summary.get("tables")
    for name in (run_directory.STEPS, run_directory.LEDGER, MAP_CHANGES, OUTLINES):
        if (directory / name).is_file():
            _check_table(directory / name, digests.get(name) if isinstance(digests, dict) else None)
        elif name != OUTLINES:
            raise ScenarioError(f"{directory}: {name} is missing: the run did not write its results")
    return Archive(directory, plan, summary)


def _check_table(path: Path, digest: str | None) -> None:
    """Raise ScenarioError if a table cannot be read, lacks a column, or has another SHA-256 than `digest`.

    A table whose digest the summary does not have is read to find damage.
    """
    from pyarrow import ArrowException, parquet  # noqa: PLC0415  takes half a second to import

    try:
        present = (parquet.read_schema(path) if digest else parquet.read_table(path).schema).names
    except (ArrowException, OSError, ValueError, MemoryError) as error:
        raise ScenarioError(f"{path}: damaged table ({' '.join(str(error).split())})") from None
    missing = [column.name for column in FILES[path.name] if column.name not in present]
    if missing:
        raise ScenarioError(f"{path}: not the table of a run: columns missing: {', '.join(missing)}")
    if digest and run_directory.sha256(path) != digest:
        raise ScenarioError(f"{path}: damaged table: its SHA-256 is not that in {run_directory.SUMMARY}")


def _read_table(path: Path) -> Table:
    from pyarrow import parquet  # noqa: PLC0415  takes half a second to import

    table = parquet.read_table(path)
    return {name: np.asarray(table[name].to_numpy(zero_copy_only=False)) for name in table.column_names}
