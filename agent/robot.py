"""A robot's mind, without sockets or clocks: one pass of the thesis' Algorithm 10 a step.

    perceive   lines 5 to 13: draw the scan on the self-explored grid, log the news
    (exchange) line 14: targets, offers, answers, data, driven by the relay's phases
    decide     lines 15 to 21: merge into the planning grid, choose a target if need be, move
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from agent import exchange as exchanges
from agent.exchange.session import Session
from agent.planning.frontier import is_frontier
from agent.planning.route import Route
from agent.polygons import Polygons
from agent.settings import Settings
from agent.strategies import Situation, strategy
from protocol import packets
from protocol.errors import ProtocolError
from protocol.grid import FREE, UNKNOWN, Grid, fan
from protocol.messages import Move, Outcome, Sense, cells_from_bytes, cells_to_bytes
from protocol.scans import Scan, check_readings, draw

WAIT_FOR_TEAMMATE = 2
"""Steps for which a robot waits when a teammate stands in its way, before it looks for another."""

_FACES = ((1, 0, 0), (0, 1, 2), (-1, 0, 4), (0, -1, 6))
"""The four neighbours (dx, dy) and the heading that looks at each."""


@dataclass(frozen=True)
class Fault:
    """Something that a teammate said and that makes no sense."""

    peer: int
    reason: str


class Robot:
    """One robot's mind; what it knows is in its two grids."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.own: Grid = np.full((settings.height, settings.width), UNKNOWN, np.uint8)
        """The self-explored grid."""
        self.planning: Grid = self.own.copy()
        """The planning grid: the own one and what teammates told."""
        self.session = Session(settings.robot, settings.robots, settings.offers)
        self.target: tuple[int, int] | None = None
        self.status = ""
        """What it is at, for people."""
        self.faults: list[Fault] = []
        self.distrusted: set[int] = set()
        """Teammates whose data is not taken any more, since some of it made no sense."""
        self.known_cells = 0
        """Cells of the self-explored grid that are known."""
        self._fan = fan(settings.range_cells, settings.beams)
        self._exchange = exchanges.exchange(settings)
        self._strategy = strategy(settings.strategy)(settings.options)
        self._route = Route()
        self._sense: Sense | None = None
        self._announce: tuple[int, int] | None = None
        self._heard_targets: dict[int, tuple[int, int]] = {}
        self._heard_at: dict[int, int] = {}
        self._news: dict[int, tuple[int, int]] = {}
        self._blocked_steps = 0

    @property
    def polygons(self) -> Mapping[int, Polygons]:
        """The polygons of each robot's map, its own included, as this robot holds them."""
        return self._exchange.polygons

    def perceive(self, sense: Sense) -> None:
        """Take what the body senses at the beginning of a step.

        Raises
        ------
        ProtocolError
            The readings do not fit the robot's laser.
        """
        readings = np.frombuffer(sense.readings, np.uint16).copy()
        check_readings(readings, self._fan)
        driven = cells_from_bytes(sense.driven)
        fresh = self.own[driven[:, 1], driven[:, 0]] == UNKNOWN
        self.own[driven[:, 1], driven[:, 0]] = FREE
        change = draw(self.own, self._fan, sense.x, sense.y, readings)
        self.known_cells += change.cells + len(np.unique(driven[fresh], axis=0))
        self._sense = sense
        self._route.drive_to(sense.x, sense.y)
        scan = Scan(sense.x, sense.y, readings)
        delivered = self.session.delivered()
        self.session.record(self._exchange.record(self.own, scan, change, delivered=delivered))

    def announce(self) -> bytes | None:
        """Return the packet that tells of a target chosen in the last step; None if there is none to tell."""
        if self._announce is None:
            return None
        return packets.encode([packets.Target(*self._announce)])

    def announced(self) -> None:
        """The target has been on the air."""
        self._announce = None

    def hear_target(self, peer: int, payload: bytes) -> None:
        """Take a teammate's broadcast."""
        try:
            said = packets.decode(payload)
        except ProtocolError as error:
            self.faults.append(Fault(peer, str(error)))
            return
        height, width = self.own.shape
        for packet in said:
            if isinstance(packet, packets.Target) and packet.x < width and packet.y < height:
                self._news[peer] = packet.x, packet.y
            else:
                self.faults.append(Fault(peer, f"{packet} is no target on a {width} x {height} grid"))

    def settle(self, outcome: Outcome, heard: list[tuple[int, bytes]]) -> None:
        """Take the outcome of an exchange, and the data that came as (peer, frame)."""
        for peer, about, units in self.session.outcome(outcome, heard):
            if peer in self.distrusted:
                continue
            try:
                self._exchange.take(about, units)
            except ProtocolError as error:
                self.distrusted.add(peer)
                self.faults.append(Fault(peer, str(error)))
            else:
                self.session.accept(peer, about, units)
        if outcome.target:
            self.announced()

    def decide(self) -> Move:
        """End a step: merge, choose a target if need be, and say where to drive."""
        sense = self._sense
        if sense is None:
            raise RuntimeError("decide before the first perceive")
        self.session.forget()
        self.planning = self._exchange.merge(self.own)
        situation = self._situation(sense)
        explored = False
        heading = sense.heading
        self._blocked_steps = self._blocked_steps + 1 if sense.blocked == "robot" else 0
        if self._should_choose(situation):
            explored = not self._choose(situation)
        elif not self._route.is_open(self.planning):
            explored = not self._route_again(situation) and not self._choose(situation)
        if self._blocked_steps >= WAIT_FOR_TEAMMATE:
            self._step_aside(situation)
        if self.target == (sense.x, sense.y):
            heading = self._face_the_unknown(sense)
        self._report(sense, explored)
        path = self._route.next_cells(int(self.settings.speed_cells) + 2)
        return Move(sense.step, cells_to_bytes(path), heading, explored)

    def _situation(self, sense: Sense) -> Situation:
        for peer, target in self._news.items():
            self._heard_targets[peer] = target
            self._heard_at[peer] = sense.step
        return Situation(
            self.settings.robot,
            sense.step,
            self.planning,
            sense.x,
            sense.y,
            self.settings.range_cells,
            {peer: self._heard_targets[peer] for peer in sorted(self._heard_targets)},
            {peer: self._heard_at[peer] for peer in sorted(self._heard_at)},
            self.settings.seed,
        )

    def _should_choose(self, situation: Situation) -> bool:
        news, self._news = self._news, {}
        if self.target is None or not is_frontier(self.planning, *self.target):
            return True
        return bool(news) and self._strategy.reconsiders(situation, self.target, news)

    def _choose(self, situation: Situation) -> bool:
        """Choose a target and a way there; whether there was one to choose."""
        field = self._route.plan(self.planning, situation.x, situation.y)
        target = self._strategy.choose(situation, field)
        if target is not None and target != self.target:
            self._announce = target
        self.target = target
        if target is None:
            self._route.clear()
            return False
        self._route.lead_to(*target)
        return True

    def _route_again(self, situation: Situation) -> bool:
        """Find a new way to the same target; whether there is one."""
        if self.target is None:
            return False
        self._route.plan(self.planning, situation.x, situation.y)
        return self._route.lead_to(*self.target)

    def _step_aside(self, situation: Situation) -> None:
        """Get out of a teammate's way: drive around it, or to a random place near by until it is gone."""
        if self.target is not None:
            self._route.detour(
                self.planning,
                (situation.x, situation.y),
                self.target,
                situation.range_cells,
                (self.settings.seed, self.settings.robot, situation.step),
            )

    def _face_the_unknown(self, sense: Sense) -> int:
        """Heading that looks at the target's unknown neighbour, for a laser that does not look everywhere."""
        height, width = self.planning.shape
        for dx, dy, heading in _FACES:
            x, y = sense.x + dx, sense.y + dy
            if 0 <= x < width and 0 <= y < height and self.planning[y, x] == UNKNOWN:
                return heading
        return sense.heading

    def _report(self, sense: Sense, explored: bool) -> None:
        if explored:
            self.status = "idle: no reachable frontier is left on its planning grid"
        elif self._blocked_steps:
            self.status = "waits: a teammate stands in the way"
        elif self.target == (sense.x, sense.y):
            self.status = "looks around at its target"
        else:
            self.status = "drives to its target"
