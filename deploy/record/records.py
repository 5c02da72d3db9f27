"""The laboratory: it listens to world, relay and robots, and keeps the data for a run's results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from deploy.record.wire_bytes import Meter
from netshaper.ledger import ROW
from protocol import keys as names
from protocol.bus import Bus, Message
from protocol.grid import Grid
from protocol.keys import Keys
from protocol.messages import (
    Back,
    Bye,
    End,
    Fault,
    Lost,
    Maps,
    MindReport,
    RadioReport,
    Stop,
    Strike,
    WorldReport,
    pack,
    unpack,
)


@dataclass(repr=False)
class Records:
    """Everything reported of a run so far."""

    robots: int
    world: list[WorldReport] = field(default_factory=list)
    minds: list[list[MindReport]] = field(default_factory=list)
    rows: list[bytes] = field(default_factory=list)
    own: dict[int, Grid] = field(default_factory=dict)
    """Self-explored grids, by robot, at the end."""
    planning: dict[int, Grid] = field(default_factory=dict)
    lost: dict[int, str] = field(default_factory=dict)
    """Robots that died unexpectedly, and how."""
    strikes: list[Strike] = field(default_factory=list)
    """The faults that came true, as they were asked for (`worldsim.faults`)."""
    killed: set[int] = field(default_factory=set)
    """Robots that were killed as asked for, and have not been restarted."""
    returned: list[tuple[int, int]] = field(default_factory=list)
    """(step, robot): robots that had been lost unasked, and came back."""
    faults: list[str] = field(default_factory=list)
    end: End | None = None
    carried: int = 0
    """Bytes on the air in the last step."""
    wire_bytes: int | None = None
    """Bytes that the bus has moved (`deploy.record.wire_bytes`); None if it is not available."""

    def __post_init__(self) -> None:
        self.minds = [[] for _ in range(self.robots)]

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
    def is_whole(self) -> bool:
        """Whether what every robot has seen is among the grids: no life has ended without handing them in."""
        return not (self.lost or self.returned or {s.kind for s in self.strikes} & {"kill", "restart"})

    def ledger(self) -> NDArray[np.void]:
        """All rows of the ledger so far (`netshaper.ledger.ROW`), in the order in which they were recorded."""
        return np.frombuffer(b"".join(self.rows), ROW)


class LabNode:
    """The laboratory's end of the bus; `done` once everything has been handed in.

    What the relay reports for the capture is written to `capture` step by step, and not kept; `meter` counts
    the bytes that the bus moves. `obey` is called with what befalls robots' processes: who is killed, and who is to be
    started again.
    """

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        robots: int,
        capture: BinaryIO | None = None,
        meter: Meter | None = None,
        obey: Callable[[Strike], object] = lambda _: None,
    ) -> None:
        self.done = False
        self.records = Records(robots)
        self._capture = capture
        self._meter = meter
        self._bus = bus
        self._keys = keys
        self._obey = obey

    def handle(self, message: Message) -> None:
        """Take one message from the bus."""
        records = self.records
        sender = names.parts(message.key)[3]
        said = unpack(message.payload)
        if isinstance(said, WorldReport):
            records.world.append(said)
        elif isinstance(said, RadioReport):
            records.rows.append(said.rows)
            records.carried = said.carried
            if self._capture is not None:
                self._capture.write(said.frames)
        elif isinstance(said, MindReport):
            records.minds[names.number(sender)].append(said)
        elif isinstance(said, Lost):
            if said.robot not in records.killed:
                records.lost[said.robot] = said.cause
        elif isinstance(said, Back):
            if records.lost.pop(said.robot, None) is not None:
                records.returned.append((records.step, said.robot))
        elif isinstance(said, Strike):
            self._take_strike(said)
        elif isinstance(said, Fault):
            records.faults.append(f"{said.who}: {said.what}")
        elif isinstance(said, End):
            records.end = said
        elif isinstance(said, Maps):
            shape = (said.height, said.width)
            records.own[said.robot] = np.frombuffer(said.own, np.uint8).reshape(shape)
            records.planning[said.robot] = np.frombuffer(said.planning, np.uint8).reshape(shape)
        if records.end is not None and not self.done and not self.missing():
            self.send_home()

    def _take_strike(self, strike: Strike) -> None:
        """A fault has come true; a restart of who was not killed as asked for is of one who was lost unasked."""
        records, robot = self.records, strike.robot
        if strike.kind == "kill":
            records.killed.add(robot)
            records.lost.pop(robot, None)
        elif strike.kind == "restart":
            records.killed.discard(robot)
        if strike.kind != "restart" or robot not in records.lost:
            records.strikes.append(strike)
        self._obey(strike)

    def missing(self) -> list[int]:
        """Robots whose maps have not been handed in."""
        records = self.records
        gone = records.own.keys() | records.lost.keys() | records.killed
        return [robot for robot in range(records.robots) if robot not in gone]

    def stop(self, reason: str) -> None:
        """Ask the world to end after this step."""
        self._bus.put(self._keys.control_tx(names.LAB), pack(Stop(reason)))

    def read_meter(self) -> None:
        """Record the bytes that the bus has moved so far."""
        if self._meter is not None:
            self.records.wire_bytes = self._meter.read()

    def send_home(self) -> None:
        """Tell all participants that everything is recorded and that they can shut down."""
        self.read_meter()
        self.done = True
        self._bus.put(self._keys.control_tx(names.LAB), pack(Bye()))
