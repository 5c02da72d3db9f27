"""Bench of a robot's computations in a step: one core, processor time, each part against a named yardstick.

Inputs come from one exploration by 8 robots at 1 kB a step, on a generated office of 300 x 300 cells, or on
the map ``intel`` if the environment variable MURMUR_MAPS names a folder that has it. Wherever a yardstick
computes the same, its result is compared as well, and a difference aborts the bench.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agent.encodings.polygons import PolygonEncoding
from agent.encodings.predictive import PredictiveEncoding
from agent.outline.approximation import approximation, repair
from agent.outline.claims import Drawing
from agent.outline.contour import contours
from agent.outline.edits import Held, edit_script
from agent.outline.five_stages import five_stages
from agent.outline.merge import TeamMap
from agent.outline.objects import Objects
from agent.outline.polygons import Polygons
from agent.outline.simplify import mixed_first, refine
from agent.planning.cost_field import costs
from deploy.bench.explorations import SAMPLES, Cell, Moment, beams, explore, samples
from deploy.bench.handshakes import Handshakes, timed
from deploy.bench.ratios import Figure, compare
from deploy.bench.yardsticks import (
    cells_along,
    look_in_numpy,
    trace_by_opencv,
    without_corners,
    without_frame,
    yardstick,
)
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from protocol.grid import FREE, Grid, RayTable
from protocol.scans import draw
from worldsim import generators, maps
from worldsim.laser import cast
from worldsim.maps import Map

ROBOTS = 8
BUDGET = 1000
SIDE_M = 30.0


def kernels() -> Iterator[Figure]:
    """Every part of a robot's step, in the order of execution."""
    cv2, graph = yardstick("cv2", "opencv-python-headless"), yardstick("skimage.graph", "scikit-image")
    cv2.setNumThreads(1)
    plan = plans.make(
        Scenario(robots=ROBOTS, map_encoding="polygons", strategy="meier", bandwidth=BUDGET, bus="memory"),
        _map(),
    )
    walks = explore(plan)
    yield _scanning(plan, walks[0])
    yield _contours(walks, cv2)
    telling = _Telling(plan)
    for robot, walk in enumerate(walks):
        telling.follow(robot, walk)
    yield telling.figure()
    yield from _merging(walks[0], telling)
    yield _ways(walks[0], graph)
    yield _session(plan, telling.units)
    yield from _looks(plan, walks[0])


def _map() -> Map:
    folder = os.environ.get("MURMUR_MAPS")
    file = Path(folder or ".") / "intel.yaml"
    if folder and file.is_file():
        return maps.load(file)
    return generators.make("office", width_m=SIDE_M, height_m=SIDE_M)


def _check_same(ours: Grid, theirs: Grid, what: str) -> None:
    if not np.array_equal(ours, theirs):
        raise AssertionError(f"{what}: the yardstick's result is another")


def _scanning(plan: Plan, walk: Sequence[Moment]) -> Figure:
    """Cast a scan on the true map and draw it, against the same beams in numpy."""
    truth, ray_table = plan.map.cells, beams(plan)
    nobody = np.zeros(truth.shape, np.bool_)
    ours: list[float] = []
    theirs: list[float] = []
    for moment in samples(walk):
        mine, other = np.zeros_like(truth), np.zeros_like(truth)
        for known, look, times in ((mine, _look, ours), (other, look_in_numpy, theirs)):
            times.append(timed(partial(look, truth, nobody, ray_table, moment.cell, known))[1])
        _check_same(mine, other, "scan")
    return compare("scan, cast and drawn", "ms", ours, "the same beams in numpy", theirs)


def _look(truth: Grid, nobody: NDArray[np.bool_], ray_table: RayTable, cell: Cell, known: Grid) -> None:
    draw(known, ray_table, *cell, cast(truth, nobody, ray_table, *cell))


def _contours(walks: Sequence[Sequence[Moment]], cv2: Any) -> Figure:
    """Trace exact contours, against OpenCV on the same cells.

    OpenCV gives the cells along each contour; our contour points also have the side of the cell, and whether
    the cell is occupied. OpenCV finds one more contour: the frame of the picture.
    """
    ours, theirs = [], []
    height, width = walks[0][0].grid.shape
    solid = np.ones((height + 2, width + 2), np.uint8)
    for moment in (moment for walk in walks for moment in samples(walk)):
        found, spent = timed(partial(contours, moment.grid, moment.cell))
        ours.append(spent)
        traced, spent = timed(partial(trace_by_opencv, cv2, moment.grid, solid))
        theirs.append(spent)
        if len(ours) % SAMPLES == 0 and cells_along(found) != without_frame(traced):
            raise AssertionError("contours: OpenCV finds others")
    name = "OpenCV's findContours"
    return compare("contours of a robot's map", "ms", ours, name, theirs, "no slower")


class _Telling:
    """What robots send of their maps step by step, and the time it takes; the same from scratch, for comparison."""

    def __init__(self, plan: Plan) -> None:
        self.units: list[list[list[bytes]]] = []
        """Packets of every robot and step."""
        self.polygons: list[list[Polygons]] = []
        """What is told after them."""
        self._plan = plan
        self._incremental: list[float] = []
        self._anew: list[float] = []

    def follow(self, robot: int, walk: Sequence[Moment]) -> None:
        """Let one robot send its updates."""
        map_encoding = PolygonEncoding(self._plan.robot_settings[robot])
        self.units.append([])
        self.polygons.append([])
        for moment in walk:
            record = partial(
                map_encoding.encode_changes, moment.grid, moment.scan, moment.change, delivered=True
            )
            units, spent = timed(record)
            told = map_encoding.polygons[robot]
            self.units[-1].append(units)
            self.polygons[-1].append(told)
            if units:
                self._incremental.append(spent)
                self._anew.append(timed(partial(_say_anew, moment, len(told.x)))[1])

    def figure(self) -> Figure:
        """Everything before the radio."""
        return compare(
            "contours, repair, refinement and edits",
            "ms",
            self._incremental,
            "the whole map approximated and told anew",
            self._anew,
            "at most 1 ms",
        )


def _say_anew(moment: Moment, vertices: int) -> None:
    """Approximate a map by the given number of vertices, and send all of them."""
    nothing = Held.nothing(moment.grid.shape)
    exact = contours(moment.grid, moment.cell)
    marks = repair(nothing.polygons, exact)
    marks = refine(exact, marks, max(0, vertices - len(marks)), mixed_first)
    edit_script(nothing, approximation(exact, marks))


def _merging(walk: Sequence[Moment], telling: _Telling) -> Iterator[Figure]:
    """Merge 7 teammates of whom all, one or none have news, against Algorithm 9 line by line."""
    drawing = Drawing(free_inside_edges=False, unknown_pairs=False, wide_walls=True, close_slivers=True)
    team = TeamMap(drawing)
    steps = min(map(len, telling.polygons))
    all_new, one_new, none_new, by_lines = [], [], [], []
    for step in np.linspace(steps // 4, steps - 1, SAMPLES).astype(int).tolist():
        own, polygons = walk[step].grid, [told[step] for told in telling.polygons[1:]]
        merged, spent = timed(partial(_merge, team, own, polygons))
        all_new.append(spent)
        one_new.append(timed(partial(_merge, team, own, polygons[:1]))[1])
        none_new.append(timed(partial(_merge, team, own, []))[1])
        stages, spent = timed(partial(five_stages, own, polygons, drawing))
        by_lines.append(spent)
        _check_same(merged, stages.complete, "merging")
    others = ROBOTS - 1
    book = "Algorithm 9 line by line"
    yield compare(f"merging {others} teammates, all changed", "ms", all_new, book, by_lines, "at most 2 ms")
    yield compare(f"merging {others} teammates, one changed", "ms", one_new, "all changed", all_new)
    yield compare(f"merging {others} teammates, none changed", "ms", none_new, "all changed", all_new)


def _merge(team: TeamMap, own: Grid, changed: Sequence[Polygons]) -> Grid:
    for robot, polygons in enumerate(changed, 1):
        team.update(robot, Objects.of(polygons))
    return team.merged(own)


def _ways(walk: Sequence[Moment], graph: Any) -> Figure:
    """Costs to all cells, against skimage's shortest paths on the same cells.

    Its paths may cut corners, which is the easier problem. If that is forbidden, by a graph in three dimensions,
    skimage gives our result.
    """
    ours, theirs = [], []
    known = [(moment.grid, moment.cell) for moment in samples(walk)[SAMPLES // 4 :]]
    for grid, (x, y) in known:
        length, spent = timed(partial(costs, grid, x, y))
        ours.append(spent)
        prices = np.where(grid == FREE, 1.0, -1.0)
        theirs.append(timed(lambda: graph.MCP_Geometric(prices).find_costs([(y, x)]))[1])  # noqa: B023
    if not np.allclose(length, without_corners(graph, grid, (x, y)), rtol=0, atol=1e-9):
        raise AssertionError("costs: skimage finds other ways")
    name = "skimage's MCP_Geometric"
    return compare("costs to all cells", "ms", ours, name, theirs, "at most 0.20")


def _looks(plan: Plan, walk: Sequence[Moment]) -> Iterator[Figure]:
    """Tell a walk in looks and read them, against drawing its scans."""
    settings = replace(
        plan.robot_settings[0],
        map_encoding="predictive",
        dissemination="gossip",
        bandwidth=None,
    )
    maker, hearer = PredictiveEncoding(settings), PredictiveEncoding(replace(settings, robot=1))
    drawn, ray_table = np.zeros_like(walk[0].grid), beams(plan)
    cells = size = 0
    written, read, scans = [], [], []
    for moment in walk:
        record = partial(maker.encode_changes, moment.grid, moment.scan, moment.change, delivered=True)
        units, spent = timed(record)
        scan = moment.scan
        scans.append(timed(partial(draw, drawn, ray_table, scan.x, scan.y, scan.readings))[1])
        written.append(spent)
        read.append(timed(partial(hearer.apply, 0, b"".join(units), step=1000, sender=0))[1])
        cells += moment.change.cells
        size += sum(map(len, units))
    _check_same(hearer.merge(np.zeros_like(drawn)), walk[-1].grid, "looks")
    yield compare("looks of a step, written", "ms", written, "drawing its scan", scans, "at most 1 ms")
    yield compare("looks of a step, read", "ms", read, "drawing its scan", scans, "at most 0.2 ms")
    for what, times in (("written", written), ("read", read)):
        seconds = sum(times) / 1000
        yield Figure(f"looks, {what}", "cells/s", cells / seconds)
        yield Figure(f"looks, {what}", "bytes/s", size / seconds)


def _session(plan: Plan, units: Sequence[Sequence[list[bytes]]]) -> Figure:
    """The exploration's packets through 8 sessions and the relay, against the relay's part of it."""
    air = Handshakes(plan)
    for step in range(min(map(len, units))):
        for engine, told in zip(air.engines, units, strict=True):
            engine.append(told[step])
        air.play(step + 1)
    name = f"session of {ROBOTS} robots a step"
    return compare(name, "ms", air.in_engines, "the relay's work in it", air.in_relay)
