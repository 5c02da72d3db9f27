"""`murmur merge`: join what several robots in the field recorded into one directory, on one clock.

Each robot recorded by its own clock. A frame that one robot sent and another received gives the difference of their
clocks, plus the time that the frame took. The smallest difference in each direction has the least delay; half the
difference of both is the offset of the clocks, as in NTP (RFC 5905, section 8), and half their sum bounds its error.
Clocks are aligned along the pairs with the smallest sums of bounds. Drift is not corrected.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from deploy.record.link_records import FrameLine, contents, read_frames, write_ledger
from deploy.record.run_directory import CAPTURE, CaptureFile
from netshaper import capture, pcapng
from netshaper.frame_log import Frame, FrameLog
from netshaper.ledger import BROADCAST, CAUSES, EVERYONE
from netshaper.pcapng import CaptureError
from protocol.files import open_file
from protocol.messages import MAX_STEPS

STEP_NS = 1_000_000_000
"""Nanoseconds of a step of the joined capture and ledger."""

UNKNOWN = 1 << 62
"""The bound of an error about which nothing is known."""


class FrameId(NamedTuple):
    """The number of a frame, in all directories."""

    sender: int
    session: int
    counter: int


@dataclass(frozen=True)
class Recording:
    """What one process of a robot recorded."""

    folder: Path
    robot: int
    sent: dict[FrameId, FrameLine]
    received: dict[FrameId, FrameLine]
    packets: dict[FrameId, tuple[bytes, bytes]]
    """Broadcast and gossip of each frame."""


@dataclass
class Joined:
    """A frame, as all robots recorded it."""

    time_ns: int
    size: int
    packets: tuple[bytes, bytes]
    receivers: set[int] = field(default_factory=set)
    was_sent: bool = False
    """Whether its sender recorded it, so that `time_ns` is the time at which it was sent."""


class Merged(NamedTuple):
    """The result of a merge: the number of frames, those that no recording received, and the bound of the error."""

    frames: int
    lost: int
    error_ns: int


def merge(folders: Sequence[Path], out: Path) -> Merged:
    """Join the directories of robots, and write ``radio.pcapng`` and ``ledger.parquet`` to a new directory.

    Raises
    ------
    ValueError
        A directory has no frames, its files do not fit each other, or its robot exchanged no frames with the others.
    FileExistsError
        `out` has a capture already.
    """
    recordings = [read_recording(folder) for folder in folders]
    offsets, error = align(recordings)
    frames = join(recordings, offsets)
    logs = _logs(frames)
    out.mkdir(parents=True, exist_ok=True)
    rows: list[bytes] = []
    with CaptureFile(out / CAPTURE, "xb") as file:
        file.write(capture.head(f"radio of {len({each.robot for each in recordings})} robots in the field"))
        for step, log in logs:
            file.write(capture.encode(step, log))
            rows.append(log.ledger_rows(step))
        if file.failure is not None:
            raise file.failure
    write_ledger(out, rows)
    return Merged(len(frames), sum(not each.receivers for each in frames.values()), error)


def read_recording(folder: Path) -> Recording:
    """Read what a robot recorded; ValueError if there is nothing, or capture and frames do not fit each other."""
    lines = read_frames(folder)
    if not lines:
        raise ValueError(f"{folder} has no frames")
    recording = Recording(folder, lines[0].robot, {}, {}, {})
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
        recording.packets[frame] = (
            found[True].payload if True in found else b"",
            found[False].payload if False in found else b"",
        )
        (recording.sent if line.sender == recording.robot else recording.received)[frame] = line
    return recording


def align(recordings: Sequence[Recording]) -> tuple[list[int], int]:
    """Return what to add to the times of each recording, and the bound of the error, all in nanoseconds.

    The first recording's clock is the common one. ValueError if a robot exchanged no frames with the others.
    """
    offsets, bounds = {0: 0}, {0: 0}
    while len(offsets) < len(recordings):
        missing = [at for at in range(len(recordings)) if at not in offsets]
        pairs = [
            (bounds[known] + difference[1], other, offset - difference[0])
            for known, offset in offsets.items()
            for other in missing
            if (difference := _clock_difference(recordings[known], recordings[other])) is not None
        ]
        if not pairs:
            apart = ", ".join(str(recordings[at].folder) for at in missing)
            raise ValueError(
                f"no frames between {apart} and the other directories, so their clocks cannot be aligned"
            )
        bound, other, offset = min(pairs)
        offsets[other], bounds[other] = offset, bound
    return [offsets[at] for at in range(len(recordings))], max(bounds.values())


def join(recordings: Sequence[Recording], offsets: Sequence[int]) -> dict[FrameId, Joined]:
    """Return all frames on the common clock, in the order of time."""
    frames: dict[FrameId, Joined] = {}
    for recording, offset in zip(recordings, offsets, strict=True):
        for lines, was_sent in ((recording.sent, True), (recording.received, False)):
            for number, line in lines.items():
                time = line.time_ns + offset
                frame = frames.setdefault(number, Joined(time, line.bytes, recording.packets[number]))
                if was_sent or not frame.was_sent:
                    frame.time_ns = time if was_sent else min(time, frame.time_ns)
                frame.was_sent |= was_sent
                if not was_sent:
                    frame.receivers.add(recording.robot)
    return dict(sorted(frames.items(), key=lambda item: (item[1].time_ns, item[0])))


def _clock_difference(one: Recording, other: Recording) -> tuple[int, int] | None:
    """Return how far the other clock is ahead, and the bound of the error; None without a frame between them.

    If frames arrived in one direction only, the fastest one counts as if it had no delay.
    """
    there, back = _delays(one, other), _delays(other, one)
    if there and back:
        return (min(there) - min(back)) // 2, max(0, min(there) + min(back)) // 2
    if there or back:
        return (min(there) if there else -min(back)), UNKNOWN
    return None


def _delays(sender: Recording, receiver: Recording) -> list[int]:
    """Return the delay of each frame between two robots, plus how far the receiver's clock is ahead."""
    return [
        receiver.received[number].time_ns - line.time_ns
        for number, line in sender.sent.items()
        if number in receiver.received
    ]


def _logs(frames: dict[FrameId, Joined]) -> list[tuple[int, FrameLog]]:
    """Return the log of each step, from 1, in which there are frames; ValueError if there are too many steps."""
    logs: defaultdict[int, FrameLog] = defaultdict(FrameLog)
    begin = min((frame.time_ns for frame in frames.values()), default=0)
    for number, frame in frames.items():
        step = 1 + (frame.time_ns - begin) // STEP_NS
        if step > MAX_STEPS:
            raise ValueError(f"the frames are {step} seconds apart: one of the clocks was set in between")
        names = ", ".join(f"r{robot}" for robot in sorted(frame.receivers)) or "none"
        sealed = f"frame {number.counter} of session {number.session}, {frame.size} bytes sealed"
        cause = "" if frame.receivers else "loss"
        for content in contents(*frame.packets):
            sent = Frame(number.sender, EVERYONE, content, connection=number.counter)
            receivers, fate = sorted(frame.receivers), f"received by {names}: {sealed}"
            logs[step].add(0, sent, content, CAUSES.index(cause), receivers=receivers, fate=fate)
    return list(logs.items())
