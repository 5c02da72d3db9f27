"""`murmur merge`: join what robots in the field recorded into one run directory, on one clock.

Each robot recorded by the clock of its host. Robots on one host have one clock. A frame that one robot sent and another
received gives the difference of their clocks, plus the time that the frame took. The smallest difference in each
direction has the least delay; half the difference of both is the offset of the clocks, as in NTP (RFC 5905, section 8).
If both clocks run equally fast, half their sum bounds its error. Drift is not corrected, but the bound contains it:
each frame bounds the difference of the clocks at its time, and `MAX_DRIFT_PPM` bounds how fast the difference changes.
Clocks are aligned along the pairs with the smallest sums of bounds; those of robots that exchanged no frames, by the
time of day.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import NamedTuple

from deploy.after.field_run import FieldStart, Timeline, assemble
from deploy.after.field_summary import summarize_field
from deploy.after.recorded_view import record_view
from deploy.dashboard.process import RECORDING
from deploy.record import run_directory
from deploy.record.field_records import FieldRecord, read_field_record
from deploy.record.growing_file import GrowingFile
from deploy.record.link_records import FrameLine, contents, read_frames
from deploy.record.run_directory import CAPTURE
from deploy.run.exit_codes import EXPLORED, NOT_FINISHED
from deploy.run.result import Result
from deploy.scenario.plan import Plan
from netshaper import capture, pcapng
from netshaper.frame_log import Frame, FrameLog
from netshaper.ledger import BROADCAST, CAUSES, EVERYONE
from netshaper.pcapng import CaptureError
from protocol.files import open_file
from protocol.nanoseconds import SECOND

UNKNOWN = 1 << 62
"""The bound of an error about which nothing is known."""

MAX_DRIFT_PPM = 500
"""Drift of two clocks against each other, at most, in parts per million: MAXFREQ of RFC 5905."""

START = "start-*"
"""Directories of the starts of a robot, in its record directory."""


class FrameId(NamedTuple):
    """The number of a frame, in all directories."""

    sender: int
    session: int
    counter: int


@dataclass(frozen=True)
class RobotRecord:
    """What one start of a robot in the field recorded, with the frames on its radio."""

    record: FieldRecord
    sent: dict[FrameId, FrameLine]
    received: dict[FrameId, FrameLine]
    """`sent`, `received`: the frames that this robot sent, and that it received from others."""
    packets: dict[FrameId, tuple[bytes, bytes]]
    """Broadcast and gossip of each frame."""

    @property
    def robot(self) -> int:
        """The robot's number."""
        return self.record.robot


@dataclass
class Joined:
    """A frame, as all robots recorded it."""

    time_ns: int
    size: int
    packets: tuple[bytes, bytes]
    receivers: set[int] = field(default_factory=set)
    was_sent: bool = False
    """Whether its sender recorded it, so that `time_ns` is the time at which it was sent."""


def merge(folders: Sequence[Path | str] | Path | str, out: Path | str, *, view: bool = False) -> Result:
    """Join the records of robots into the new run directory `out`, and return the run, as `murmur.explore` does.

    With `view`, also write a recording for the dashboard. A folder is the record of one start of a robot, or the record
    directory of a robot, with all its starts.

    Raises
    ------
    ValueError
        A directory is no record of a robot, or damaged; or they are of different teams or missions.
    ScenarioError
        `out` already exists, or cannot be made.
    OSError
        A file cannot be written.
    """
    out = Path(out)
    run_directory.check_free(out)
    named = [folders] if isinstance(folders, str | Path) else folders
    robot_records = [read_robot_record(each) for folder in named for each in starts_in(Path(folder))]
    if not robot_records:
        raise ValueError("folders is empty: name the record directory of at least one robot")
    offsets, error = align(robot_records)
    frames = join(robot_records, offsets)
    starts = [FieldStart(each.record, offset) for each, offset in zip(robot_records, offsets, strict=True)]
    timeline = Timeline.of(starts, [frame.time_ns for frame in frames.values()])
    logs = _logs(frames, timeline)
    plan, records = assemble(starts, timeline, {step: log.ledger_rows(step) for step, log in logs.items()})
    summary = summarize_field(plan, records, starts) | {
        "frames": len(frames),
        "frames_lost": sum(not each.receivers for each in frames.values()),
        "clock_error_s": error / SECOND if error < UNKNOWN else None,
        "isolated_robots": isolated(robot_records),
    }
    run_directory.create(out, plan)
    failures = _write_capture(out / CAPTURE, plan, logs)
    run_directory.write_results(out, plan, records, summary, failures)
    if view:
        record_view(plan, records, out / RECORDING, {step: log.links() for step, log in logs.items()})
    code = EXPLORED if summary["finished"] else NOT_FINISHED
    return Result(summary, code, out, records, {}, plan)


def starts_in(folder: Path) -> list[Path]:
    """Return the directories of all starts in the record directory of a robot, or the one that is a start itself."""
    if folder.is_file():
        raise ValueError(
            f"{folder}: is a file; name record directories of robots in the field (docs/experiments.md tells how to "
            "join tables of runs)"
        )
    found = sorted(folder.glob(START), key=lambda each: (len(each.name), each.name))
    return found or [folder]


def _write_capture(path: Path, plan: Plan, logs: dict[int, FrameLog]) -> list[OSError]:
    """Write the joined capture; return the error if it could not be written."""
    scenario = plan.scenario
    with GrowingFile(path, "wb") as file:
        file.write(
            capture.head(f"{scenario.robots} robots in the field, map encoding {scenario.map_encoding}")
        )
        for step, log in logs.items():
            file.write(capture.encode(step, log))
        return [] if file.failure is None else [file.failure]


def read_robot_record(folder: Path) -> RobotRecord:
    """Read what a robot recorded; ValueError if there is nothing, or capture and frames do not fit each other."""
    record = read_field_record(folder)
    lines = read_frames(folder)
    if others := {line.robot for line in lines} - {record.robot}:
        raise ValueError(f"{folder}: has frames that robot {min(others)} recorded, not robot {record.robot}")
    robot_record = RobotRecord(record, {}, {}, {})
    with open_file(folder / CAPTURE) as file:
        try:
            captured = iter(list(capture.read(pcapng.Reader(file))))
        except CaptureError as error:
            raise ValueError(f"{folder / CAPTURE}: {error}") from None
    for line in lines:
        frame = FrameId(line.sender, line.session, line.counter)
        parts = [next(captured, None) for size in (line.broadcast, line.gossip) if size]
        if None in parts:
            raise ValueError(f"{folder}: the capture ends before frame {line.counter} of robot {line.sender}")
        found = {part.frame == BROADCAST: part for part in parts if part is not None}
        if any((part.sender, part.connection) != (line.sender, line.counter) for part in found.values()):
            raise ValueError(
                f"{folder}: frame {line.counter} of robot {line.sender} is not the one in the capture"
            )
        robot_record.packets[frame] = (
            found[True].payload if True in found else b"",
            found[False].payload if False in found else b"",
        )
        (robot_record.sent if line.sender == robot_record.robot else robot_record.received)[frame] = line
    return robot_record


def align(robot_records: Sequence[RobotRecord]) -> tuple[list[int], int]:
    """Return what to add to the times of each record, and the bound of the error, all in nanoseconds.

    The first record's clock is the common one. Clocks of robots that exchanged no frames agree by the time of day.
    """

    @cache
    def difference(one: int, other: int) -> tuple[int, int] | None:
        return _clock_difference(robot_records[one], robot_records[other])

    offsets, bounds = {0: 0}, {0: 0}
    while len(offsets) < len(robot_records):
        missing = [at for at in range(len(robot_records)) if at not in offsets]
        pairs = [
            (bounds[known] + apart[1], other, offset - apart[0])
            for known, offset in offsets.items()
            for other in missing
            if (apart := difference(known, other)) is not None
        ]
        if not pairs:
            utc = robot_records[0].record.setup.utc_ns
            pairs = [(UNKNOWN, missing[0], robot_records[missing[0]].record.setup.utc_ns - utc)]
        bound, other, offset = min(pairs)
        offsets[other], bounds[other] = offset, bound
    return [offsets[at] for at in range(len(robot_records))], max(bounds.values())


def join(robot_records: Sequence[RobotRecord], offsets: Sequence[int]) -> dict[FrameId, Joined]:
    """Return all frames on the common clock, in the order of time; ValueError if two differ that have one number."""
    frames: dict[FrameId, Joined] = {}
    for robot_record, offset in zip(robot_records, offsets, strict=True):
        for lines, was_sent in ((robot_record.sent, True), (robot_record.received, False)):
            for number, line in lines.items():
                time = line.time_ns + offset
                frame = frames.setdefault(number, Joined(time, line.bytes, robot_record.packets[number]))
                if frame.packets != robot_record.packets[number]:
                    raise ValueError(
                        f"{robot_record.record.folder}: frame {number.counter} of session {number.session} of robot "
                        f"{number.sender} differs from that of another record: not one mission; if the session file of "
                        f"robot {number.sender} was lost between two starts, leave out the records of one of them"
                    )
                if was_sent or not frame.was_sent:
                    frame.time_ns = time if was_sent else min(time, frame.time_ns)
                frame.was_sent |= was_sent
                if not was_sent:
                    frame.receivers.add(robot_record.robot)
    return dict(sorted(frames.items(), key=lambda item: (item[1].time_ns, item[0])))


def isolated(robot_records: Sequence[RobotRecord]) -> list[int]:
    """Return the robots that exchanged no frame with another one, as far as their records show it."""
    heard = {(each.robot, frame.sender) for each in robot_records for frame in each.received}
    return sorted({each.robot for each in robot_records}.difference(*heard))


def _clock_difference(one: RobotRecord, other: RobotRecord) -> tuple[int, int] | None:
    """Return how far the other clock is ahead, and the bound of the error; None without a frame between them.

    If frames arrived in one direction only, the fastest one counts as if it had no delay.
    """
    clock = one.record.setup.clock
    if clock and clock == other.record.setup.clock:
        return 0, 0
    there = [(sent, received - sent) for sent, received in _times(one, other)]
    back = [(received, received - sent) for sent, received in _times(other, one)]
    if there and back:
        offset = (_least(there) - _least(back)) // 2
        return offset, _error_bound(there, back, offset)
    if there or back:
        return (_least(there) if there else -_least(back)), UNKNOWN
    return None


Delays = Sequence[tuple[int, int]]
"""Frames in one direction: the time by the clock of the first robot; the delay plus the difference of the clocks."""


def _least(delays: Delays) -> int:
    return min(delay for _, delay in delays)


def _error_bound(there: Delays, back: Delays, offset: int) -> int:
    """Return by how much the difference of two clocks may differ from `offset`, at the times of all frames.

    No frame arrives before it is sent, so each frame bounds the difference at its time from one side.
    """
    times = sorted({time for time, _ in (*there, *back)})
    pairs = zip(_limits(there, times), _limits(back, times), strict=True)
    return max(max(ahead - offset, behind + offset) for ahead, behind in pairs)


def _limits(delays: Delays, times: Sequence[int]) -> list[int]:
    """Return how far the receiver's clock is ahead at most, at each of some sorted times."""
    least: dict[int, int] = {}
    for time, delay in delays:
        least[time] = min(delay, least.get(time, delay))
    limits = [least.get(time, UNKNOWN) for time in times]
    for order in (range(1, len(times)), range(len(times) - 2, -1, -1)):
        step = order.step
        for at in order:
            apart = abs(times[at] - times[at - step])
            limits[at] = min(limits[at], limits[at - step] + apart * MAX_DRIFT_PPM // 1_000_000)
    return limits


def _times(sender: RobotRecord, receiver: RobotRecord) -> list[tuple[int, int]]:
    """Return when each frame between two robots was sent, and received, by the clock of each."""
    return [
        (line.time_ns, receiver.received[number].time_ns)
        for number, line in sender.sent.items()
        if number in receiver.received
    ]


def _logs(frames: dict[FrameId, Joined], timeline: Timeline) -> dict[int, FrameLog]:
    """Return the log of each step in which there are frames."""
    logs: defaultdict[int, FrameLog] = defaultdict(FrameLog)
    for number, frame in frames.items():
        log, receivers = logs[timeline.step(frame.time_ns)], sorted(frame.receivers)
        names = ", ".join(f"r{robot}" for robot in receivers) or "none"
        sealed = f"frame {number.counter} of session {number.session}, {frame.size} bytes sealed"
        cause = CAUSES.index("" if receivers else "loss")
        for content in contents(*frame.packets):
            sent = Frame(number.sender, EVERYONE, content, connection=number.counter)
            log.add(0, sent, content, cause, receivers=receivers, fate=f"received by {names}: {sealed}")
    return logs
