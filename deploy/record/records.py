"""The laboratory: it listens to world, relay and robots, and keeps the data for a run's results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from agent.settings import Settings
from deploy.record.map_history import MapHistory
from deploy.record.wire_bytes import Meter
from netshaper.ledger import ROW
from protocol import keys as names
from protocol import rights
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.grid import OCCUPIED, Grid
from protocol.keys import Keys
from protocol.messages import (
    Back,
    Change,
    Configure,
    End,
    Fault,
    FaultEvent,
    Lost,
    MapChanges,
    Maps,
    Outlines,
    RadioReport,
    RobotStatus,
    Shutdown,
    Stop,
    WorldReport,
    pack,
)
from protocol.rights import MAX_PROTOCOL_ERRORS, TOO_MANY_ERRORS

MAX_PROTOCOL_ERROR_TEXTS = 1000
"""Faults that are kept in words; more are counted."""


@dataclass(repr=False)
class Records:
    """Everything reported of a run so far."""

    robots: int
    maps: MapHistory
    """The robots' maps over time, if the run records them."""
    world: list[WorldReport] = field(default_factory=list)
    statuses: list[list[RobotStatus]] = field(default_factory=list)
    rows: list[bytes] = field(default_factory=list)
    own: dict[int, Grid] = field(default_factory=dict)
    """Self-explored grids, by robot, at the end."""
    planning: dict[int, Grid] = field(default_factory=dict)
    lost: dict[int, str] = field(default_factory=dict)
    """Robots that died unexpectedly, and how."""
    fault_events: list[FaultEvent] = field(default_factory=list)
    """Scheduled and requested faults that have occurred, in order."""
    changes: list[Change] = field(default_factory=list)
    """When budget and range of the radio became others."""
    killed: set[int] = field(default_factory=set)
    """Robots that were killed as asked for, and have not been restarted."""
    returned: list[tuple[int, int]] = field(default_factory=list)
    """(step, robot): robots that had been lost unasked, and came back."""
    protocol_errors: list[str] = field(default_factory=list)
    """Who said what that made no sense: the first `MAX_PROTOCOL_ERROR_TEXTS` of them."""
    protocol_error_count: int = 0
    """How many faults there were."""
    end: End | None = None
    carried: int = 0
    """Bytes on the air in the last step."""
    wire_bytes: int | None = None
    """Bytes that the bus has moved (`deploy.record.wire_bytes`); None if it is not available."""

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
        """Whether what every robot has seen is among the grids: no life has ended without handing them in."""
        return not (
            self.lost or self.returned or {event.kind for event in self.fault_events} & {"kill", "restart"}
        )

    def note_protocol_error(self, who: str, what: str) -> None:
        """Record that `who` said what made no sense."""
        self.protocol_error_count += 1
        if len(self.protocol_errors) < MAX_PROTOCOL_ERROR_TEXTS:
            self.protocol_errors.append(f"{who}: {what}")

    def ledger(self) -> NDArray[np.void]:
        """All rows of the ledger so far (`netshaper.ledger.ROW`), in the order in which they were recorded."""
        return np.frombuffer(b"".join(self.rows), ROW)


class RecorderNode:
    """The laboratory's end of the bus; `done` once everything has been handed in.

    Each participant is believed what is its to say, of itself; all else is a fault. `shape` is that of the run's
    map. What the relay reports for the capture is written to `capture` step by step, and not kept; `meter` counts
    the bytes that the bus moves. `obey` is called with what befalls robots' processes: who is killed, and who is to be
    started again.
    """

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        robots: int,
        shape: tuple[int, int],
        capture: BinaryIO | None = None,
        meter: Meter | None = None,
        obey: Callable[[FaultEvent], object] = lambda _: None,
    ) -> None:
        self.done = False
        self.records = Records(robots, MapHistory(shape))
        self._shape = shape
        self._capture = capture
        self._meter = meter
        self._bus = bus
        self._keys = keys
        self._protocol_errors: Counter[str] = Counter()
        """How often each participant has made no sense in this step."""
        self._obey = obey

    def configure(self, settings: Mapping[int, Settings]) -> None:
        """Send each robot its settings, by way of the relay; once, when this recorder has joined."""
        for robot, task in settings.items():
            self._bus.put(self._keys.control_tx(names.RECORDER), pack(Configure(robot, task.encode())))

    def handle(self, message: Message) -> None:
        """Take one message from the bus."""
        sender = names.parts(message.key)[3]
        try:
            self._take(sender, rights.read(*message))
        except ProtocolError as error:
            self._note_nonsense(sender, str(error))
        if self.records.end is not None and not self.done and not self.missing():
            self.shut_down()

    def _note_nonsense(self, sender: str, what: str) -> None:
        """Record what made no sense; who says too much of it is given up."""
        self.records.note_protocol_error(sender, what)
        self._protocol_errors[sender] += 1
        if self._protocol_errors[sender] == MAX_PROTOCOL_ERRORS + 1 and names.is_robot(sender):
            self._bus.put(
                self._keys.control_tx(names.RECORDER), pack(Lost(names.number(sender), TOO_MANY_ERRORS))
            )

    def _take(self, sender: str, said: object) -> None:
        """Record what `sender` says, which is its to say; ProtocolError if it makes no sense."""
        records = self.records
        if isinstance(said, WorldReport):
            records.world.append(said)
            self._protocol_errors.clear()
        elif isinstance(said, RadioReport):
            self._take_books(said)
        elif isinstance(said, RobotStatus):
            self._take_thoughts(self._number(sender), said)
        elif isinstance(said, Lost):
            if said.robot not in records.killed:
                records.lost[said.robot] = said.cause
        elif isinstance(said, Back):
            if records.lost.pop(said.robot, None) is not None:
                records.returned.append((records.step, said.robot))
        elif isinstance(said, FaultEvent):
            self._record_fault_event(said)
        elif isinstance(said, Change):
            records.changes.append(said)
        elif isinstance(said, Fault):
            who = said.who if sender in (names.RELAY, names.WORLD) else sender
            records.note_protocol_error(who, said.what)
        elif isinstance(said, End):
            records.end = said
        elif isinstance(said, MapChanges | Outlines):
            self._take_map_changes(self._number(sender), said)
        elif isinstance(said, Maps):
            self._take_maps(self._number(sender), said)

    def _take_books(self, said: RadioReport) -> None:
        if len(said.rows) % ROW.itemsize:
            raise ProtocolError("RadioReport", 0, f"{len(said.rows)} bytes are no rows of a ledger")
        self.records.rows.append(said.rows)
        self.records.carried = said.carried
        if self._capture is not None:
            self._capture.write(said.frames)

    def _take_thoughts(self, robot: int, said: RobotStatus) -> None:
        """Take a robot's report, one a step at most."""
        told = self.records.statuses[robot]
        after, last = (told[-1].step if told else 0), self.records.step + 1
        if not after < said.step <= last:
            raise ProtocolError(
                "MindReport", 0, f"of step {said.step}, where one of {after + 1} to {last} can be"
            )
        told.append(said)

    def _take_map_changes(self, robot: int, said: MapChanges | Outlines) -> None:
        """Take changes of a robot's maps; ProtocolError if they are of a step to come or do not fit the map."""
        if said.step > self.records.step + 1:
            raise ProtocolError(
                type(said).__name__, 0, f"of step {said.step}, after step {self.records.step}"
            )
        self.records.maps.take(robot, said)

    def _take_maps(self, robot: int, said: Maps) -> None:
        """Take a robot's grids: its own, and of the size of the run's map."""
        if said.robot != robot:
            raise ProtocolError("Maps", 0, f"of robot {said.robot}")
        if (said.height, said.width) != self._shape:
            height, width = self._shape
            raise ProtocolError("Maps", 0, f"{said.width} x {said.height} cells, not {width} x {height}")
        grids = [np.frombuffer(cells, np.uint8).reshape(self._shape) for cells in (said.own, said.planning)]
        if max(int(grid.max()) for grid in grids) > OCCUPIED:
            raise ProtocolError("Maps", 0, "a cell that is not free, occupied or unknown")
        self.records.own[robot], self.records.planning[robot] = grids

    def _number(self, sender: str) -> int:
        """The number of the robot that says something."""
        number = names.number(sender)
        if number >= self.records.robots:
            raise ProtocolError("message", 0, f"there is no robot {number}")
        return number

    def _record_fault_event(self, event: FaultEvent) -> None:
        """A fault has come true; a restart of who was not killed as asked for is of one who was lost unasked."""
        records, robot = self.records, event.robot
        if event.kind == "kill":
            records.killed.add(robot)
            records.lost.pop(robot, None)
        elif event.kind == "restart":
            records.killed.discard(robot)
        if event.kind != "restart" or robot not in records.lost:
            records.fault_events.append(event)
        self._obey(event)

    def missing(self) -> list[int]:
        """Robots whose maps have not been handed in."""
        records = self.records
        gone = records.own.keys() | records.lost.keys() | records.killed
        return [robot for robot in range(records.robots) if robot not in gone]

    def finish_without_missing(self) -> None:
        """Send all home without what some still owe; a robot that owes its maps is lost with them."""
        if self.records.end is not None:
            for robot in self.missing():
                self.records.lost[robot] = "it did not hand in its maps"
        self.shut_down()

    def ask(self, wish: FaultEvent | Change) -> None:
        """Ask for something that the scenario does not have: with the next step."""
        self._bus.put(self._keys.control_tx(names.RECORDER), pack(wish))

    def stop(self, reason: str) -> None:
        """Ask the world to end after this step."""
        self._bus.put(self._keys.control_tx(names.RECORDER), pack(Stop(reason)))

    def read_meter(self) -> None:
        """Record the bytes that the bus has moved so far."""
        if self._meter is not None:
            self.records.wire_bytes = self._meter.read()

    def shut_down(self) -> None:
        """Tell all participants that everything is recorded and that they can shut down."""
        self.read_meter()
        self.done = True
        self._bus.put(self._keys.control_tx(names.RECORDER), pack(Shutdown()))
