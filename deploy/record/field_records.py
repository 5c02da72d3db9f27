"""Records that a robot in the field makes besides those of its radio: how it drove, and how its maps changed.

    setup.json        the robot's settings, its clock, and where the team's grid lies; written at the start
    steps.csv         one line per step: when it began, the pose, and the state of the robot
    map_changes.bin   changes of its maps every few steps: each a message (`protocol.messages.MapChanges`, `Outlines`)
                      behind its length as a little-endian 32-bit number
    maps.npz          its maps at the end
    end.json          why it ended

Steps and map changes survive the end of the process at any moment. The last two files are missing then.
"""

from __future__ import annotations

import csv
import json
import struct
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np

from agent.field import FieldRobot, position
from agent.radios.peer_medium import FrameRecord
from agent.settings import Settings
from agent.viewer_feed import SHOWN_EVERY, RecorderFeed
from deploy.record.growing_file import GrowingFile, close_all
from deploy.record.link_records import LinkRecorder
from deploy.record.versions import versions
from protocol.errors import ProtocolError
from protocol.files import open_file, read_file
from protocol.grid import OCCUPIED
from protocol.map_parts import FinalMaps
from protocol.message_codec import pack, unpacker
from protocol.message_fields import MAX_PAYLOAD, MAX_TEXT
from protocol.messages import MapChanges, Outlines
from protocol.range_scans import TURN, decode_range_scan
from worldsim.atomic_files import write_whole

SETUP, STEP_LINES, MAPS, FINAL_MAPS, END = (
    "setup.json",
    "steps.csv",
    "map_changes.bin",
    "maps.npz",
    "end.json",
)
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
"""Linux: the number of this start of the host, whose monotonic clock all its processes share."""
LENGTH = struct.Struct("<I")
HEADINGS = 8
POSE = range(2, 5)
"""The columns of a step's pose, which may be empty."""


class RobotSetup(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of ``setup.json``.

    `settings`: of the robot's control logic. `x`, `y`: the lower left corner of the team's grid in the common frame, in
    meters. `step_ns`: duration of a step. `bytes_per_s`: what the robot may send. `clock`: the host's clock; equal for
    robots on one host, empty if unknown. `utc_ns`: what must be added to its times for nanoseconds since 1970.
    """

    settings: Settings
    x: float
    y: float
    step_ns: int
    bytes_per_s: int
    utc_ns: int = 0
    clock: str = ""
    versions: dict[str, str] = {}

    def __post_init__(self) -> None:
        if self.step_ns < 1 or self.bytes_per_s < 0:
            raise ValueError("step_ns must be positive, and bytes_per_s not negative")


class Ending(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of ``end.json``: why the robot ended, and whether everything is explored and delivered."""

    reason: str
    is_complete: bool


class StepLine(NamedTuple):
    """A line of ``steps.csv``.

    `time_ns`: when the step began, by the robot's clock. `x_mm`, `y_mm`, `heading`: the pose at its begin, on the grid
    as in `protocol.messages.WorldReport`; empty in steps without one. `target_x`, `target_y`: a cell; -1: none.
    `late_steps`: steps so far that took too long. `work_us`: processor time of this step.
    """

    time_ns: int
    step: int
    x_mm: int | None
    y_mm: int | None
    heading: int | None
    target_x: int
    target_y: int
    known_cells: int
    backlog: int
    late_steps: int
    work_us: int
    status: str


@dataclass(frozen=True)
class FieldRecord:
    """What one start of a robot recorded; `maps` and `ending` are None if its process was killed."""

    folder: Path
    setup: RobotSetup
    steps: Sequence[StepLine]
    changes: Sequence[MapChanges | Outlines]
    maps: FinalMaps | None
    ending: Ending | None

    @property
    def robot(self) -> int:
        """The robot's number."""
        return self.setup.settings.robot


def clock_id() -> str:
    """Return the name of this host's monotonic clock; empty if it has none."""
    try:
        return BOOT_ID.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return ""


class FieldRecorder:
    """Writes the directory of one start of a robot; FileExistsError if it has records already."""

    def __init__(self, folder: Path, setup: RobotSetup) -> None:
        self.folder = folder
        self._links = LinkRecorder(folder, setup.settings.robot)
        setup = msgspec.structs.replace(setup, versions=versions())
        _write_json(folder / SETUP, setup)
        self._laser, self._resolution = setup.settings.laser, setup.settings.resolution
        self._steps = GrowingFile(folder / STEP_LINES, "xb")
        self._steps.write_rows([StepLine._fields])
        self._maps = GrowingFile(folder / MAPS, "xb")
        self._feed = RecorderFeed(setup.settings)
        self._step = 0

    def record(self, step: int, frames: Sequence[FrameRecord]) -> None:
        """Take the frames of a step (`FieldRobot.record`); those of equal steps may come in several calls."""
        self._links.record(step, frames)

    def note(self, step: int, field: FieldRobot, status: str = "", work_us: int = 0) -> None:
        """Take the state of the robot at the end of a step."""
        self._step = step
        robot = field.robot
        x_mm, y_mm, heading = self._pose(field)
        target_x, target_y = robot.target or (-1, -1)
        line = StepLine(
            field.begin, step, x_mm, y_mm, heading, target_x, target_y, robot.known_cells,
            robot.replication.undelivered(), field.late_steps, work_us, status or robot.status,
        )  # fmt: skip
        self._steps.write_rows([line])
        if step % SHOWN_EVERY == 0:
            self._write_changes(field)

    def close(self, field: FieldRobot, reason: str, *, is_complete: bool) -> None:
        """Write the maps and the end; OSError if a file could not be written."""
        self._write_changes(field)
        robot = field.robot
        maps = FinalMaps(robot.own, robot.planning, robot.shared, robot.settled)
        write_whole(self.folder / FINAL_MAPS, lambda file: np.savez_compressed(file, **maps._asdict()))
        _write_json(self.folder / END, Ending(reason, is_complete))
        try:
            self._links.close()
        finally:
            close_all([self._steps, self._maps])

    def _write_changes(self, field: FieldRobot) -> None:
        for report in self._feed.changes(self._step, field.robot):
            message = pack(report)
            self._maps.write(LENGTH.pack(len(message)) + message)

    def _pose(self, field: FieldRobot) -> tuple[int, int, int] | tuple[None, None, None]:
        sense = field.sense
        if sense is None:
            return None, None, None
        x, y = (round(1000 * self._resolution * each) for each in position(sense))
        if self._laser is None or not sense.range_scan:
            return x, y, sense.heading * 3600 // HEADINGS
        return x, y, decode_range_scan(sense.range_scan, self._laser).heading * 3600 // TURN


def read_field_record(folder: Path) -> FieldRecord:
    """Read what `FieldRecorder` wrote, up to the last whole step; ValueError names a file that is damaged."""
    setup = _read_json(folder / SETUP, RobotSetup)
    final, end = folder / FINAL_MAPS, folder / END
    return FieldRecord(
        folder,
        setup,
        _read_steps(folder / STEP_LINES),
        list(_read_changes(folder / MAPS, f"r{setup.settings.robot}")),
        _read_maps(final, setup.settings) if final.exists() else None,
        _read_json(end, Ending) if end.exists() else None,
    )


def _read_steps(path: Path) -> list[StepLine]:
    """Read ``steps.csv``, up to its last whole line."""
    with open_file(path) as file:
        text = file.read().decode("utf-8", "replace")
    head, *rows = csv.reader(StringIO(text[: text.rfind("\n") + 1])) if "\n" in text else [[]]
    if tuple(head) != StepLine._fields:
        raise ValueError(f"{path}: the first line must be {','.join(StepLine._fields)}")
    lines: list[StepLine] = []
    for number, row in enumerate(rows, 2):
        try:
            values: list[Any] = [
                int(each) if each or at not in POSE else None for at, each in enumerate(row[:-1])
            ]
            line = StepLine._make([*values, row[-1][:MAX_TEXT]])
        except (TypeError, ValueError, IndexError):
            raise ValueError(f"{path}, line {number}: expected {len(StepLine._fields)} fields") from None
        if not _is_valid(line) or (
            lines and not (lines[-1].step < line.step and lines[-1].time_ns <= line.time_ns)
        ):
            raise ValueError(
                f"{path}, line {number}: its numbers cannot be those of a step after the last one"
            )
        lines.append(line)
    return lines


def _is_valid(line: StepLine) -> bool:
    pose = line[POSE.start : POSE.stop]
    numbers = [value for value in line[:-1] if isinstance(value, int)]
    return (
        len({value is None for value in pose}) == 1
        and all(abs(value) < 2**31 for value in numbers[1:])
        and abs(line.time_ns) < 2**63
        and min(line.step, line.known_cells, line.backlog, line.late_steps, line.work_us) >= 0
        and min(line.target_x, line.target_y) >= -1
    )


def _read_changes(path: Path, sender: str) -> Iterator[MapChanges | Outlines]:
    """Read ``map_changes.bin``, up to its last whole message."""
    read = unpacker((MapChanges, Outlines), sender)
    with open_file(path) as file:
        while len(head := file.read(LENGTH.size)) == LENGTH.size:
            begin, (length,) = file.tell(), LENGTH.unpack(head)
            if len(message := file.read(min(length, MAX_PAYLOAD + 1))) < min(length, MAX_PAYLOAD + 1):
                return
            try:
                yield read(message)
            except ProtocolError as error:
                raise ValueError(f"{path}, byte {begin}: {error}") from None


def _read_maps(path: Path, settings: Settings) -> FinalMaps:
    try:
        with np.load(path, allow_pickle=False) as file:
            maps = FinalMaps(*(file[name] for name in FinalMaps._fields))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path}: not the maps of a robot ({error})") from None
    kinds = (np.uint8, np.uint8, np.uint8, np.bool_)
    shape = settings.height, settings.width
    if any(each.shape != shape or each.dtype != kind for each, kind in zip(maps, kinds, strict=True)):
        raise ValueError(f"{path}: its maps do not have {settings.width} x {settings.height} cells")
    if max(int(each.max()) for each in maps[:3]) > OCCUPIED:
        raise ValueError(f"{path}: has a cell that is not free, occupied or unknown")
    return maps


Content = TypeVar("Content")


def _read_json(path: Path, kind: type[Content]) -> Content:
    try:
        return msgspec.convert(json.loads(read_file(path)), kind)
    except FileNotFoundError:
        raise ValueError(
            f"{path.parent} is not the record of a robot in the field: it has no {path.name}"
        ) from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: {error}") from None


def _write_json(path: Path, content: msgspec.Struct) -> None:
    text = json.dumps(msgspec.to_builtins(content), indent=2) + "\n"
    write_whole(path, lambda file: file.write(text.encode()))
