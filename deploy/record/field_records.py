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

import json
import struct
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, NamedTuple, TypeVar

import msgspec
import numpy as np

from agent.field import FieldRobot, position
from agent.radios.peer_medium import FrameRecord
from agent.settings import Settings
from agent.viewer_feed import SHOWN_EVERY, RecorderFeed
from deploy.record.growing_file import GrowingFile, close_all, read_rows
from deploy.record.link_records import LinkRecorder, Nanoseconds
from deploy.record.versions import versions
from protocol.errors import ProtocolError
from protocol.files import open_file, read_file
from protocol.grid import HEADINGS, OCCUPIED
from protocol.map_parts import FinalMaps
from protocol.message_codec import pack, unpacker
from protocol.message_fields import MAX_PAYLOAD
from protocol.messages import MapChanges, Outlines
from protocol.range_scans import TURN, decode_range_scan
from worldsim.atomic_files import write_whole

SETUP, STEP_LINES, MAPS = "setup.json", "steps.csv", "map_changes.bin"
FINAL_MAPS, END = "maps.npz", "end.json"
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
"""Linux: the number of this start of the host, whose monotonic clock all its processes share."""
LENGTH = struct.Struct("<I")


class RobotSetup(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of ``setup.json``.

    `settings`: of the robot's control logic. `x`, `y`: the lower left corner of the team's grid in the common frame, in
    meters. `step_ns`: duration of a step. `bytes_per_s`: what the robot may send. `clock`: the host's clock; equal for
    robots on one host, empty if unknown. `utc_ns`: what must be added to its times for nanoseconds since 1970.
    """

    settings: Settings
    x: float
    y: float
    step_ns: Annotated[int, msgspec.Meta(ge=1)]
    bytes_per_s: Annotated[int, msgspec.Meta(ge=0)]
    utc_ns: int = 0
    clock: str = ""
    versions: dict[str, str] = {}


class Ending(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of ``end.json``: why the robot ended, and whether everything is explored and delivered."""

    reason: str
    is_complete: bool


Count = Annotated[int, msgspec.Meta(ge=0, lt=2**31)]
Coordinate = Annotated[int, msgspec.Meta(gt=-(2**31), lt=2**31)]
Target = Annotated[int, msgspec.Meta(ge=-1, lt=2**31)]


class StepLine(NamedTuple):
    """A line of ``steps.csv``.

    `time_ns`: when the step began, by the robot's clock. `x_mm`, `y_mm`, `heading`: the pose at its begin, on the grid
    as in `protocol.messages.WorldReport`; empty in steps without one. `target_x`, `target_y`: a cell; -1: none.
    `late_steps`: steps so far that took too long. `work_us`: processor time of this step.
    """

    time_ns: Nanoseconds
    step: Count
    x_mm: Coordinate | None
    y_mm: Coordinate | None
    heading: Coordinate | None
    target_x: Target
    target_y: Target
    known_cells: Count
    backlog: Count
    late_steps: Count
    work_us: Count
    status: str | None


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
    lines = read_rows(path, StepLine)
    for number, line in enumerate(lines, 2):
        if len({value is None for value in (line.x_mm, line.y_mm, line.heading)}) > 1:
            raise ValueError(f"{path}, line {number}: has only a part of a pose")
    for number, (before, line) in enumerate(pairwise(lines), 3):
        if not (before.step < line.step and before.time_ns <= line.time_ns):
            raise ValueError(f"{path}, line {number}: is not of a step after the last one")
    return lines


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
