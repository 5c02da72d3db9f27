"""The run directory: all results of a run, and all input that repeats it.

Each file is written under a temporary name and then renamed, so that no file is ever incomplete. Only the capture of
the radio grows during the run, block by block, and is readable up to its last whole block. pyarrow writes and reads
the tables, because the threads of polars do not survive in forked processes.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import shlex
import shutil
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.record import missed_phases
from deploy.record.arrow_tables import table, write_table
from deploy.record.columns import FILES
from deploy.record.columns import LEDGER as LEDGER_COLUMNS
from deploy.record.columns import STEPS as STEP_COLUMNS
from deploy.record.growing_file import GrowingFile
from deploy.record.map_history import MAP_CHANGES
from deploy.record.missed_phases import MISSED
from deploy.record.records import Records
from deploy.scenario import plan as plans
from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario, load, parse
from netshaper import capture
from netshaper.ledger import CAUSES, MALFORMED
from protocol.files import open_file, read_file
from protocol.grid import FREE
from protocol.packets import ALL_KINDS
from protocol.plugins import without_import
from worldsim import maps
from worldsim.atomic_files import write_whole
from worldsim.maps import Map, to_world
from worldsim.recorded import scan_file

SCENARIO, SUMMARY, STEPS, LEDGER = "scenario.toml", "summary.json", "steps.parquet", "ledger.parquet"
CAPTURE, NEW_CAPTURE = "radio.pcapng", ".radio.pcapng"
MAP = "map.yaml"
INPUTS = SCENARIO, MAP, "map.png"
SCANS = "scans-{}.npz"
PICTURE = "maps.png"
PICTURES = "pictures"
LOGS = "logs"
JOURNALS = "journals"
RUNS = Path("runs")
"""The directory for runs without `--out`."""

REQUIRED_KEYS = (
    "finished", "reason", "steps", "first_robot", "coverage", "map_accuracy", "t90", "t99", "robots", "seed",
    "map", "bus", "strategy", "map_encoding", "bandwidth", "range_m", "bytes", "packets", "over_budget_steps",
    "undelivered", "lost", "digest", "steps_per_s", "versions",
)  # fmt: skip
"""Keys of a summary that reports and replays need."""


def check_free(out: Path | None) -> None:
    """Raise ScenarioError if `out` cannot be used for a new run: it is a file, not empty, or its name not UTF-8."""
    try:
        str(out).encode()
    except UnicodeEncodeError:
        raise ScenarioError(f"out = {str(out)!r}: not UTF-8; use another name, or LC_ALL=C.UTF-8") from None
    if out is not None and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ScenarioError(f"out = {out}: already exists; name a new directory, or empty this one")
    if out is None and RUNS.exists() and not RUNS.is_dir():
        raise ScenarioError(
            f"{RUNS} is a file, and runs go into a directory of that name: move it, or use --out"
        )


def create(out: Path | None, plan: Plan) -> Path:
    """Make the directory of a new run; without a name, a new one under ``runs``.

    Raises ScenarioError if it is not free, or cannot be made; OSError if the disk is full: then it is free for another
    attempt.
    """
    check_free(out)
    is_new = out is None or not out.exists()
    try:
        out = out or _next_free(plan)
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScenarioError(f"out = {out or RUNS}: cannot be made: {error.strerror}") from None
    try:
        write_inputs(out, plan)
    except OSError:
        discard(out, is_new=is_new)
        raise
    return out


def discard(out: Path, *, is_new: bool) -> None:
    """Remove the files of a run that did not begin, and its directory if it `is_new`; nothing else is in there."""
    for each in out.iterdir():
        if each.is_dir():
            shutil.rmtree(each)
        else:
            each.unlink()
    if is_new:
        out.rmdir()


def _next_free(plan: Plan) -> Path:
    """Make a directory that no other run uses, even if several runs start at the same time."""
    scenario = plan.scenario
    encoding = scenario.map_encoding.replace(":", "-")
    stem = f"{plan.map.name}-{encoding}-{scenario.robots}robots-seed{scenario.seed}"
    RUNS.mkdir(exist_ok=True)
    for number in count(1):
        directory = RUNS / (stem if number == 1 else f"{stem}-{number}")
        with contextlib.suppress(FileExistsError):
            directory.mkdir()
            break
    return directory


def write_inputs(out: Path, plan: Plan) -> None:
    """Write the input of the run: its map, the scans that it replays, and its scenario with references to these."""
    maps.save(plan.map, out / MAP)
    data = plan.scenario.model_dump(mode="json", exclude_none=True) | {"map": MAP, "map_options": {}}
    again = (
        f"Repeat it: murmur replay {shlex.quote(str(out))}"
        if plan.has_truth
        else "It was in the field, and cannot be repeated."
    )
    text = f"# {plan.map.name}: all settings of this run. {again}\n"
    if plan.recording is not None:
        options = plan.scenario.recording
        share = "all" if options.every == 1 else f"one of {options.every}"
        text += f"# Replayed: {', '.join(options.files)}; {share} scans.\n"
        files = [SCANS.format(number) for number in range(len(plan.recording.logs))]
        for name, log in zip(files, plan.recording.logs, strict=True):
            scan_file.write(log, out / name)
        data["recording"] |= {"files": files, "every": 1, "topic": ""}
    text += parse(data).to_toml()
    write_whole(out / SCENARIO, lambda file: file.write(text.encode()))


@contextlib.contextmanager
def open_capture(directory: Path | None, plan: Plan, *, again: bool = False) -> Iterator[GrowingFile | None]:
    """Start ``radio.pcapng``, or the file that `settle_capture` renames to it; writes go to the disk immediately."""
    if directory is None:
        yield None
        return
    scenario = plan.scenario
    comment = (
        f"{scenario.robots} robots on {plan.map.name}, map encoding {scenario.map_encoding}, "
        f"bandwidth {scenario.bandwidth}, range {plan.range_m:.1f} m, seed {scenario.seed}"
    )
    with GrowingFile(directory / (NEW_CAPTURE if again else CAPTURE), "wb") as file:
        file.write(capture.head(comment))
        yield file


def settle_capture(directory: Path | None, *, accept: bool) -> None:
    """Replace the capture by that of the repeated run, if there is one; discard it unless it is accepted."""
    if directory is not None and (directory / NEW_CAPTURE).exists():
        if accept:
            (directory / NEW_CAPTURE).replace(directory / CAPTURE)
        else:
            (directory / NEW_CAPTURE).unlink()


def read_scenario(directory: Path, **overrides: Any) -> Scenario:
    """Read the scenario of a run directory, with the map in it, without importing strategies of other packages.

    `overrides` replace settings, if they are not None.

    Raises ScenarioError if it is not a run directory.
    """
    if not (directory / SCENARIO).is_file():
        raise ScenarioError(f"{directory}: not a run directory: {SCENARIO} is missing")
    try:
        with without_import():
            return load(directory / SCENARIO, overrides)
    except ScenarioError as error:
        if not (directory / SUMMARY).is_file():
            raise
        raise ScenarioError(
            f"{error}\n{directory}: the settings of a finished run cannot be read: another version of Murmur wrote "
            f"them, or they were changed; use that version, or undo the change"
        ) from None


def read_plan(directory: Path) -> Plan:
    """Derive the plan of a run from its directory, without importing strategies of other packages."""
    with without_import():
        scenario = read_scenario(directory)
        return plans.of_field(scenario) if scenario.is_field else plans.make(scenario)


def read_summary(directory: Path) -> dict[str, Any]:
    """Read the summary of a run directory; ScenarioError if it has none."""
    try:
        summary = json.loads(read_file(directory / SUMMARY))
    except FileNotFoundError:
        repeat = f"murmur explore {shlex.quote(str(directory / SCENARIO))}"
        raise ScenarioError(
            f"{directory}: no readable {SUMMARY}: the run has not ended, or was killed; to repeat it: {repeat}"
        ) from None
    except (OSError, ValueError, RecursionError) as error:
        raise ScenarioError(f"{directory}: no readable {SUMMARY} ({error})") from None
    missing = [key for key in REQUIRED_KEYS if not isinstance(summary, dict) or key not in summary]
    if missing:
        raise ScenarioError(
            f"{directory}: {SUMMARY} is not the summary of a run: it lacks {', '.join(missing)}"
        )
    found: dict[str, Any] = summary
    return found


def check_inputs(directory: Path, summary: dict[str, Any]) -> None:
    """Raise ScenarioError if the scans that a run replayed, or the steps that its robots missed, have changed since."""
    digests = summary.get("tables")
    for name, digest in digests.items() if isinstance(digests, dict) else ():
        path = directory / name
        is_input = path.suffix == scan_file.SUFFIX or name == MISSED
        if is_input and path.is_file() and sha256(path) != digest:
            raise ScenarioError(f"{path}: has changed since the run: its SHA-256 is not that in {SUMMARY}")


def changed_inputs(directory: Path, summary: dict[str, Any]) -> list[str]:
    """Return the files from which a run is repeated whose SHA-256 is not that in its summary."""
    digests = summary.get("tables")
    known = digests if isinstance(digests, dict) else {}
    present = (name for name in INPUTS if name in known and (directory / name).is_file())
    return [name for name in present if sha256(directory / name) != known[name]]


def load_writers() -> None:
    """Import what `write_results` needs: at the end of a run, an import could fail and lose the run."""
    from pyarrow import parquet  # noqa: F401, PLC0415

    from deploy.record import map_pictures  # noqa: F401, PLC0415  half a second, as is pyarrow


def write_results(
    out: Path, plan: Plan, records: Records, summary: dict[str, Any], failures: Sequence[OSError]
) -> None:
    """Write summary, tables, maps and their changes: each file that can be written.

    If all of them are, the digests of tables and inputs are added to the summary.

    Raises OSError at the end if one cannot be written, or if `failures` has a file that could not be written before;
    the error names all such files.
    """
    from deploy.record.map_pictures import maps_figure, save  # noqa: PLC0415

    def write_summary() -> None:
        text = json.dumps(summary, indent=2) + "\n"
        write_whole(out / SUMMARY, lambda file: file.write(text.encode()))

    grids = {f"planning-r{robot}": grid for robot, grid in records.planning.items()}
    if records.own:
        grids = {"team": records.team_map(summary["refuted_maps"])} | grids
    place = plan.map.resolution, plan.map.origin
    found = {name: Map(name, grid, *place) for name, grid in grids.items() if (grid == FREE).any()}
    writers: dict[str, Callable[[], object]] = {
        SUMMARY: write_summary,
        STEPS: lambda: write_table(out / STEPS, steps_table(plan, records)),
        LEDGER: lambda: write_table(out / LEDGER, ledger_table(records.ledger())),
        MAP_CHANGES: lambda: records.maps.write(out),
    }
    if plan.scenario.clock == "wall":
        writers[MISSED] = lambda: missed_phases.write(out / MISSED, records.missed)
    for name, each in found.items():
        writers[f"{name}.yaml"] = partial(maps.save, each, out / f"{name}.yaml")
    if records.own:
        writers[PICTURE] = lambda: save(out / PICTURE, maps_figure(plan, records, summary), dpi=110)
    failed = [*failures]
    for name, write in writers.items():
        try:
            write()
        except OSError as error:
            failed.append(error)
        except MemoryError:
            failed.append(OSError(errno.ENOMEM, os.strerror(errno.ENOMEM), str(out / name)))
    if failed:
        unwritten = ", ".join(dict.fromkeys(str(error.filename) for error in failed))
        raise OSError(failed[0].errno, failed[0].strerror, unwritten)
    logs = plan.recording.logs if plan.recording is not None else ()
    names = [*INPUTS, *FILES, *(SCANS.format(number) for number in range(len(logs)))]
    summary["tables"] = {name: sha256(out / name) for name in names if (out / name).is_file()}
    write_summary()


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def steps_table(plan: Plan, records: Records) -> Any:
    """One row per step and robot: pose and state; meters in the map's frame."""
    cell = plan.map.resolution
    statuses = {(r, report.step): report for r, reports in enumerate(records.statuses) for report in reports}
    columns: dict[str, list[Any]] = {column.name: [] for column in STEP_COLUMNS}
    for report in records.world:
        for robot, x_mm, y_mm, heading in report.pose_rows.tolist():
            x, y = to_world(plan.map, x_mm / 1000 / cell, y_mm / 1000 / cell)
            row: dict[str, Any] = {
                "step": report.step, "robot": robot, "x": x, "y": y, "heading": heading / 10,
                "driven": report.driven[robot] / 1000, "team_seen": report.seen / report.reachable,
            }  # fmt: skip
            if status := statuses.get((robot, report.step)):
                row |= {
                    "known_cells": status.known, "backlog": status.backlog, "status": status.status,
                    "work_us": status.work_us,
                }  # fmt: skip
                if status.target_x >= 0:
                    target = to_world(plan.map, status.target_x, status.target_y)
                    row |= {"target_x": target[0], "target_y": target[1]}
            for name, value in (dict.fromkeys(columns) | row).items():
                columns[name].append(value)
    return table(columns, STEP_COLUMNS)


def ledger_table(ledger: NDArray[np.void]) -> Any:
    """The rows of a ledger (`netshaper.ledger.ROW`) as a table: one row per frame and packet kind."""
    columns: dict[str, Any] = {name: np.ascontiguousarray(ledger[name]) for name in ledger.dtype.names or ()}
    kinds = np.where(columns["kind"] == MALFORMED, len(ALL_KINDS), columns["kind"])
    columns["kind"] = np.array([*ALL_KINDS, "malformed"])[kinds]
    columns["cause"] = np.array(CAUSES)[columns["cause"]]
    columns["carried"] = columns["carried"] == 1
    return table(columns, LEDGER_COLUMNS)
