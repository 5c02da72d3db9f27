"""A robot's control logic, without sockets or clocks: one pass of the thesis' Algorithm 10 per step.

perceive   lines 5 to 13: draw the scan on the self-explored grid, log the news
(exchange) line 14: targets and poses, offers, answers, data, driven by the relay's phases
decide     lines 15 to 21: merge into the planning grid; the strategy says where to go
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from agent.encodings.catalog import ENCODINGS, make_encoding
from agent.exchange import gossip
from agent.exchange.distribution import distribution
from agent.exchange.outcome import Outcome
from agent.outline.polygons import Polygons
from agent.settings import Settings
from agent.strategies.base import Cell, Decision, Pose, Situation
from agent.strategies.registry import strategy
from agent.strategies.relayed_state import RelayedState
from protocol import packet_index, packets
from protocol.errors import ProtocolError
from protocol.fields import MOST_ON_THE_WAY
from protocol.grid import UNKNOWN, Grid, ray_table
from protocol.messages import Move, Sense, cells_from_bytes, cells_to_bytes, points_to_bytes
from protocol.scans import Scan, check_readings, draw

_Value = TypeVar("_Value")

REPEAT_POSE = 10
"""Steps after which a robot that stands still repeats its pose."""

TARGET_SLACK = 10
"""Where maps travel by gossip, a target that is nearer to the one told last than the so-manieth part of the sensor's
range is not told: utilities around it are almost the same."""

POSE_SLACK = 3
"""A pose is not told that is nearer to where a robot has looked from, as it has told, than the so-manieth part of its
sensor's range."""

SURE_AFTER = 10
"""Steps for which a map with assumptions must have nothing left to explore before a robot reports that it is done:
by then teammates have sent more of areas that looked insignificant when they first saw them."""


def sure_after(settings: Settings) -> int:
    """Steps for which a robot makes sure that nothing is left before it says so.

    Twice as many where words may be late, or lost and said again.
    """
    if not ENCODINGS[settings.map_encoding].infers_cells(settings):
        return 0
    return 2 * SURE_AFTER if settings.requires_acks else SURE_AFTER


@dataclass(frozen=True)
class Fault:
    """A malformed or inconsistent message from a teammate."""

    peer: int
    reason: str


class Robot:
    """One robot's control logic; what it knows is in its two grids."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.own: Grid = np.full((settings.height, settings.width), UNKNOWN, np.uint8)
        """The self-explored grid."""
        self.planning: Grid = self.own.copy()
        """The planning grid: the own one merged with what teammates sent."""
        self._encoding = make_encoding(settings)
        self.session = distribution(settings, self._encoding)
        self.target: Cell | None = None
        self.status = ""
        """Its current activity, as text."""
        self.faults: list[Fault] = []
        self.distrusted: set[int] = set()
        """Teammates whose data is no longer accepted, since some of it was malformed or inconsistent."""
        self._told_by: dict[int, set[int]] = {}
        """For each map, the peers from which pieces were taken."""
        self.known_cells = 0
        """Cells of the self-explored grid that are known."""
        self._ray_table = ray_table(settings.range_cells, settings.beams)
        self._strategy = strategy(settings.strategy)(settings.options, settings)
        self._sense: Sense | None = None
        self._homes: dict[int, Cell] = {}
        self._withheld: list[bytes] = []
        self._peers: tuple[int, ...] = ()
        self._target_news: Cell | None = None
        self._told_target: Cell | None = None
        """The target that teammates have heard of last."""
        self._slack = settings.range_cells / TARGET_SLACK if settings.dissemination == gossip.POLICY else 0.0
        self._pose_news: packets.Pose | None = None
        self._told: tuple[packets.Pose | None, tuple[int, ...], int] = (None, (), 0)
        self._looked: tuple[Cell | None, tuple[int, ...]] = (None, ())
        """Where teammates know from its looks that it was, and which of them."""
        self._by_looks = False
        """Whether its pose is not told in this step since looks have."""
        self._heard_pose: dict[int, int] = {}
        """The step in which each teammate last told its pose."""
        self._targets: dict[int, Cell] = {}
        self._heard: dict[int, int] = {}
        self._news: dict[int, Cell] = {}
        self._poses: dict[int, Pose] = {}
        self._moved: dict[int, int] = {}
        """The step in which each teammate was last heard to be elsewhere than before."""
        self._traveled: dict[int, float] = {}
        self._relayed_state = RelayedState(settings)
        self._pose_is_said = True
        """Whether its pose is in this step's broadcast, as it is in all where nothing is passed on."""
        self._idle_steps = 0
        self._sure_after = sure_after(settings)

    def share(self, common: dict[str, Any]) -> None:
        """Share memory with the other robots of this process (`agent.encodings.base.MapEncoding.use_shared_cache`)."""
        self._encoding.use_shared_cache(common)
        self._strategy.use_shared_cache(common)

    @property
    def polygons(self) -> Mapping[int, Polygons]:
        """The polygons of each robot's map, its own included, as this robot holds them."""
        return self._encoding.polygons

    def error(self) -> int:
        """Cells in which its map and the approximation that it has logged differ (thesis, Eq. 6.1)."""
        return self._encoding.approximation_error(self.own)

    def exact_error(self) -> int | None:
        """What that would be if the approximation were exact; None if it is not measured."""
        return self._encoding.exact_error(self.own)

    def perceive(self, sense: Sense) -> None:
        """Take the sensor readings at the beginning of a step.

        Raises
        ------
        ProtocolError
            The readings do not fit the robot's laser.
        """
        readings = np.frombuffer(sense.readings, np.uint16).copy()
        check_readings(readings, self._ray_table)
        driven = cells_from_bytes(sense.driven)
        change = draw(self.own, self._ray_table, sense.x, sense.y, readings, driven)
        self.known_cells += change.cells
        if self._sense is None:
            self._homes[self.settings.robot] = self.settings.home or (sense.x, sense.y)
        else:
            self._travel(self.settings.robot, (self._sense.x, self._sense.y), (sense.x, sense.y))
        self._sense = sense
        scan = Scan(sense.x, sense.y, readings)
        if (
            self._encoding.retractable
            and not self._withheld
            and self.session.retract(self._encoding.retractable)
        ):
            self._encoding.retract_last()
        delivered = self.session.delivered() and not self._withheld
        if delivered:
            self._looked = self._encoding.scan_cell(self.session.own), self._peers
        self._withheld += self._encoding.encode_changes(self.own, scan, change, delivered=delivered)
        if not self._strategy.defers_publication:
            self._publish()
        if self._strategy.publishes_pose:
            self._pose_news = packets.Pose(sense.x, sense.y, int(self._strategy.leads))

    def announce(self, peers: list[int]) -> bytes | None:
        """Return the packets to broadcast to the `peers` in range: a target chosen in the last step, a pose.

        A pose that all have heard is repeated only after some steps. None if there is nothing to send.
        """
        assert self._sense is not None
        heard, self._peers = self._peers, tuple(peers)
        said: list[packets.Packet] = []
        if self._pose_news is not None:
            last, audience, step = self._told
            known = last == self._pose_news and set(peers) <= set(audience)
            self._by_looks = not known and self._looks_tell(self._pose_news, peers)
            known = known or self._by_looks
            if not known or self._sense.step >= step + REPEAT_POSE:
                said.append(self._pose_news)
        if self._target_news is not None:
            said.append(packets.Target(*self._target_news))
        if self._strategy.forwards_state:
            self._pose_is_said = any(isinstance(packet, packets.Pose) for packet in said)
            said += self._relayed_state.forward(self._sense.step, heard, peers, self._poses, self._targets)
        return packets.encode(said) if said else None

    def _looks_tell(self, pose: packets.Pose, peers: list[int]) -> bool:
        """Whether peers know from its looks about where the robot is, and nothing else is new of its pose."""
        cell, audience = self._looked
        if cell is None or pose.leads or self._told[0] is None or not set(peers) <= set(audience):
            return False
        return math.dist(cell, (pose.x, pose.y)) < self.settings.range_cells / POSE_SLACK

    def hear_broadcast(self, peer: int, payload: bytes) -> None:
        """Take a teammate's broadcast."""
        try:
            said = packets.broadcast(payload)
        except ProtocolError as error:
            self.faults.append(Fault(peer, str(error)))
            return
        height, width = self.own.shape
        map_id: int | None = peer
        """Whose the next target is; None: it is of no interest."""
        for packet in said:
            if isinstance(packet, packets.Target) and packet.x < width and packet.y < height:
                target = packet.x, packet.y
                if map_id == peer or (map_id is not None and target != self._targets.get(map_id)):
                    self._news[map_id] = target
            elif isinstance(packet, packets.Passed) and packet.x < width and packet.y < height:
                map_id = self._take_hearsay(peer, packet)
            elif isinstance(packet, packets.Pose) and packet.x < width and packet.y < height:
                self._heard_pose[peer] = self._sense.step if self._sense is not None else 0
                self._note_pose(peer, Pose(packet.x, packet.y, bool(packet.leads)))
                if self._sense is not None:
                    self._encoding.note_pose(peer, self._sense.step, packet.x, packet.y)
            else:
                reason = f"{packet} is no target or pose on a {width} x {height} grid"
                self.faults.append(Fault(peer, reason))

    def _take_hearsay(self, peer: int, packet: packets.Passed) -> int | None:
        """Take what a teammate passes on of a robot; return which one, if it is news, and not heard from itself."""
        if packet.robot >= self.settings.robots:
            self.faults.append(Fault(peer, f"{packet} is no robot of {self.settings.robots}"))
            return None
        step = self._sense.step if self._sense is not None else 0
        if packet.robot in self._peers or not self._relayed_state.take(packet, step):
            return None
        self._note_pose(packet.robot, Pose(packet.x, packet.y, leads=False))
        return packet.robot

    def _note_pose(self, peer: int, pose: Pose) -> None:
        """A teammate is somewhere."""
        self._homes.setdefault(peer, pose[:2])
        before = self._poses.get(peer)
        if before is not None:
            self._travel(peer, before[:2], pose[:2])
        if before is None or before[:2] != pose[:2]:
            self._moved[peer] = self._sense.step if self._sense is not None else 0
        self._poses[peer] = pose

    def _note_look(self, map_id: int) -> None:
        """Take where a teammate is from its looks, if it has told its pose before, but not in this step."""
        assert self._sense is not None
        peer, cell = map_id % self.settings.robots, self._encoding.scan_cell(map_id)
        before = self._poses.get(peer)
        if cell is None or before is None or before[:2] == cell:
            return
        if self._heard_pose[peer] < self._sense.step:
            self._note_pose(peer, Pose(*cell, before.leads))

    def settle(self, outcome: Outcome, heard: list[tuple[int, bytes]]) -> None:
        """Take the outcome of an exchange, and the data that came as (peer, frame).

        A peer that sends malformed or inconsistent data is distrusted. If others had sent pieces of that map before,
        theirs may be the false ones: then only this map is no longer accepted from it.
        """
        for peer, map_id, frame in self.session.outcome(outcome, heard):
            if (peer, map_id) in self.session.refused:
                continue
            told_by = self._told_by.setdefault(map_id, set())
            try:
                ends = packet_index.ends(frame)
                self._encoding.apply(map_id, frame, step=outcome.step, sender=peer)
            except ProtocolError as error:
                self.faults.append(Fault(peer, str(error)))
                self.session.refused.add((peer, map_id))
                if told_by <= {peer}:
                    self.distrusted.add(peer)
                    self.session.refused.update((peer, each) for each in range(self.settings.maps))
            else:
                self.session.accept(peer, map_id, frame, ends)
                told_by.add(peer)
                self._note_look(map_id)
        if outcome.broadcast:
            self._told_target, self._target_news = self._target_news or self._told_target, None
            if self._pose_is_said and not self._by_looks:
                self._told = self._pose_news, self._peers, outcome.step

    def decide(self) -> Move:
        """End a step: merge, and let the strategy say where to go."""
        sense = self._sense
        if sense is None:
            raise RuntimeError("decide before the first perceive")
        self.session.forget()
        self.planning = self._encoding.merge(self.own, self._peers)
        decision = self._strategy.decide(self._situation(sense))
        self._take(decision)
        self._idle_steps = self._idle_steps + 1 if decision.explored else 0
        return Move(
            sense.step,
            cells_to_bytes(decision.path[:MOST_ON_THE_WAY]),
            decision.heading,
            self._idle_steps > self._sure_after,
            decision.look,
            decision.stalled,
            points_to_bytes(decision.points[:MOST_ON_THE_WAY]),
        )

    def _take(self, decision: Decision) -> None:
        """Record what the strategy decided, and what of it is to be sent to teammates."""
        if self._strategy.publishes_target and decision.target is not None and decision.target != self.target:
            known = (
                self._told_target is not None and math.dist(self._told_target, decision.target) < self._slack
            )
            self._target_news = None if known else decision.target
        self.target = decision.target
        self.status = decision.status
        if decision.publish:
            self._publish()

    def _publish(self) -> None:
        """Release everything that has been seen by now to teammates."""
        self.session.record(self._withheld)
        self._withheld = []

    def _situation(self, sense: Sense) -> Situation:
        news, self._news = self._news, {}
        for peer, target in news.items():
            self._targets[peer] = target
            self._heard[peer] = sense.step
        return Situation(
            step=sense.step,
            grid=self.planning,
            x=sense.x,
            y=sense.y,
            offset=(sense.offset_x, sense.offset_y),
            heading=sense.heading,
            blocked=sense.blocked,
            homes=_ascending(self._homes),
            home=self._homes[self.settings.robot],
            peers=self._peers,
            connected=self._relayed_state.connected(sense.step, self._peers),
            poses=_ascending(self._poses),
            last_moved=_ascending(self._moved),
            traveled=_ascending(self._traveled),
            targets=_ascending(self._targets),
            target_steps=_ascending(self._heard),
            new_targets=news,
        )

    def _travel(self, robot: int, start: Cell, end: Cell) -> None:
        way = math.hypot(end[0] - start[0], end[1] - start[1])
        self._traveled[robot] = self._traveled.get(robot, 0.0) + way


def _ascending(of_robots: dict[int, _Value]) -> dict[int, _Value]:
    """What is known of robots, by ascending number; a dictionary that is so already is copied in a moment."""
    numbers = list(of_robots)
    ordered = sorted(numbers)
    return dict(of_robots) if numbers == ordered else {robot: of_robots[robot] for robot in ordered}
