"""Records that a robot in the field makes of its radio: every frame that it sent, or received from a teammate.

    radio.pcapng    the packets of each frame, for Wireshark
    frames.csv      one line per frame: when, and its number, by which the directories of several robots are joined
    ledger.parquet  one row per frame and kind of packet; the bytes of packets, without those of sealing

The first two are written in each step, so that they survive the end of the process at any moment; `LinkRecorder.close`
writes the last one. In capture and ledger, `connection` is the counter of the sealed frame. A frame that this robot
sent has no receivers there: a sender without a relay does not know them. Broadcast and gossip of one frame are two
rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from agent.radios.options import MAX_FRAME
from agent.radios.peer_medium import FrameRecord
from agent.radios.replay_window import MAX_COUNTER, MAX_SESSION
from deploy.record.arrow_tables import write_table
from deploy.record.growing_file import GrowingFile, close_all, read_rows
from deploy.record.run_directory import CAPTURE, LEDGER, ledger_table
from netshaper import capture
from netshaper.admission import content_of
from netshaper.frame_log import Content, Frame, FrameLog
from netshaper.ledger import BROADCAST, CAUSES, EVERYONE, NEWS, ROW
from protocol.grid import MAX_ROBOTS
from protocol.message_fields import MAX_STEPS

FRAMES = "frames.csv"


Robot = Annotated[int, Meta(ge=0, lt=MAX_ROBOTS)]
Size = Annotated[int, Meta(ge=0, le=MAX_FRAME)]
Nanoseconds = Annotated[int, Meta(ge=1 - 2**63, le=2**63 - 1)]


class FrameLine(NamedTuple):
    """A line of ``frames.csv``. All columns are integers.

    `robot`: the robot that recorded it, and `time_ns` when, by its clock. `sender`, `session`, `counter`: the number of
    the frame. `bytes`: of the sealed frame. `broadcast`, `gossip`: bytes of its packets.
    """

    robot: Robot
    time_ns: Nanoseconds
    step: Annotated[int, Meta(ge=0, le=MAX_STEPS)]
    sender: Robot
    session: Annotated[int, Meta(ge=0, le=MAX_SESSION)]
    counter: Annotated[int, Meta(ge=0, le=MAX_COUNTER)]
    bytes: Size
    broadcast: Size
    gossip: Size


def contents(broadcast: bytes, gossip: bytes) -> list[Content]:
    """Return the parts of a frame that are not empty, for a log."""
    return [
        content_of(kind, packets) for kind, packets in ((BROADCAST, broadcast), (NEWS, gossip)) if packets
    ]


def frame_log(robot: int, records: Sequence[FrameRecord]) -> FrameLog:
    """Return the frames of a step of one robot as a log, for ledger and capture."""
    log = FrameLog()
    for each in records:
        received = each.sender != robot
        number = f"frame {each.counter} of session {each.session}, {each.size} bytes sealed"
        fate = f"received by r{robot}: {number}" if received else f"sent: {number}"
        for content in contents(each.broadcast, each.gossip):
            frame = Frame(each.sender, EVERYONE, content, connection=each.counter)
            receivers = (robot,) if received else ()
            log.add(0, frame, content, CAUSES.index(""), receivers=receivers, fate=fate)
    return log


class LinkRecorder:
    """Writes the directory of one robot; FileExistsError if it has a capture already."""

    def __init__(self, folder: Path, robot: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self._robot = robot
        self._capture = GrowingFile(folder / CAPTURE, "xb")
        self._capture.write(capture.head(f"radio of robot {robot} in the field"))
        self._frames = GrowingFile(folder / FRAMES, "xb")
        self._frames.write_rows([FrameLine._fields])
        self._rows: list[bytes] = []

    def record(self, step: int, records: Sequence[FrameRecord]) -> None:
        """Take the frames of a step; those of equal steps may come in several calls."""
        log = frame_log(self._robot, records)
        if len(log):
            self._capture.write(capture.encode(step, log))
            self._rows.append(log.ledger_rows(step))
        self._frames.write_rows(
            FrameLine(
                self._robot, each.time, step, each.sender, each.session, each.counter, each.size,
                len(each.broadcast), len(each.gossip),
            )
            for each in records
        )  # fmt: skip

    def close(self) -> None:
        """Write the ledger; OSError if one of the files could not be written."""
        write_table(self.folder / LEDGER, ledger_table(np.frombuffer(b"".join(self._rows), ROW)))
        close_all([self._capture, self._frames])


def read_frames(folder: Path) -> list[FrameLine]:
    """Read ``frames.csv``, up to its last whole line; ValueError if it is no such file, or damaged."""
    return read_rows(folder / FRAMES, FrameLine)
