"""The recorder: it receives the reports of world, relay and robots, and keeps the results of a run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from agent.settings import Settings
from deploy.record.map_collection import MapCollection
from deploy.record.map_history import MapHistory
from netshaper.ledger import ROW
from netshaper.process import ENDED
from protocol import keys as names
from protocol import messages, rights
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.grid import Grid, Mask
from protocol.keys import Keys
from protocol.message_codec import pack
from protocol.rights import MAX_PROTOCOL_ERRORS, TOO_MANY_BYTES, TOO_MANY_ERRORS

NO_MAPS = "it did not send its maps"
"""Cause of the loss of a robot that does not answer a request for its maps."""
MAX_TEXTS = 1000
"""Number of protocol errors of each sender of which the text is kept."""
MIN_STEP_BYTES, BYTES_PER_CELL = 1 << 22, 10
"""Bytes that a robot may report in a step: these, and these for each cell, since it may report each cell twice."""


@dataclass
class ProtocolErrors:
    """Protocol errors by sender."""

    texts: list[str] = field(default_factory=list)
    """Sender and text of the first `MAX_TEXTS` errors of each sender, in the order of arrival."""
    counts: Counter[str] = field(default_factory=Counter)

    def add(self, sender: str, text: str) -> None:
        """Record an error of a sender."""
        self.counts[sender] += 1
        if self.counts[sender] <= MAX_TEXTS:
            self.texts.append(f"{sender}: {text}")


@dataclass(repr=False)
class Records:
    """All data reported during a run so far."""

    robots: int
    maps: MapHistory
    """The robots' maps over time, if the run records them."""
    world: list[messages.WorldReport] = field(default_factory=list)
    """One report per step."""
    statuses: list[list[messages.RobotStatus]] = field(default_factory=list)
    """The reports of each robot, by its number."""
    rows: list[bytes] = field(default_factory=list)
    """The rows of the ledger (`netshaper.ledger.ROW`), step by step."""
    own: dict[int, Grid] = field(default_factory=dict)
    """The final self-explored grid of each robot that has sent its maps."""
    planning: dict[int, Grid] = field(default_factory=dict)
    """The final planning grids of these robots."""
    shared: dict[int, Grid] = field(default_factory=dict)
    """Their final shared grids."""
    settled: dict[int, Mask] = field(default_factory=dict)
    """The cells of their self-explored grids of which they are certain."""
    lost: dict[int, str] = field(default_factory=dict)
    """The cause of each unexpected failure, by robot."""
    fault_events: list[messages.FaultEvent] = field(default_factory=list)
    """The faults that have occurred, except for restarts of lost robots."""
    changes: list[messages.Change] = field(default_factory=list)
    """The changes of the radio that have occurred."""
    killed: set[int] = field(default_factory=set)
    """Robots that a fault event killed and none restarted."""
    returned: list[tuple[int, int]] = field(default_factory=list)
    """Step and robot of each return after an unexpected failure."""
    reconnected: list[tuple[int, int]] = field(default_factory=list)
    """Step and robot of each connection that was cut and restored."""
    missed: list[messages.Missed] = field(default_factory=list)
    """Phases of steps that robots missed by the wall clock; with the scenario, they repeat the run."""
    protocol_errors: ProtocolErrors = field(default_factory=ProtocolErrors)
    end: messages.End | None = None
    """How the run ended; None as long as it has not."""
    carried: int = 0
    """Number of bytes transmitted in the last step."""
    known_at: int | None = None
    """The first step at whose end a robot knew the full map (`deploy.record.map_quality.knows_all`); 0 before.

    None in runs as processes: no report has the planning grid of each step.
    """

    def __post_init__(self) -> None:
        self.statuses = [[] for _ in range(self.robots)]

    def __repr__(self) -> str:
        return f"<records of {self.robots} robots, up to step {self.step}>"

    @property
    def step(self) -> int:
        """The last step that the world has opened."""
        return self.world[-1].step if self.world else 0

    @property
    def explored(self) -> float:
        """Fraction of the reachable free cells that the team has seen."""
        return self.world[-1].seen / self.world[-1].reachable if self.world else 0.0

    @property
    def has_all_grids(self) -> bool:
        """Whether the grids contain all cells that any robot has seen: no robot ended without sending its grids."""
        ended = {event.kind for event in self.fault_events} & {"kill", "restart"}
        return not (self.lost or self.returned or ended)

    def team_map(self, without: Collection[int] = ()) -> Grid:
        """Return the union of the robots' own grids, without those of some robots."""
        grids = [grid for robot, grid in self.own.items() if robot not in without]
        return np.maximum.reduce(grids) if grids else np.zeros_like(next(iter(self.own.values())))

    def ledger(self) -> NDArray[np.void]:
        """All rows of the ledger so far (`netshaper.ledger.ROW`), in the order of recording."""
        return np.frombuffer(b"".join(self.rows), ROW)


class RecorderNode:
    """The recorder's end of the bus; `done` once all results have arrived.

    The recorder accepts from each participant only reports about itself; any other message is a protocol error.
    `shape` is height and width of the run's map. `capture` receives the frames of each step, which are not kept in
    memory. `on_fault` is called with each fault event, so that the launcher can kill and restart processes.
    """

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        robots: int,
        shape: tuple[int, int],
        capture: BinaryIO | None = None,
        on_fault: Callable[[messages.FaultEvent], object] = lambda _: None,
    ) -> None:
        self.done = False
        self.records = Records(robots, MapHistory(shape))
        self._collection = MapCollection(shape)
        self._broken_down: set[int] = set()
        """Robots that report their maps before the end."""
        self._capture = capture
        self._bus = bus
        self._keys = keys
        self._protocol_errors: Counter[str] = Counter()
        """Number of protocol errors of each sender in this step."""
        self._received_bytes: Counter[str] = Counter()
        """Bytes of each robot's reports in this step."""
        self._max_step_bytes = MIN_STEP_BYTES + BYTES_PER_CELL * shape[0] * shape[1]
        self._on_fault = on_fault

    def configure(self, settings: Mapping[int, Settings]) -> None:
        """Send each robot its settings by way of the relay; once, when this recorder has joined."""
        for robot, task in settings.items():
            self._send(messages.Configure(robot, task.encode()))

    def handle(self, message: Message) -> None:
        """Take one message from the bus."""
        sender = names.parts(message.key)[3]
        if self._exceeds_limits(sender):
            return
        try:
            self._record(sender, rights.read(*message))
            self._received_bytes[sender] += len(message.payload)
        except ProtocolError as error:
            self._record_protocol_error(sender, str(error))
        self._collect()

    def _exceeds_limits(self, sender: str) -> bool:
        """Return whether a robot has sent too much in this step, or is lost; give it up when it exceeds the limit."""
        if not names.is_robot(sender) or names.number(sender) in self.records.lost:
            return names.is_robot(sender)
        if self._received_bytes[sender] <= self._max_step_bytes:
            return False
        cause = TOO_MANY_BYTES.format(self._max_step_bytes)
        self.records.lost[names.number(sender)] = cause
        self._send(messages.Lost(names.number(sender), cause))
        return True

    @property
    def parts_received(self) -> int:
        """Number of parts of maps that have arrived."""
        return self._collection.parts_received

    def _collect(self) -> None:
        """Request maps that are due, and shut the run down once all have arrived."""
        ended = self.records.end is not None
        if self.done or not (ended or self._broken_down):
            return
        missing = self.missing()
        due = missing if ended else [robot for robot in missing if robot in self._broken_down]
        for robot, part in self._collection.begin(due):
            self._request(robot, part)
        if ended and not missing:
            self.shut_down()

    def _request(self, robot: int, part: int) -> None:
        end = self.records.end
        step = self.records.step if end is None or end.step < 0 else end.step
        self._send(messages.RequestMaps(robot, step, part))

    def _record_protocol_error(self, sender: str, text: str) -> None:
        """Record a protocol error; a robot that exceeds `MAX_PROTOCOL_ERRORS` in a step counts as lost."""
        self.records.protocol_errors.add(sender, text)
        self._protocol_errors[sender] += 1
        if self._protocol_errors[sender] == MAX_PROTOCOL_ERRORS + 1 and names.is_robot(sender):
            self._send(messages.Lost(names.number(sender), TOO_MANY_ERRORS))

    def _record(self, sender: str, message: object) -> None:
        """Record a message that its sender may send; ProtocolError if its content is invalid."""
        records = self.records
        match message:
            case messages.WorldReport():
                records.world.append(message)
                self._protocol_errors.clear()
                self._received_bytes.clear()
            case messages.RadioReport():
                self._record_radio(message)
            case messages.RobotStatus():
                self._record_status(self._number(sender), message)
            case messages.Lost(robot=robot):
                if robot not in records.killed:
                    records.lost[robot] = message.cause
            case messages.Back(robot=robot):
                if records.lost.pop(robot, None) is not None:
                    records.returned.append((records.step, robot))
            case messages.Reconnected(robot=robot):
                records.reconnected.append((records.step, robot))
            case messages.Missed():
                records.missed.append(message)
            case messages.FaultEvent():
                self._record_fault_event(message)
            case messages.Change():
                records.changes.append(message)
            case messages.ErrorReport():
                reported_by_core = sender in (names.RELAY, names.WORLD)
                records.protocol_errors.add(
                    message.participant if reported_by_core else sender, message.reason
                )
            case messages.End():
                records.end = message
            case messages.MapPart():
                self._record_part(self._number(sender), message)
            case messages.MapChanges() | messages.Outlines():
                self._record_map_changes(self._number(sender), message)

    def _record_radio(self, report: messages.RadioReport) -> None:
        if len(report.rows) % ROW.itemsize:
            raise ProtocolError("RadioReport", 0, f"{len(report.rows)} bytes are not whole ledger rows")
        self.records.rows.append(report.rows)
        self.records.carried = report.carried
        if self._capture is not None:
            self._capture.write(report.frames)

    def _record_status(self, robot: int, status: messages.RobotStatus) -> None:
        """Record a robot's status; at most one per step is valid."""
        statuses = self.records.statuses[robot]
        first, last = (statuses[-1].step if statuses else 0) + 1, self.records.step + 1
        if not first <= status.step <= last:
            raise ProtocolError("RobotStatus", 0, f"step {status.step} is not within {first} to {last}")
        statuses.append(status)

    def _record_part(self, robot: int, part: messages.MapPart) -> None:
        """Record a part of a robot's maps, and request the next one."""
        final, records = self._collection.take(robot, part), self.records
        if final is None:
            self._request(robot, part.part + 1)
        else:
            records.own[robot], records.planning[robot] = final.own, final.planning
            records.shared[robot], records.settled[robot] = final.shared, final.settled

    def _record_map_changes(self, robot: int, changes: messages.MapChanges | messages.Outlines) -> None:
        """Record changes of a robot's maps, of a step that has begun."""
        if changes.step > self.records.step + 1:
            name = type(changes).__name__
            raise ProtocolError(name, 0, f"of step {changes.step}, after step {self.records.step}")
        self.records.maps.take(robot, changes)

    def _number(self, sender: str) -> int:
        """The number of the sending robot; ProtocolError if the run has no such robot."""
        number = names.number(sender)
        if number >= self.records.robots:
            raise ProtocolError("message", 0, f"there is no robot {number}")
        return number

    def _record_fault_event(self, event: messages.FaultEvent) -> None:
        """Record a fault event; the restart of a lost robot is a recovery, not a fault."""
        records, robot = self.records, event.robot
        if event.kind == "death":
            self._broken_down.add(robot)
        elif event.kind == "kill":
            records.killed.add(robot)
            records.lost.pop(robot, None)
        elif event.kind == "restart":
            records.killed.discard(robot)
            self._broken_down.discard(robot)
            for grids in (records.own, records.planning, records.shared, records.settled):
                grids.pop(robot, None)
        if event.kind != "restart" or robot not in records.lost:
            records.fault_events.append(event)
        self._on_fault(event)

    def missing(self) -> list[int]:
        """Robots whose maps have not arrived."""
        records = self.records
        gone = records.own.keys() | records.lost.keys() | records.killed
        return [robot for robot in range(records.robots) if robot not in gone]

    def give_up_requested(self) -> None:
        """Continue without the maps that have been requested and have not arrived; their robots count as lost.

        Before the end of the run, shut it down.
        """
        if self.records.end is None:
            self.shut_down()
            return
        for robot in self._collection.under_way:
            self.records.lost[robot] = NO_MAPS
        self._collect()

    def request(self, event: messages.FaultEvent | messages.Change) -> None:
        """Request a fault or a change of the radio that is not in the scenario, for the next step."""
        self._send(event)

    def stop(self, reason: str) -> None:
        """Request that the world ends the run after this step."""
        self._send(messages.Stop(reason))

    def report_end(self, robot: int) -> None:
        """Report to the relay that the process of a robot has ended, so that it does not wait for the robot."""
        self._send(messages.Lost(robot, ENDED))

    def shut_down(self) -> None:
        """Notify all participants that all results are recorded and that they can shut down."""
        self.done = True
        self._send(messages.Shutdown())

    def _send(self, message: messages.Record) -> None:
        self._bus.put(self._keys.control_tx(names.RECORDER), pack(message))
