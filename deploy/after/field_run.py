"""One run from the records of robots in the field: what a recorder would have of them, on one clock.

A step of the run lasts as long as the robots' steps. In each step, the run has the last known state of each robot, from
its first pose to the end of its record. There is no true map: the map of the run is the one that the team has made.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, groupby, pairwise

import numpy as np

from deploy.record.field_records import FieldRecord, StepLine
from deploy.record.map_history import MapHistory
from deploy.record.records import Records
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario, parse
from protocol.errors import ProtocolError
from protocol.grid import FREE, UNKNOWN, Grid
from protocol.message_fields import clip
from protocol.messages import MapChanges, Missed, Outlines, RobotStatus, WorldReport
from protocol.nanoseconds import SECOND
from protocol.plugins import without_import
from worldsim.clock import MOVE
from worldsim.maps import Map, MapError

NAME = "the field"
"""The name of the map in results."""
MAX_RUN_STEPS = 10_000_000
"""Steps of a run that can be joined: a hundred days of a step per second."""

TEAM = ("robots", "width", "height", "resolution", "encoding", "incarnations")
"""Settings that must be equal on all robots."""


@dataclass(frozen=True)
class FieldStart:
    """One start of a robot, and what must be added to its times for those of the common clock, in nanoseconds."""

    record: FieldRecord
    offset: int

    @property
    def robot(self) -> int:
        """The robot's number."""
        return self.record.robot

    def times(self) -> list[int]:
        """Return when each step began, by the common clock."""
        return [line.time_ns + self.offset for line in self.record.steps]


@dataclass(frozen=True)
class Timeline:
    """The steps of a run on the common clock: `begin` of the first one, and their duration, in nanoseconds."""

    begin: int
    step_ns: int
    steps: int

    @classmethod
    def of(cls, starts: Sequence[FieldStart], times: Sequence[int]) -> Timeline:
        """Return the steps of the robots, and of frames at other `times`; ValueError if there are far too many."""
        step_ns = max(each.record.setup.step_ns for each in starts)
        every = [*times, *(time for each in starts for time in each.times())]
        if not every:
            raise ValueError("the robots have recorded neither steps nor frames")
        begin, steps = min(every), 1 + (max(every) - min(every)) // step_ns
        if steps > MAX_RUN_STEPS:
            raise ValueError(
                f"the records are {(max(every) - begin) // SECOND} seconds apart: one of the clocks was set in between"
            )
        return cls(begin, step_ns, steps)

    def step(self, time: int) -> int:
        """Return the step of a time."""
        return 1 + (time - self.begin) // self.step_ns


def assemble(
    starts: Sequence[FieldStart], timeline: Timeline, rows: Mapping[int, bytes]
) -> tuple[Plan, Records]:
    """Return the plan and the records of a run; `rows` are those of the ledger, by step.

    ValueError if the robots are not of one team, or have made no map.
    """
    _check_team(starts)
    starts = sorted(starts, key=lambda each: (each.robot, each.times()[:1]))
    settings = starts[0].record.setup.settings
    records = Records(settings.robots, _history(starts, timeline))
    records.rows = [rows[step] for step in sorted(rows)]
    _take_maps(records, starts, timeline.steps)
    plan = _plan(starts, timeline, records.team_map() if records.own else None)
    _take_steps(records, plan, starts, timeline)
    for before, after in pairwise(starts):
        if before.robot == after.robot and after.record.steps:
            records.returned.append((timeline.step(after.times()[0]), after.robot))
    last = {each.robot: each.record for each in starts}
    for robot in range(settings.robots):
        if robot not in last:
            records.lost[robot] = "its record is missing"
        elif last[robot].ending is None:
            records.lost[robot] = "its record breaks off"
    return plan, records


def _check_team(starts: Sequence[FieldStart]) -> None:
    """Raise ValueError if robots differ in settings that a team has in common, or a start is given twice."""
    first, seen = starts[0].record, set()
    for each in starts:
        record = each.record
        for name in TEAM:
            here, there = (getattr(setup.settings, name) for setup in (record.setup, first.setup))
            if here != there:
                raise ValueError(
                    f"{record.folder}: {name} = {here}, but {there} in {first.folder}: not one team"
                )
        if (record.setup.x, record.setup.y) != (first.setup.x, first.setup.y):
            raise ValueError(f"{record.folder}: its grid lies elsewhere than that of {first.folder}")
        start = each.robot, record.setup.settings.incarnation
        if start in seen:
            raise ValueError(f"{record.folder}: start {start[1] + 1} of robot {each.robot} is given twice")
        seen.add(start)


# --- maps


def _history(starts: Sequence[FieldStart], timeline: Timeline) -> MapHistory:
    """Return the maps of all robots over time; ValueError if a change does not fit the grid."""
    settings = starts[0].record.setup.settings
    history = MapHistory((settings.height, settings.width))
    cells: defaultdict[tuple[int, int], list[MapChanges]] = defaultdict(list)
    outlines: dict[tuple[int, int, int], Outlines] = {}
    for each in starts:
        steps = [line.step for line in each.record.steps]
        times = each.times()
        for change in each.record.changes:
            at = bisect_right(steps, change.step) - 1
            step = timeline.step(times[at]) if at >= 0 else 1
            if isinstance(change, MapChanges):
                cells[each.robot, step].append(change)
            else:
                outlines[each.robot, change.map_id, step] = Outlines(step, change.map_id, change.vertices)
    try:
        for (robot, step), parts in sorted(cells.items()):
            joined = b"".join(part.cells for part in parts), b"".join(part.values for part in parts)
            history.take(robot, MapChanges(step, *joined))
        for (robot, _, _), outline in sorted(outlines.items()):
            history.take(robot, outline)
    except ProtocolError as error:
        raise ValueError(f"the records of robot {robot}: {error}") from None
    return history


def _take_maps(records: Records, starts: Sequence[FieldStart], last: int) -> None:
    """Take each robot's maps at the end: of its last start, but its own map from all starts."""
    for each in starts:
        robot, maps = each.robot, each.record.maps
        for grids in (records.planning, records.shared, records.settled):
            grids.pop(robot, None)
        own = records.maps.own(robot, last) if maps is None else maps.own
        planning = records.maps.planning(robot, last) if maps is None else maps.planning
        if own is None or planning is None:
            continue
        before = records.own.get(robot)
        records.own[robot] = own if before is None else np.where(own == UNKNOWN, before, own)
        records.planning[robot] = planning
        if maps is not None:
            records.shared[robot], records.settled[robot] = maps.shared, maps.settled


# --- settings


def _plan(starts: Sequence[FieldStart], timeline: Timeline, team_map: Grid | None) -> Plan:
    """Return the plan: the team's map, and settings that describe the robots."""
    setup = starts[0].record.setup
    if team_map is None:
        raise ValueError("no robot has recorded a map")
    try:
        world_map = Map(NAME, team_map, setup.settings.resolution, (setup.x, setup.y, 0.0))
    except MapError as error:
        raise ValueError(f"the map of the team: {error}") from None
    with without_import():
        return plans.of_field(_scenario(starts, timeline), world_map)


def _scenario(starts: Sequence[FieldStart], timeline: Timeline) -> Scenario:
    last = {each.robot: each.record.setup for each in starts}
    first = starts[0].record.setup
    settings = first.settings
    hardware = {
        robot: {
            "sensor_range": setup.settings.body.range_cells * settings.resolution,
            "field_of_view": setup.settings.body.field_of_view,
            "speed": setup.settings.body.speed * settings.resolution * timeline.step_ns / setup.step_ns,
            "radius": setup.settings.body.radius_cells * settings.resolution,
        }
        for robot, setup in last.items()
    }
    common = hardware[starts[0].robot]
    rate = sum(setup.bytes_per_s for setup in last.values()) * settings.robots / len(last)
    encoding = settings.encoding
    return parse(
        {
            "robots": settings.robots,
            "seed": settings.seed,
            "strategy": settings.strategy,
            "options": settings.options,
            "min_frontier_size": settings.min_frontier_cells * settings.resolution,
            "map_encoding": encoding.name,
            "polygons": encoding.polygons,
            "predictive": encoding.predictive,
            "tolerance": encoding.tolerance,
            "dissemination": settings.replication.dissemination,
            "clock": "field",
            "step_s": timeline.step_ns / SECOND,
            "steps": timeline.steps,
            "bandwidth": round(rate * timeline.step_ns / SECOND),
            "range": "0",
            "robot": [{"robot": robot, **each} for robot, each in sorted(hardware.items()) if each != common],
            **common,
        },
        "the records",
    )


# --- steps


def _take_steps(records: Records, plan: Plan, starts: Sequence[FieldStart], timeline: Timeline) -> None:
    """Take the last known state of each robot in each step, and how much of its map the team knew.

    `starts` are sorted by robot.
    """
    of_robots = groupby(starts, lambda start: start.robot)
    states = {robot: _states(own, timeline) for robot, own in of_robots}
    seen = _seen(records, plan, timeline.steps)
    driven = {robot: _driven(own, plan.map.resolution) for robot, own in states.items()}
    total = int(np.count_nonzero(plan.reachable))
    distances = [0] * records.robots
    for step in range(1, timeline.steps + 1):
        poses: list[tuple[int, ...]] = []
        for robot, own in states.items():
            line, before = own.get(step), own.get(step - 1)
            distances[robot] = driven[robot].get(step, distances[robot])
            if line is None:
                continue
            if before is not None and line.late_steps > before.late_steps:
                records.missed.append(Missed(step, MOVE, 0, [robot]))
            poses.append((robot, line.x_mm or 0, line.y_mm or 0, line.heading or 0))
            records.statuses[robot].append(
                RobotStatus(
                    step, line.target_x, line.target_y, line.known_cells, error=0, exact_error=-1,
                    backlog=line.backlog, status=clip(line.status or ""), work_us=line.work_us,
                )
            )  # fmt: skip
        records.world.append(
            WorldReport(step, np.array(poses, "<i4").tobytes(), [*distances], seen[step], total)
        )


def _states(starts: Iterable[FieldStart], timeline: Timeline) -> dict[int, StepLine]:
    """Return the last line that a robot recorded up to the end of each step, with its last known pose.

    Steps between two of its starts have none.
    """
    states: dict[int, StepLine] = {}
    for each in starts:
        pose: tuple[int | None, ...] | None = None
        lines: dict[int, StepLine] = {}
        for time, line in zip(each.times(), each.record.steps, strict=True):
            if line.x_mm is not None:
                pose = line[2:5]
            if pose is not None:
                x_mm, y_mm, heading = pose
                lines[timeline.step(time)] = line._replace(x_mm=x_mm, y_mm=y_mm, heading=heading)
        for step in range(min(lines, default=1), max(lines, default=0) + 1):
            states[step] = lines[step] = lines.get(step) or lines[step - 1]
    return states


def _driven(states: Mapping[int, StepLine], cell: float) -> dict[int, int]:
    """Return the distance driven up to each step, in millimeters; moves of less than a cell may be noise."""
    driven: dict[int, int] = {}
    place: tuple[int, int] | None = None
    total = 0.0
    for step, line in sorted(states.items()):
        here = line.x_mm or 0, line.y_mm or 0
        if place is None or math.dist(place, here) >= 1000 * cell:
            total += math.dist(place or here, here)
            place = here
        driven[step] = round(total)
    return driven


def _seen(records: Records, plan: Plan, last: int) -> list[int]:
    """Return how many free cells of the team's final map the robots have seen up to each step, from step 0."""
    known = np.zeros(plan.reachable.shape, np.bool_)
    counts = [0] * (last + 1)
    changes = sorted({(step, robot) for robot in range(records.robots) for step in records.maps.steps(robot)})
    for step, robot in changes:
        own = records.maps.own(robot, step)
        if own is not None:
            known |= (own == FREE) & plan.reachable
            counts[min(step, last)] = int(np.count_nonzero(known))
    return list(accumulate(counts, max))
