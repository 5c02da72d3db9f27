"""The contents of the dashboard, logged to Rerun: to a file, and to all connected viewers.

Everything is on one timeline, the steps of the run. Constant properties (colors, names, widths) are logged once; a step
then takes about thirty small rows. `deploy.dashboard.layout` arranges the entities in views.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import rerun as rr

from deploy.dashboard import shapes
from deploy.dashboard.help_text import explain, shows_range
from deploy.dashboard.run_events import Event, RunEvents
from deploy.dashboard.shapes import flip
from deploy.dashboard.step_order import StepOrder, StepReports
from deploy.record.colors import ALARM, GREY, GROUPS, IN_RANGE, PAPER, SIGNAL, TEAM, mix, robot_color
from deploy.record.map_history import PER_STEP
from deploy.record.map_quality import WallScore, true_walls_of
from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol.cell_bytes import grid_from_bytes, grid_to_bytes
from protocol.errors import ProtocolError
from protocol.grid import FREE
from protocol.messages import End, Outlines, Snapshot, WorldReport

TIMELINE = "step"
NAN = float("nan")
SHARES_EVERY = 5
"""Steps from one drawing of the traffic shares to the next."""
SHARES_HEIGHT, MOST_TYPES, BAR_AT = 150.0, 6, 0.84
"""Height of the picture of traffic shares, which is 100 wide; its rows; where in its row a bar is, below its label."""
FLOOR = 0.03
"""Room below zero bytes, in the height of the curves: an invisible curve keeps the labels of both axes apart."""
MARGIN, SMALL_MARGIN = 0.13, 0.3
"""Room for the labels of axes beside the true map and beside a robot's map, in map sides."""
FAINT = 0.5
"""Paleness of outlines received from teammates; Rerun draws lines with opacity black."""
MAP_ORDER, RANGE_ORDER, WAY_ORDER, OUTLINE_ORDER, LINK_ORDER, TARGET_ORDER, ROBOT_ORDER = range(0, 70, 10)
"""The drawing order of layers."""


class Recorder:
    """Draws a run from its reports to a stream whose sinks are set."""

    def __init__(self, stream: rr.RecordingStream, plan: Plan) -> None:
        self.events = RunEvents(plan)
        self._order = StepOrder()
        self._stream = stream
        self._plan = plan
        self._robots = range(plan.scenario.robots)
        self._reachable = plan.reachable
        self._true_walls = true_walls_of(plan, self._reachable)
        self._explored = [0.0] * len(self._robots)
        self._walls = dict.fromkeys(self._robots, WallScore(None, None, None))
        self._drawn: Counter[tuple[str, int]] = Counter()
        """How often each map of each sender was drawn in this step; -1 is the planning map."""
        side = max(plan.map.width, plan.map.height) * plan.map.resolution
        self._disc = 0.022 * side
        self._highest = 0
        """The most bytes of a step so far, or the highest budget."""
        stream.set_time(TIMELINE, sequence=0)
        self._draw_maps()
        self._draw_styles()
        self._log("help", rr.TextDocument(explain(plan), media_type=rr.MediaType.MARKDOWN), static=True)

    def take(self, sender: str, report: Any) -> None:
        """Draw a report of `sender`, each map `PER_STEP` times a step at most; ProtocolError if its size is wrong."""
        if isinstance(report, Snapshot | Outlines):
            self._check_size(report)
            drawn = sender, report.map_id if isinstance(report, Outlines) else -1
            self._drawn[drawn] += 1
            if self._drawn[drawn] > PER_STEP:
                return
        elif isinstance(report, WorldReport):
            self._drawn.clear()
        for step in self._order.put(sender, report):
            self._draw(step)

    def finish(self) -> None:
        """Draw all that was held back because its step was incomplete."""
        for step in self._order.finish():
            self._draw(step)

    def _draw(self, step: StepReports) -> None:
        """Draw the reports of a step; those of an earlier step, which arrived late, where they belong."""
        self._stream.set_time(TIMELINE, sequence=step.step)
        traffic = self.events.traffic
        for sender, report in step.reports:
            for event in self.events.take(sender, report):
                self._log("events", _line(event))
            if isinstance(report, Snapshot):
                self._draw_planning_map(names.number(sender), report)
            elif isinstance(report, Outlines):
                outlines = rr.LineStrips2D.from_fields(
                    strips=shapes.outline_strips(self._plan.map, report.vertices)
                )
                self._log(f"robots/{names.number(sender)}/outlines/{report.map_id}", outlines)
        if step.has_world or any(isinstance(report, End) for _, report in step.reports):
            self._draw_world()
        if self.events.traffic is not traffic:
            self._draw_traffic()
            if step.step == self.events.step:
                self._draw_links()

    def _check_size(self, report: Snapshot | Outlines) -> None:
        """Raise ProtocolError if a map of a robot is of another size than the world."""
        world = self._plan.map
        if isinstance(report, Snapshot) and (report.width, report.height) != (world.width, world.height):
            size = f"{report.width} x {report.height}"
            raise ProtocolError(
                "Snapshot", 0, f"{size} cells, where the map has {world.width} x {world.height}"
            )

    def _log(self, path: str, *values: Any, static: bool = False) -> None:
        self._stream.log(path, *values, static=static)

    def _draw_maps(self) -> None:
        """The true map, and an empty one for each robot, with axes."""
        world = self._plan.map
        cell = world.resolution
        place = rr.Transform3D(translation=[*shapes.corner(world), 0], scale=[cell, cell, 1])
        cells = grid_to_bytes(world.cells)
        for tree in ("world", *(f"robots/{robot}" for robot in self._robots)):
            self._log(f"{tree}/map", place, static=True)
            picture = shapes.map_picture(
                world.width, world.height, cells if tree == "world" else bytes(len(cells))
            )
            self._log(f"{tree}/map", _image(picture))
            large = tree == "world"
            strips, places, labels = shapes.axes(
                world, most=6 if large else 3, room=MARGIN if large else SMALL_MARGIN
            )
            lines = rr.LineStrips2D(strips, colors=[GREY], radii=[_px(0.8)])
            self._log(f"{tree}/axes/lines", lines, static=True)
            ticks = rr.Points2D(places, labels=labels, colors=[GREY], radii=[_px(0.1)], show_labels=True)
            self._log(f"{tree}/axes/labels", ticks, static=True)

    def _draw_styles(self) -> None:
        """Log constant properties: colors, line widths, names of series."""
        colors = [robot_color(robot) for robot in self._robots]
        style = rr.LineStrips2D.from_fields
        lines = {
            "world/links/quiet": style(colors=[IN_RANGE], radii=[_px(0.8)], draw_order=LINK_ORDER),
            "world/ranges": style(radii=[_px(0.5)], draw_order=RANGE_ORDER),
            "world/targets/ways": style(radii=[_px(0.8)], draw_order=TARGET_ORDER),
            "world/robots/numbers": style(colors=[PAPER], radii=[_px(0.9)], draw_order=ROBOT_ORDER + 1),
        }
        for robot in self._robots:
            color = [robot_color(robot)]
            lines[f"paths/{robot}"] = style(colors=color, radii=[_px(0.6)], draw_order=WAY_ORDER)
            for maker in self._robots:
                own = maker == robot
                lines[f"robots/{robot}/outlines/{maker}"] = style(
                    colors=[robot_color(maker) if own else mix(robot_color(maker), PAPER, FAINT)],
                    radii=[_px(0.6 if own else 0.3)],
                    draw_order=OUTLINE_ORDER + own,
                )
            points, order = rr.Points2D.from_fields, ROBOT_ORDER + 0.5
            disc = points(colors=color, radii=[self._disc], draw_order=order)
            self._log(f"robots/{robot}/self", disc, static=True)
            mark = points(colors=color, radii=[self._disc / 2], draw_order=TARGET_ORDER)
            self._log(f"robots/{robot}/target", mark, static=True)
        for path, line in lines.items():
            self._log(path, line, static=True)
        arrows = rr.Arrows2D.from_fields(colors=[SIGNAL], draw_order=LINK_ORDER + 1)
        self._log("world/links/busy", arrows, static=True)
        team = rr.SeriesLines(names=["seen by the team"], colors=[TEAM], widths=[4])
        self._log("explored/team", team, static=True)
        on_map = "on the map of robot"
        for path, label in (
            ("explored/maps", on_map), ("walls/f1", "F1 on the map of robot"),
            ("walls/precision", "precision on the map of robot"), ("backlog", "robot"), ("missed", "robot"),
        ):  # fmt: skip
            named = [f"{label} {robot}" for robot in self._robots]
            width = 0.5 if path == "walls/precision" else 1.5
            series = rr.SeriesLines(names=named, colors=colors, widths=[width] * len(colors))
            self._log(path, series, static=True)
        groups = list(GROUPS.values())
        load = rr.SeriesLines(
            names=["total", *(group.label for group in groups)],
            colors=[TEAM, *(group.color for group in groups)],
            widths=[2.5, *(1.5 for _ in groups)],
        )
        self._log("traffic/load", load, static=True)
        floor = rr.SeriesLines(names=[""], colors=[(0, 0, 0, 0)], widths=[0.1])
        self._log("traffic/floor", floor, static=True)
        self._log("traffic/budget", rr.SeriesLines(names=["budget"], colors=[GREY], widths=[1]), static=True)

    def _draw_world(self) -> None:
        """Draw positions, targets and explored area."""
        events = self.events
        robots = sorted(events.positions)
        places = [flip(events.positions[robot]) for robot in robots]
        colors = [robot_color(robot) for robot in robots]
        discs = rr.Points2D(places, radii=[self._disc], colors=colors, draw_order=ROBOT_ORDER)
        self._log("world/robots", discs)
        numbers = [
            strip
            for robot, place in zip(robots, places, strict=True)
            for strip in shapes.number_strips(robot, place, self._disc)
        ]
        self._log("world/robots/numbers", rr.LineStrips2D.from_fields(strips=numbers))
        reach = events.range_m
        if shows_range(self._plan):
            world = self._plan.map
            arcs = [
                (robot, arc)
                for robot, place in zip(robots, places, strict=True)
                for arc in shapes.circle_within(world, place, reach)
            ]
            shades = [mix(robot_color(robot), GREY, 0.5) for robot, _ in arcs]
            circles = rr.LineStrips2D.from_fields(strips=[arc for _, arc in arcs], colors=shades)
            self._log("world/ranges", circles)
        for robot, place in zip(robots, places, strict=True):
            way = np.array(events.ways[robot]) * (1, -1)
            self._log(f"paths/{robot}", rr.LineStrips2D.from_fields(strips=[way]))
            self._log(f"robots/{robot}/self", rr.Points2D.from_fields(positions=[place]))
            target = [flip(events.targets[robot])] if robot in events.targets else []
            self._log(f"robots/{robot}/target", rr.Points2D.from_fields(positions=target))
        if people := [flip(place) for place in events.people]:
            radius = self._plan.scenario.people.radius
            points = rr.Points2D(people, radii=[radius], colors=[GREY], draw_order=TARGET_ORDER)
            self._log("world/people", points)
        self._draw_targets()
        self._log("explored/team", rr.Scalars(100 * events.seen))
        self._log("explored/maps", rr.Scalars(self._explored))
        scores = self._walls.values()
        self._log("walls/f1", rr.Scalars([_percent(score.f1) for score in scores]))
        self._log("walls/precision", rr.Scalars([_percent(score.precision) for score in scores]))
        self._log("backlog", rr.Scalars([events.backlog.get(robot, 0) for robot in self._robots]))
        if self._plan.scenario.clock != "barrier":
            self._log("missed", rr.Scalars([events.missed[robot] for robot in self._robots]))

    def _draw_targets(self) -> None:
        events = self.events
        heading = [robot for robot in sorted(events.targets) if robot in events.positions]
        colors = [robot_color(robot) for robot in heading]
        ends = [(flip(events.positions[robot]), flip(events.targets[robot])) for robot in heading]
        self._log("world/targets/ways", rr.LineStrips2D.from_fields(strips=ends, colors=colors))
        there = [end for _, end in ends]
        marks = rr.Points2D(there, colors=colors, radii=[self._disc / 2], draw_order=TARGET_ORDER)
        self._log("world/targets", marks)

    def _draw_traffic(self) -> None:
        events = self.events
        traffic = events.traffic
        assert traffic is not None
        used = {group for group in GROUPS if any(kind in events.bytes for kind in GROUPS[group].kinds)}
        load = [traffic.groups[group] if group in used else NAN for group in GROUPS]
        self._log("traffic/load", rr.Scalars([traffic.carried, *load]))
        self._highest = max(self._highest, traffic.carried, events.budget.limit or 0)
        self._log("traffic/floor", rr.Scalars(-FLOOR * self._highest))
        if events.budget.limit is not None:
            self._log("traffic/budget", rr.Scalars(events.budget.limit))
        if events.step % SHARES_EVERY == 1:
            self._draw_shares()

    def _draw_links(self) -> None:
        """Draw who received bytes from whom in this step, and which other robots were in range of each other."""
        events = self.events
        assert events.traffic is not None
        here = events.positions
        busy = {pair: size for pair, size in events.traffic.links.items() if here.keys() >= set(pair)}
        quiet = sorted(events.in_range - {(min(pair), max(pair)) for pair in busy})
        strips = [(flip(here[a]), flip(here[b])) for a, b in quiet]
        self._log("world/links/quiet", rr.LineStrips2D.from_fields(strips=strips))
        arrows = [shapes.arrow(flip(here[a]), flip(here[b]), 1.2 * self._disc) for a, b in busy]
        origins, vectors = [each[0] for each in arrows], [each[1] for each in arrows]
        radii = [_px(0.9 + min(1.6, size / 400)) for size in busy.values()]
        self._log("world/links/busy", rr.Arrows2D.from_fields(origins=origins, vectors=vectors, radii=radii))

    def _draw_shares(self) -> None:
        """Draw bars of the bytes so far by traffic type, the longest on top, each below its label."""
        sent = self.events.bytes
        spent = {name: sum(sent.get(kind, 0) for kind in group.kinds) for name, group in GROUPS.items()}
        total = sum(spent.values())
        shown = sorted((group for group in spent if spent[group]), key=lambda group: -spent[group])
        longest = max(spent.values())
        row = SHARES_HEIGHT / MOST_TYPES
        bars, places, labels = [], [], []
        for line, group in enumerate(shown):
            down = row * (line + BAR_AT)
            bars.append([(0.0, down), (100 * spent[group] / longest, down)])
            places.append((50.0, row * line))
            labels.append(f"{group} {100 * spent[group] / total:.0f} %")
        colors = [GROUPS[group].color for group in shown]
        self._log("traffic/shares/bars", rr.LineStrips2D(bars, colors=colors, radii=[0.08 * row]))
        named = rr.Points2D(places, labels=labels, colors=colors, radii=[_px(0.1)], show_labels=True)
        self._log("traffic/shares/names", named)

    def _draw_planning_map(self, robot: int, snapshot: Snapshot) -> None:
        grid = grid_from_bytes(snapshot.planning, snapshot.width, snapshot.height)
        picture = shapes.map_picture(snapshot.width, snapshot.height, snapshot.planning)
        self._log(f"robots/{robot}/map", _image(picture))
        self._explored[robot] = 100 * float((grid[self._reachable] == FREE).mean())
        if self._plan.has_truth:
            self._walls[robot] = self._true_walls.score(grid)


def _image(png: bytes) -> rr.EncodedImage:
    return rr.EncodedImage(
        contents=png, media_type="image/png", draw_order=MAP_ORDER, magnification_filter="nearest"
    )


def _percent(share: float | None) -> float:
    return NAN if share is None else 100 * share


def _px(size: float) -> Any:
    """A radius in points on the screen, independent of the zoom."""
    return -size


def _line(event: Event) -> rr.TextLog:
    level = (rr.TextLogLevel.DEBUG, rr.TextLogLevel.INFO, rr.TextLogLevel.ERROR)[event.weight]
    color = (GREY, None, ALARM)[event.weight]  # None: the theme's own for text
    return rr.TextLog(f"{event.step}: {event.text}", level=level, color=color)
