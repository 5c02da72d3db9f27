"""A robot in the field: it runs by its own clock, with a real body and a radio without a relay (docs/field.md).

A step begins when the last one has lasted for its time, whether or not other robots have finished theirs:

    begin     take the readings of the body, draw the map, schedule a frame
    exchange  send the frame when it is due, and take what arrives, until the step is over
    end       merge the maps that arrived, choose a target, and let the body move

A body that gives no readings, because it does not know its pose, keeps the robot silent and still in that step. So does
a pose that has jumped (`agent.pose_guard`).
`FieldRobot` reads no clock: its caller passes the time. `drive` is the loop around it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import msgspec
from msgspec.structs import replace

from agent.encodings.catalog import encoding_class
from agent.encodings.scans import ScanEncoding
from agent.identity import Identity
from agent.journal import Journal, journal_name
from agent.pose_guard import PoseGuard
from agent.radio_events import ReportError, respond
from agent.radios.options import LinkOptions
from agent.radios.peer_medium import FrameRecord, PeerMedium
from agent.radios.sealing import Opener, Sealer
from agent.radios.session_file import SessionFile
from agent.radios.transport import Transport
from agent.replication.policies import GOSSIP
from agent.robot import Robot
from agent.settings import Settings
from protocol.grid import FINE, Cell
from protocol.messages import Move, Sense
from protocol.nanoseconds import SECOND

FAREWELLS = 3
"""How often a robot tells teammates that it has ended: frames may be lost."""
FAREWELL_NS = 5 * SECOND
"""Time limit for these frames; a radio that may not send in this time sends fewer, or none."""
FAREWELL_TICK_NS = SECOND // 50


class Body(Protocol):
    """What provides a robot's readings and takes its moves."""

    def sense(self, step: int) -> Sense | None:
        """Return the readings of this step; None if the pose is not known."""

    def move(self, move: Move, target: Cell | None) -> None:
        """Begin to move; a move that is still under way ends. `target` is where the robot finally drives."""

    def stop(self) -> None:
        """Stand still."""


def field_settings(settings: Settings, options: LinkOptions) -> Settings:
    """Return a robot's settings with those that a radio without a relay requires; ValueError if it cannot have them."""
    if settings.replication.dissemination != GOSSIP:
        raise ValueError(
            f"dissemination = {settings.replication.dissemination!r}: must be {GOSSIP!r} without a relay"
        )
    replication = replace(settings.replication, requires_acks=True, checks_reach=False)
    medium = replace(settings.medium, frame_bytes=options.packet_bytes)
    return replace(settings, replication=replication, medium=medium)


def team_context(settings: Settings, others: Sequence[float | str] = ()) -> bytes:
    """Return a hash of all values that must be equal on all robots of a team (`agent.radios.sealing`).

    These are some of the settings, and `others`.

    Encodings that send scans need equal lasers: a receiver cannot read scans of a laser that it does not know.
    Exact scans are predicted from the hardware of their author and the limits of the medium.
    """
    is_scan = issubclass(encoding_class(settings.encoding.name), ScanEncoding)
    common = (
        settings.robots,
        settings.incarnations,
        settings.width,
        settings.height,
        settings.resolution,
        settings.encoding,
        settings.replication.digests,
        settings.shares_tiles,
        settings.laser if is_scan else None,
        None if settings.shares_tiles else (settings.bodies, settings.beams, settings.medium),
        *others,
    )
    return hashlib.sha256(msgspec.json.encode(common)).digest()[:8]


@dataclass(frozen=True)
class FieldFiles:
    """The files of one robot that survive its process, open and locked."""

    key: bytes
    session: SessionFile
    identity: Identity

    @classmethod
    def open(cls, folder: Path, key: bytes, settings: Settings, sessions: Path | None = None) -> FieldFiles:
        """Open or create the files in a directory; SessionFileError or JournalError if they do not fit the robot.

        The session file, which lasts as long as the key, is in the directory `sessions`, if that is given.
        """
        path = (sessions or folder) / f"r{settings.robot}.session"
        session = SessionFile(path, key, settings.robot, settings.robots)
        return cls(key, session, Identity(Journal.open(folder / journal_name(settings.robot))))


class FieldRobot:
    """One robot in the field.

    `settings` are those of a run with gossip; `now` is the time in nanoseconds. The constructor begins a new
    incarnation of the robot, and a new session of its radio. `report` is called with each error of a teammate, as text.
    `common`: further values that must be equal on all robots of the team (`team_context`).
    """

    def __init__(
        self,
        settings: Settings,
        options: LinkOptions,
        files: FieldFiles,
        body: Body,
        transport: Transport,
        guard: PoseGuard,
        now: int,
        report: ReportError = lambda _: None,
        record: Callable[[int, list[FrameRecord]], object] = lambda _step, _records: None,
        common: Sequence[float | str] = (),
    ) -> None:
        settings = files.identity.begin(field_settings(settings, options))
        key, session, context = files.key, files.session, team_context(settings, common)
        self.robot = Robot(settings)
        self.medium = PeerMedium(
            settings.robot,
            options.longest,
            Sealer(key, settings.robot, session.session, context),
            Opener(key, settings.robot, settings.robots, session.highest, context),
            options.pacer(settings.seed, settings.robot, now),
            options.timing(),
            session.note,
        )
        self.move: Move | None = None
        """The last move; None in steps without readings that can be relied on."""
        self.unsent = 0
        """Frames that the transport did not take."""
        self.begin = now
        """When this step began, in nanoseconds."""
        self.sense: Sense | None = None
        """The readings of this step; None without ones that can be relied on."""
        self.late_steps = 0
        """Steps that took longer than they should, and shifted all later ones."""
        self._files = files
        self._body = body
        self._transport = transport
        self._guard = guard
        self._report = report
        self.record = record
        """Called at the end of each step, with its number and the frames that were sent and received."""
        self._step = 0

    @property
    def has_jumped(self) -> bool:
        """Whether the pose has jumped, and has not settled since."""
        return self._guard.has_jumped

    def begin_step(self, step: int, now: int) -> None:
        """Take the body's readings, and schedule this step's frame."""
        self._step, self.begin = step, now
        sense = self._body.sense(step)
        if sense is not None and not self._guard.accept(*position(sense), now):
            sense = None
        self.sense = sense
        if sense is None:
            return
        self._files.identity.settle(sense.x, sense.y)
        self.robot.perceive(sense)
        frames = respond(self.robot, self.medium.begin_step(step, now), self._report)
        if frames is not None:
            self.medium.submit(frames, now)

    def exchange(self, now: int) -> None:
        """Send the frames that are due, and take those that have arrived."""
        for frame in self.medium.poll(now):
            self.unsent += not self._transport.send(frame)
        for frame in self._transport.receive():
            self.medium.receive(frame, now)

    def end_step(self) -> None:
        """Merge what arrived, decide, and let the body move; without readings, let it stand still."""
        if self.sense is not None:
            self.robot.replication.ended = self.medium.neighbors.ended()
            for event in self.medium.end_step():
                respond(self.robot, event, self._report)
            self.move = self.robot.decide()
            self._body.move(self.move, self.robot.target)
        else:
            self.move = None
            self._body.stop()
        for error in self.robot.peer_errors:
            self._report(f"{error.kind} from robot {error.peer}: {error.reason}")
        self.robot.peer_errors.clear()
        records, self.medium.records = self.medium.records, []
        self.record(self._step, records)
        self._files.session.sync()

    def end(self, clock: Callable[[], int], wait: Callable[[int], object]) -> None:
        """Let the body stand still, tell teammates, and close radio and files; the arguments are as for `drive`."""
        try:
            self._body.stop()
            self._say_farewell(clock, wait)
        finally:
            self._transport.close()
            self._files.session.close()

    def _say_farewell(self, clock: Callable[[], int], wait: Callable[[int], object]) -> None:
        """Tell teammates that this robot has ended, as often as the radio may send within the time limit."""
        left = FAREWELLS if self.robot.settings.robots > 1 else 0
        end = (now := clock()) + FAREWELL_NS
        while now < end and (left or self.medium.deadline() is not None):
            left -= left > 0 and self.medium.say_farewell(now)
            for frame in self.medium.poll(now):
                self.unsent += not self._transport.send(frame)
            wait(FAREWELL_TICK_NS)
            now = clock()


def position(sense: Sense) -> tuple[float, float]:
    """Return the position of a body, in cells; whole numbers are centers of cells."""
    return sense.x + sense.offset_x / FINE, sense.y + sense.offset_y / FINE


def drive(
    robot: FieldRobot,
    step_ns: int,
    clock: Callable[[], int],
    wait: Callable[[int], object],
    is_over: Callable[[int], bool],
) -> int:
    """Play steps of `step_ns` nanoseconds until `is_over`, called with the number of steps so far; return late steps.

    `clock` returns the time in nanoseconds; `wait` waits for so many of them, or until a frame has arrived. A step
    that begins late, because the last one took too long, shifts all later ones. In any case, the body then stops, and
    the robot says farewell.
    """
    step = 0
    begin = clock()
    try:
        while not is_over(step):
            step += 1
            robot.begin_step(step, begin)
            end = begin + step_ns
            robot.exchange(now := clock())
            robot.late_steps += now >= end
            while now < end:
                due = robot.medium.deadline()
                wait((end if due is None else max(now, min(due, end))) - now)
                robot.exchange(now := clock())
            robot.end_step()
            begin = max(end, now)
    finally:
        robot.end(clock, wait)
    return robot.late_steps
