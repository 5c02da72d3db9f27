"""Phases of steps that robots missed by the wall clock: the input that repeats such a run (``missed.parquet``)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec

from deploy.record.arrow_tables import table, write_table
from deploy.record.columns import MISSED as COLUMNS
from deploy.scenario.errors import ScenarioError
from netshaper.phase_clock import PHASES
from protocol.messages import Missed
from worldsim.clock import MOVE, STEP

MISSED = "missed.parquet"


def write(path: Path, record: Iterable[Missed]) -> None:
    """Write a record, in its order."""
    rows = [(missed, robot) for missed in record for robot in missed.robots]
    columns = {name: [getattr(missed, name) for missed, _ in rows] for name in ("step", "phase", "round")}
    write_table(path, table({**columns, "robot": [robot for _, robot in rows]}, COLUMNS))


def read(path: Path, robots: int) -> list[Missed]:
    """Read the record of a run of so many robots; ScenarioError if the file is missing or damaged."""
    from pyarrow import ArrowException, parquet  # noqa: PLC0415  half a second to import

    found: dict[tuple[int, str, int], list[int]] = {}
    try:
        for row in parquet.read_table(path).to_pylist():
            found.setdefault((row["step"], row["phase"], row["round"]), []).append(row["robot"])
        rows = [[_TAG, step, phase, number, named] for (step, phase, number), named in found.items()]
        record = msgspec.convert(rows, list[Missed])
        for missed in record:
            if missed.phase not in (STEP, MOVE, *PHASES):
                raise ValueError(f"step {missed.step} has an unknown phase, {missed.phase!r}")
            if max(missed.robots) >= robots:
                raise ValueError(f"step {missed.step} names robot {max(missed.robots)} of {robots} robots")
        return record
    except FileNotFoundError:
        raise ScenarioError(
            f"{path}: is missing: without it, a run by the wall clock cannot be repeated"
        ) from None
    except (ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        raise ScenarioError(f"{path}: damaged table ({' '.join(str(error).split())})") from None


_TAG = Missed.__struct_config__.tag


def figures(record: Iterable[Missed], robots: int) -> dict[str, Any]:
    """Return the keys of ``summary.json`` that count missed steps, in which a robot did not move in time."""
    steps, phases = [0] * robots, 0
    for missed in record:
        if missed.phase in (STEP, MOVE):
            for robot in missed.robots:
                steps[robot] += 1
        else:
            phases += len(missed.robots)
    return {"missed_steps": sum(steps), "missed_steps_by_robot": steps, "missed_phases": phases}
