"""The state and the events of a run, step by step, from the reports of its participants."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from deploy.dashboard.shapes import Point, extend
from deploy.record.colors import GROUPS
from deploy.scenario.plan import Plan
from netshaper.ledger import CAUSES, KIND_NUMBER, LINK, ROW
from netshaper.topology import links
from protocol import keys as names
from protocol.budget import UNLIMITED, Budget
from protocol.messages import Change, End, ErrorReport, Lost, Missed, RadioReport, RobotStatus, WorldReport
from worldsim.clock import MOVE, STEP
from worldsim.maps import to_world

BUDGET = CAUSES.index("budget")

MAX_ERRORS = 100
"""Number of malformed messages of each participant that are shown."""
NEAR = 0.5
"""Share of the sensor range: a new target nearer to the old one counts as the same frontier."""


@dataclass(frozen=True)
class Event:
    """An event to log. `weight`: 0 for routine events, 1 for important ones, 2 for losses."""

    step: int
    text: str
    weight: int = 0


@dataclass
class StepTraffic:
    """The traffic of one step."""

    groups: dict[str, int]
    """Bytes carried, by group of packet kinds (`deploy.record.colors.GROUPS`)."""
    links: dict[tuple[int, int], int]
    """Bytes that one robot (second) received from another (first); a broadcast counts for each of its receivers."""

    @property
    def carried(self) -> int:
        """All bytes carried."""
        return sum(self.groups.values())


@dataclass
class RunEvents:
    """The state of the run according to the reports so far."""

    plan: Plan
    step: int = 0
    positions: dict[int, Point] = field(default_factory=dict)
    """The true position of each living robot."""
    ways: dict[int, list[Point]] = field(default_factory=dict)
    """Each robot's path: its corners, and the current position."""
    people: list[Point] = field(default_factory=list)
    """The true positions of the people in the building."""
    targets: dict[int, Point] = field(default_factory=dict)
    backlog: dict[int, int] = field(default_factory=dict)
    missed: Counter[int] = field(default_factory=Counter)
    """Steps so far that each robot has missed by the wall clock."""
    seen: float = 0.0
    """Fraction of the reachable cells that the team has seen."""
    in_range: set[tuple[int, int]] = field(default_factory=set)
    """Pairs of robots that receive each other in this step, by the radio's model (lower number first)."""
    traffic: StepTraffic | None = None
    bytes: Counter[str] = field(default_factory=Counter)
    """Bytes carried so far, by packet kind."""
    idle: set[int] = field(default_factory=set)
    budget: Budget = UNLIMITED
    """Bytes that the team may transmit in this step."""
    range_m: float = 0.0
    _errors: Counter[str] = field(default_factory=Counter)
    _full: bool = False
    _logged_targets: dict[int, Point] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._radio_settings = self.plan.radio
        self.budget, self.range_m = self.plan.radio.budget, self.plan.range_m

    def take(self, sender: str, report: object) -> list[Event]:
        """Process a report; return the resulting events."""
        if isinstance(report, WorldReport):
            return self._world(report)
        if isinstance(report, RadioReport):
            return self._radio(report)
        if isinstance(report, RobotStatus):
            return self._status(names.number(sender), report)
        if isinstance(report, Missed):
            return self._missed(report)
        if isinstance(report, Lost):
            self.positions.pop(report.robot, None)
            self.targets.pop(report.robot, None)
            self.in_range = {pair for pair in self.in_range if report.robot not in pair}
            return [Event(self.step, f"robot {report.robot} is lost: {report.cause}", 2)]
        if isinstance(report, Change):
            return self._change(report)
        if isinstance(report, ErrorReport):
            self._errors[report.participant] += 1
            text = f"{report.participant} sent a malformed message: {report.reason}"
            return [Event(self.step, text, 2)] if self._errors[report.participant] <= MAX_ERRORS else []
        if isinstance(report, End):
            explored = f"explored; robot {report.first} finished first"
            text = explored if report.first >= 0 else f"the run ended: {report.reason}"
            return [Event(self.step, text, 1)]
        return []

    def _world(self, report: WorldReport) -> list[Event]:
        self.step = report.step
        self.seen = report.seen / report.reachable
        cell_mm = 1000 * self.plan.map.resolution
        here = set(self.positions)
        poses = report.pose_rows.tolist()
        self.positions = {
            robot: to_world(self.plan.map, x / cell_mm, y / cell_mm) for robot, x, y, _ in poses
        }
        people = np.frombuffer(report.people, "<i4").reshape(-1, 2).tolist()
        self.people = [to_world(self.plan.map, x / cell_mm, y / cell_mm) for x, y in people]
        for robot, place in self.positions.items():
            extend(self.ways.setdefault(robot, []), place)
        for robot in sorted(self.targets.keys() - self.positions.keys()):
            del self.targets[robot]
        gone = sorted(here - self.positions.keys())
        before = self.in_range
        cells = {robot: (int(x / cell_mm + 0.5), int(y / cell_mm + 0.5)) for robot, x, y, _ in poses}
        near = links(self._radio_settings, self.step, cells)
        self.in_range = {(a, b) for a, others in near.items() for b in others if a < b}
        return [Event(self.step, f"robot {robot} has broken down", 2) for robot in gone] + [
            Event(self.step, f"robots {a} and {b} are in range")
            if (a, b) in self.in_range
            else Event(self.step, f"robots {a} and {b} are out of range", 1)
            for a, b in sorted(before ^ self.in_range)
            if self.step > 1 and a in self.positions and b in self.positions
        ]

    def _radio(self, report: RadioReport) -> list[Event]:
        rows = np.frombuffer(report.rows, ROW)
        carried = rows[rows["carried"] == 1]
        sizes = {
            kind: int(carried["bytes"][carried["kind"] == number].sum())
            for kind, number in KIND_NUMBER.items()
        }
        self.bytes += Counter(sizes)
        groups = {name: sum(sizes[kind] for kind in group.kinds) for name, group in GROUPS.items()}
        cut = self._cut_by_a_full_channel(rows)
        received = np.frombuffer(report.links, LINK).tolist()
        self.traffic = StepTraffic(groups, {(sender, receiver): size for sender, receiver, size in received})
        events = _emergences(report.step, carried)
        if bool(cut) != self._full and not self.budget.unlimited:
            self._full = bool(cut)
            if cut:
                events.append(Event(report.step, f"channel full: {cut} B not sent", 1))
        return events

    def _cut_by_a_full_channel(self, rows: NDArray[np.void]) -> int:
        """Return the bytes that the budget has cut; 0 if it had room for them.

        With gossip, poses and targets have a share of the budget: a channel is not full because they exceed it.
        """
        cut = rows[rows["cause"] == BUDGET]
        carried = int(rows["bytes"][rows["carried"] == 1].sum())
        if not len(cut):
            return 0
        only_broadcasts = np.isin(cut["kind"], [KIND_NUMBER["targ"], KIND_NUMBER["pose"]]).all()
        if only_broadcasts and self.budget.fits(carried + int(cut["bytes"].min())):
            return 0
        return int(cut["bytes"].sum())

    def _status(self, robot: int, report: RobotStatus) -> list[Event]:
        self.backlog[robot] = report.backlog
        events = []
        if report.target_x < 0:
            self.targets.pop(robot, None)
        else:
            target = self.targets[robot] = to_world(self.plan.map, report.target_x, report.target_y)
            logged = self._logged_targets.get(robot)
            range_m = self.plan.world.bodies[robot].range_cells * self.plan.map.resolution
            if logged is None or math.dist(logged, target) > NEAR * range_m:
                self._logged_targets[robot] = target
                text = f"robot {robot} heads for ({target[0]:.1f}, {target[1]:.1f}) m"
                events.append(Event(report.step, text))
        idle = report.status.startswith("idle")
        if idle and robot not in self.idle:
            events.append(Event(report.step, f"robot {robot} is idle: its map is complete", 1))
        (self.idle.add if idle else self.idle.discard)(robot)
        return events

    def _missed(self, report: Missed) -> list[Event]:
        named = ", ".join(map(str, report.robots))
        robots = f"robot{'s' * (len(report.robots) > 1)} {named}"
        if report.phase not in (MOVE, STEP):
            return [
                Event(report.step, f"{robots} answered too late: {report.phase} of round {report.round}", 1)
            ]
        self.missed.update(report.robots)
        what = "missed the step" if report.phase == MOVE else "took no part: still at work on an earlier step"
        return [Event(report.step, f"{robots} {what}", 2)]

    def _change(self, change: Change) -> list[Event]:
        changes = []
        if change.budget is not None:
            self.budget = change.budget
            changes.append("unlimited" if self.budget.unlimited else f"{self.budget} bytes per step")
        if change.range_mm is not None:
            self.range_m = change.range_mm / 1000
            cells = self.range_m / self.plan.map.resolution
            self._radio_settings = replace(self._radio_settings, range_cells=cells)
            changes.append(f"range {self.range_m:.1f} m")
        return [Event(change.step, f"radio changed: {', '.join(changes)}", 2)]


def _emergences(step: int, carried: NDArray[np.void]) -> list[Event]:
    """Objects that a robot has sent for the first time: of its own map, to any receiver."""
    own = carried[(carried["kind"] == KIND_NUMBER["em"]) & (carried["map"] == carried["sender"])]
    events = []
    for robot in np.unique(own["sender"]).tolist():
        count = int(own["packets"][own["sender"] == robot].sum())
        what = "a new object" if count == 1 else f"{count} new objects"
        events.append(Event(step, f"robot {robot} reports {what}"))
    return events
