"""A network of robots around the real radio: it plays whole steps in one thread and logs their events.

A robot is anything that takes an event of the medium and returns the messages that it sends then. The order in which
the relay reads messages of different robots is drawn from `interleaving`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from netshaper.ledger import ROW
from netshaper.radio import Radio
from netshaper.settings import RadioSettings
from protocol.messages import (
    Broadcasts,
    Close,
    MediumEvent,
    Open,
    PhaseDelivery,
    RadioReport,
    RobotFrames,
    RoundReport,
)

Robot = Callable[[MediumEvent], Sequence[RobotFrames]]


class Delivered(NamedTuple):
    """A frame that reached a robot; `kind`: broadcast, offers, answers or data."""

    kind: str
    receiver: int
    sender: int
    payload: bytes


@dataclass
class Step:
    """The events, frames and account of one step."""

    rows: NDArray[np.void] = field(default_factory=lambda: np.empty(0, ROW))
    carried: int = -1
    report: RadioReport = field(default_factory=lambda: RadioReport(0, b"", 0, b""))
    events: list[tuple[int, MediumEvent]] = field(default_factory=list)
    """All events in order, each with its robot."""
    sent: list[tuple[int, RobotFrames]] = field(default_factory=list)
    """All messages of robots in order."""

    def bytes_where(self, wanted: NDArray[np.bool_]) -> int:
        return int(self.rows["bytes"][wanted].sum())

    @property
    def submitted(self) -> list[tuple[int, bytes]]:
        """All frames that robots sent, each with its sender."""
        return [
            (robot, payload)
            for robot, message in self.sent
            for payload in (message.broadcast, *(frame.payload for frame in message.frames))
        ]

    @property
    def delivered(self) -> list[Delivered]:
        """All frames that reached a robot."""
        kinds = {Broadcasts: "broadcast", RoundReport: "data"}
        return [
            Delivered(
                event.phase if isinstance(event, PhaseDelivery) else kinds[type(event)],
                robot,
                each.sender,
                each.payload,
            )
            for robot, event in self.events
            if isinstance(event, Broadcasts | PhaseDelivery | RoundReport)
            for each in event.deliveries
        ]

    @property
    def opened(self) -> list[tuple[int, Open]]:
        return [(robot, event) for robot, event in self.events if isinstance(event, Open)]

    @property
    def phases(self) -> list[tuple[int, PhaseDelivery]]:
        return [(robot, event) for robot, event in self.events if isinstance(event, PhaseDelivery)]

    @property
    def reports(self) -> list[tuple[int, RoundReport]]:
        return [(robot, event) for robot, event in self.events if isinstance(event, RoundReport)]

    @property
    def closed(self) -> list[int]:
        return [robot for robot, event in self.events if isinstance(event, Close)]


class Network:
    """A radio and its robots."""

    def __init__(
        self, settings: RadioSettings, robots: Mapping[int, Robot], interleaving: int | None = None
    ) -> None:
        self.radio = Radio(settings)
        self.dead: set[int] = set()
        self._robots = dict(robots)
        self._rng = None if interleaving is None else np.random.default_rng(interleaving)
        self._queues: dict[int, deque[RobotFrames]] = {number: deque() for number in robots}

    def step(
        self, number: int, cells: Mapping[int, tuple[int, int]], deaths: Mapping[int, int] | None = None
    ) -> Step:
        """Play one step; `deaths` has the number of messages after which a robot dies. Silent robots count as lost."""
        step = Step()
        self.radio.begin(number, cells)
        self._take(step)
        done = 0
        while True:
            for robot, when in sorted((deaths or {}).items()):
                if when == done and robot not in self.dead:
                    self.kill(robot, step)
            done += 1
            busy = [robot for robot, queue in self._queues.items() if queue]
            if busy:
                robot = busy[0] if self._rng is None else int(self._rng.choice(busy))
                message = self._queues[robot].popleft()
                step.sent.append((robot, message))
                self.radio.submit(robot, message)
                self._take(step)
            elif step.carried < 0:
                silent = self.radio.waiting_for()
                assert silent, "the step does not end, although the relay waits for no robot"
                for robot in silent:
                    self.kill(robot, step)
            else:
                return step

    def kill(self, robot: int, step: Step) -> None:
        self.dead.add(robot)
        self._queues[robot].clear()
        self.radio.lost(robot)
        self._take(step)

    def _take(self, step: Step) -> None:
        for robot, event in self.radio.events:
            assert robot not in self.dead, "the relay sends nothing to the dead"
            step.events.append((robot, event))
            self._queues[robot].extend(self._robots[robot](event))
        self.radio.events.clear()
        for account in self.radio.accounts:
            assert step.carried < 0, "one account per step"
            step.report = account.report()
            step.rows = np.frombuffer(step.report.rows, ROW)
            step.carried = step.report.carried
        self.radio.accounts.clear()
