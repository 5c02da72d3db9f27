"""A robot's control logic, without sockets or clocks: one pass of the thesis' Algorithm 10 per step.

perceive   lines 5 to 13: draw the scan on the self-explored grid, append map updates to the log
rounds     line 14: broadcast target and pose, replicate the logs (`agent.replication`), driven by the relay's events
assess     lines 15 to 17: merge the maps into the planning grid
decide     lines 18 to 21: the strategy chooses a target
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from agent.announcements import Announcements
from agent.completion import Completion
from agent.encodings.base import MapEncoding
from agent.encodings.catalog import check_entries, make_encoding
from agent.mapping.mapper import WALL, cell_ahead, make_mapper
from agent.outline.polygons import Polygons
from agent.planning.noisy_grid import NoisyGrid, shortest_frontier
from agent.planning.small_frontiers import without_small_frontiers
from agent.replication.digests import INTERVAL
from agent.replication.engine import make_replication
from agent.replication.replica import Rejected
from agent.settings import Settings
from agent.strategies.base import Decision, Situation, TeammatePose
from agent.strategies.registry import strategy
from agent.team_state import TeamState
from protocol import packet_codec, packet_index
from protocol.body import narrowest_opening
from protocol.cell_bytes import cells_to_bytes, points_to_bytes
from protocol.errors import ProtocolError, shown
from protocol.grid import Cell, Grid, Mask
from protocol.message_fields import MAX_WAY_CELLS
from protocol.messages import Move, RoundReport, Sense
from protocol.packets import SALTS, Held, LogDigest
from protocol.plugins import PluginError

ABOUT_LOGS = LogDigest, Held
"""Packets of a broadcast that concern logs; those before them concern the team."""


@dataclass(frozen=True)
class PeerError:
    """A malformed or inconsistent message from a teammate, or a map that others contradict."""

    peer: int
    reason: str
    kind: str = "malformed message"


class Robot:
    """One robot's control logic; its map knowledge is in its two grids."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._mapper = make_mapper(settings)
        self.own: Grid = self._mapper.states
        """The self-explored grid."""
        self.planning: Grid = self.own.copy()
        """The planning grid: the self-explored one merged with teammates' maps."""
        self.explorable: Grid = self.planning
        """The planning grid as the strategy sees it, without frontiers that are left unexplored."""
        self._noisy_grid = None
        if settings.laser is not None:
            radius, shortest = settings.body.radius_cells, shortest_frontier(settings.bodies)
            narrow = narrowest_opening(radius, settings.resolution)
            self._noisy_grid = NoisyGrid(settings.height, settings.width, narrow, shortest, radius)
        self._encoding = make_encoding(settings)
        self._encoding.use_log_odds(self._mapper.log_odds)
        self._team = TeamState(settings)
        # No methods: a run whose robots refer to themselves would stay in memory until the garbage collector runs.
        consume = partial(_consume, self._encoding, self._team)
        rebuild = partial(_rebuild, self._encoding, self._team)
        self.replication = make_replication(settings, consume, self._encoding.dependencies, rebuild)
        self.target: Cell | None = None
        self.status = ""
        """Its current activity, as text."""
        self.peer_errors: list[PeerError] = []
        self.disbelieved: set[int] = set()
        """Teammates whose maps were so often contradicted that they were left out of the planning grid."""
        self._doubted_steps: dict[int, int] = {}
        """Steps for which each teammate's map has been left out."""
        self._announcements = Announcements(settings)
        self.strategy = strategy(settings.strategy)(settings.options, settings)
        """Chooses the target at the end of each step."""
        self._sense: Sense | None = None
        self._withheld: list[bytes] = []
        """Log entries that the strategy has not published yet."""
        self._completion = Completion(
            settings, self._mapper, self._noisy_grid, self._encoding, self.replication
        )

    def share(self, common: dict[str, Any]) -> None:
        """Share memory with the other robots of this process (`agent.encodings.base.MapEncoding.use_shared_cache`)."""
        self._encoding.use_shared_cache(common)
        self.strategy.use_shared_cache(common)

    @property
    def polygons(self) -> Mapping[int, Polygons]:
        """The polygons of each map, this robot's own included, by map ID."""
        return self._encoding.polygons

    @property
    def teammates(self) -> Mapping[int, TeammatePose]:
        """The last known pose of each teammate."""
        return self._team.poses

    @property
    def known_cells(self) -> int:
        """Cells of the self-explored grid that are known."""
        return self._mapper.known_cells

    @property
    def shared(self) -> Grid:
        """The team's map as it holds it (`agent.encodings.base.MapEncoding.shared_map`)."""
        return self._encoding.shared_map(self.own, self.planning)

    @property
    def settled(self) -> Mask:
        """The cells of the self-explored grid of whose state it is certain, shape (h, w)."""
        return self._mapper.settled()

    def error(self) -> int:
        """Count the cells in which its map and the approximation in its log differ (thesis, Eq. 6.1)."""
        return self._encoding.approximation_error(self.own)

    def exact_error(self) -> int | None:
        """Count the same as if the approximation were exact; None if that is not measured."""
        return self._encoding.exact_error(self.own)

    def perceive(self, sense: Sense) -> None:
        """Take the sensor readings at the beginning of a step; ProtocolError if they do not fit the robot's laser."""
        scan, change = self._mapper.add(sense)
        self._sense = sense
        self._team.perceive(sense)
        if self.settings.replication.digests:
            self.replication.salt = zlib.crc32(sense.readings + sense.range_scan, sense.step) % SALTS
        encoding, replication = self._encoding, self.replication
        may_retract = encoding.retractable and not encoding.is_settled and not self._withheld
        if may_retract and replication.own_log.retract(encoding.retractable):
            encoding.retract_last()
        delivered = replication.delivered() and not self._withheld
        if delivered:
            self._announcements.scans_received(encoding.scan_cell(replication.peers.own), self._team.in_range)
        entries = encoding.encode_changes(self.own, scan, change, delivered=delivered)
        check_entries(encoding, entries)
        self._withheld += entries
        if not self.strategy.defers_publication:
            self._publish()
        if self.strategy.publishes_pose:
            self._announcements.set_pose(sense.x, sense.y, leads=self.strategy.leads)

    def announce(self, in_range: Sequence[int]) -> bytes | None:
        """Return the packets to broadcast to the teammates in range; None if there are none.

        They are this robot's pose, the target of the last decision, relayed state of other teammates, the digest of
        this robot's log, and requests for entries.
        """
        team, relays = self._team, self.strategy.forwards_state
        before, team.in_range = team.in_range, tuple(in_range)
        announced = self._announcements.next_packets(team.step, in_range, relays=relays)
        if relays:
            announced += team.relayed.forward(team.step, before, in_range, team.poses, team.targets)
        return packet_codec.encode(announced) + self.replication.announcements() or None

    def receive_broadcast(self, peer: int, payload: bytes) -> None:
        """Process a teammate's broadcast of poses, targets and digests."""
        team = self._team
        try:
            received = packet_codec.broadcast(payload)
        except ProtocolError as error:
            self.peer_errors.append(PeerError(peer, str(error)))
            return
        about_logs = [each for each in received if isinstance(each, ABOUT_LOGS)]
        errors = team.receive_broadcast(peer, received[: len(received) - len(about_logs)])
        if errors:
            self.peer_errors += [PeerError(peer, reason) for reason in errors]
        for each in about_logs:
            self._report(self.replication.receive_announcement(peer, each))
        pose = team.broadcast_pose(peer)
        if pose is not None and self._sense is not None:
            self._encoding.note_pose(peer, team.step, pose.x, pose.y)

    def close_round(self, report: RoundReport) -> None:
        """Process the end of a round: what was on the air, and the frames that arrived."""
        self._report(self.replication.close_round(report))
        if report.broadcast_sent:
            self._announcements.sent(report.step, self._team.in_range)
            self.replication.announced()

    def assess(self) -> Situation:
        """Merge the maps at the end of a step, and return what the strategy is to decide on."""
        sense = self._sense
        if sense is None:
            raise RuntimeError("assess before the first perceive")
        self.planning = self._encoding.merge(self.own, self._team.in_range)
        self._report_false_maps()
        self.explorable = self._without_ignored_frontiers(sense)
        return self._team.situation(
            sense,
            self.explorable,
            log_entries=self.replication.own_log.length,
            backlog=self.replication.undelivered(),
        )

    def decide(self, situation: Situation | None = None) -> Move:
        """End a step: let the strategy choose a target and a path.

        `situation` is the result of `assess`, which is called if it is omitted.
        """
        if situation is None:
            situation = self.assess()
        decided = self.strategy.decide(situation)
        if not isinstance(decided, Decision):
            raise PluginError(
                f"strategy {self.strategy.name}: decide must return a Decision; it returned {shown(decided)}"
            )
        decision = self._completion.review(decided, situation)
        self._apply(decision)
        return Move(
            situation.step,
            cells_to_bytes(decision.path[:MAX_WAY_CELLS]),
            decision.heading,
            decision.explored and self._completion.is_certain(self.planning, situation),
            decision.look,
            decision.stalled,
            points_to_bytes(decision.points[:MAX_WAY_CELLS]),
        )

    def _without_ignored_frontiers(self, sense: Sense) -> Grid:
        """Return the planning grid without the frontiers that are small, or due to errors of the sensors."""
        grid = self.planning
        if self._noisy_grid is not None:
            self._noisy_grid.drive(sense.x, sense.y)
            if sense.blocked == WALL:
                self._noisy_grid.bump(*cell_ahead(sense, self.settings.body.radius_cells))
            grid = self._noisy_grid.explorable(self.planning, self.own)
        least = self.settings.min_frontier_cells
        return without_small_frontiers(grid, least) if least > 1 else grid

    def avoid(self, target: Cell, steps: int) -> None:
        """Avoid a target that the robot could not reach for some steps; with exact lasers, this has no effect."""
        if self._noisy_grid is not None:
            self._noisy_grid.avoided.add(target, steps)

    def _report_false_maps(self) -> None:
        """Report robots whose maps others contradict; with digests, only once their authors could disown entries."""
        doubted = self._encoding.doubted
        if not doubted and not self._doubted_steps:
            return
        self._doubted_steps = {peer: self._doubted_steps.get(peer, 0) + 1 for peer in doubted}
        wait = INTERVAL * self.settings.robots if self.settings.replication.digests else 0
        new = {peer for peer, steps in self._doubted_steps.items() if steps > wait} - self.disbelieved
        self.peer_errors += [PeerError(peer, doubted[peer], "false map") for peer in sorted(new)]
        self.disbelieved |= new

    def _apply(self, decision: Decision) -> None:
        """Take over a decision, and prepare what teammates are sent of it."""
        if self.strategy.publishes_target and decision.target is not None and decision.target != self.target:
            self._announcements.set_target(decision.target)
        self.target = decision.target
        self.status = decision.status
        if decision.publish:
            self._publish()

    def _report(self, rejections: list[Rejected]) -> None:
        """Note rejected map updates as errors of their senders."""
        self.peer_errors += [PeerError(rejected.peer, rejected.reason) for rejected in rejections]

    def _publish(self) -> None:
        """Append all withheld entries to the log."""
        self.replication.own_log.append(self._withheld)
        self.replication.urgency = self._encoding.urgency
        self._withheld = []


def _consume(encoding: MapEncoding, team: TeamState, peer: int, map_id: int, frame: bytes) -> Sequence[int]:
    """Decode entries of a map that a teammate sent; return where in the frame each one ends."""
    ends = packet_index.ends(frame)
    encoding.apply(map_id, frame, step=team.step, sender=peer)
    team.infer_pose(encoding.settings.author_of(map_id), encoding.scan_cell(map_id))
    return ends


def _rebuild(encoding: MapEncoding, team: TeamState, logs: Sequence[bytes]) -> None:
    """Decode all logs again."""
    encoding.rebuild(logs, team.step)
