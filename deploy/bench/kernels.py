"""Benchmark of a robot's computations per step: processor time on one core, each compared with a baseline.

The input is one exploration by 8 robots at 1 kB a step, on a generated office of 300 x 300 cells. If the environment
variable MURMUR_MAPS names a folder with the map ``intel``, the benchmark uses that map. Where a baseline computes the
same result, the benchmark compares both and stops at a difference.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace

from agent.encodings.polygons import PolygonEncoding
from agent.encodings.predictive import PredictiveEncoding
from agent.outline.approximation import approximation, repair
from agent.outline.claims import Drawing
from agent.outline.contour import contours
from agent.outline.edits import NumberedPolygons, edit_packets
from agent.outline.five_stages import five_stages
from agent.outline.merge import TeamMap
from agent.outline.objects import Objects
from agent.outline.polygons import Polygons
from agent.outline.simplify import refine
from agent.planning.cost_field import costs
from agent.planning.frontier import Floor
from deploy.bench import baselines
from deploy.bench.explorations import SAMPLES, Moment, beams, explore, samples
from deploy.bench.measurement import Measurement, compare, timed
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from protocol.grid import FREE, Grid
from protocol.scans import draw
from worldsim import generators, maps
from worldsim.laser import cast
from worldsim.maps import Map

ROBOTS = 8
BUDGET = 1000
SIDE_M = 30.0


def kernels() -> Iterator[Measurement]:
    """Measure each part of a robot's step, in the order of execution."""
    cv2 = baselines.optional_module("cv2", "opencv-python-headless")
    graph = baselines.optional_module("skimage.graph", "scikit-image")
    cv2.setNumThreads(1)
    plan = plans.make(
        Scenario(robots=ROBOTS, map_encoding="polygons", strategy="meier", bandwidth=BUDGET, bus="memory"),
        _map(),
    )
    explorations = explore(plan)
    yield _scanning(plan, explorations[0])
    yield _contours(explorations, cv2)
    updates = _PolygonUpdates(plan)
    for robot, moments in enumerate(explorations):
        updates.encode(robot, moments)
    yield updates.measurement()
    yield from _merging(explorations[0], updates.polygons)
    yield _cost_field(explorations[0], graph)
    yield from _predictive(plan, explorations[0])


def _map() -> Map:
    folder = os.environ.get("MURMUR_MAPS")
    file = Path(folder or ".") / "intel.yaml"
    if folder and file.is_file():
        return maps.load(file)
    return generators.make("office", width_m=SIDE_M, height_m=SIDE_M)


def _check_same(result: Grid, baseline: Grid, what: str) -> None:
    if not np.array_equal(result, baseline):
        raise AssertionError(f"{what}: the baseline has a different result")


def _scanning(plan: Plan, moments: Sequence[Moment]) -> Measurement:
    """Cast a scan on the true map and draw it; baseline: the same beams in numpy."""
    truth, rays = plan.map.cells, beams(plan)
    no_teammates = np.zeros(truth.shape, np.bool_)
    kernel: list[float] = []
    baseline: list[float] = []

    def scan(known: Grid, x: int, y: int) -> None:
        draw(known, rays, x, y, cast(truth, no_teammates, rays, x, y))

    for moment in samples(moments):
        known, other = np.zeros_like(truth), np.zeros_like(truth)
        kernel.append(timed(partial(scan, known, *moment.cell))[1])
        baseline.append(timed(partial(baselines.scan_in_numpy, truth, rays, moment.cell, other))[1])
        _check_same(known, other, "scan")
    return compare("scan, cast and drawn", "ms", kernel, "the same beams in numpy", baseline)


def _contours(explorations: Sequence[Sequence[Moment]], cv2: Any) -> Measurement:
    """Trace exact contours; baseline: OpenCV on the same cells.

    OpenCV returns the cells along each contour. Our contour points also have the side of the cell, and whether the cell
    is occupied. OpenCV finds one more contour: the border of the picture.
    """
    kernel, baseline = [], []
    height, width = explorations[0][0].grid.shape
    solid = np.ones((height + 2, width + 2), np.uint8)
    for moment in (moment for moments in explorations for moment in samples(moments)):
        found, spent = timed(partial(contours, moment.grid, moment.cell))
        kernel.append(spent)
        traced, spent = timed(partial(baselines.trace_by_opencv, cv2, moment.grid, solid))
        baseline.append(spent)
        if len(kernel) % SAMPLES == 0 and baselines.cells_along(found) != baselines.without_frame(traced):
            raise AssertionError("contours: OpenCV finds different contours")
    return compare("contours of a robot's map", "ms", kernel, "OpenCV's findContours", baseline, "no slower")


class _PolygonUpdates:
    """The polygon updates of robots step by step, with their computing time; baseline: encoding from scratch.

    Attributes
    ----------
    polygons : list of list of Polygons
        Per robot and step, the polygons that its teammates hold after the update.
    """

    def __init__(self, plan: Plan) -> None:
        self.polygons: list[list[Polygons]] = []
        self._plan = plan
        self._incremental: list[float] = []
        self._from_scratch: list[float] = []

    def encode(self, robot: int, moments: Sequence[Moment]) -> None:
        """Encode the updates of one robot."""
        encoding = PolygonEncoding(self._plan.robot_settings[robot])
        self.polygons.append([])
        for moment in moments:
            record = partial(encoding.encode_changes, moment.grid, moment.scan, moment.change, delivered=True)
            packets, spent = timed(record)
            polygons = encoding.polygons[robot]
            self.polygons[-1].append(polygons)
            if packets:
                self._incremental.append(spent)
                self._from_scratch.append(timed(partial(_encode_whole_map, moment, len(polygons.x)))[1])

    def measurement(self) -> Measurement:
        """Compare all computations before the radio."""
        return compare(
            "contours, repair, refinement and edits",
            "ms",
            self._incremental,
            "encoding the whole map from scratch",
            self._from_scratch,
            "at most 1 ms",
        )


def _encode_whole_map(moment: Moment, vertices: int) -> None:
    """Approximate a map by the given number of vertices, and encode all of them."""
    nothing = NumberedPolygons.empty(moment.grid.shape)
    exact = contours(moment.grid, moment.cell)
    marks = repair(nothing.polygons, exact)
    marks = refine(exact, marks, max(0, vertices - len(marks)), mixed_first=True)
    edit_packets(nothing, approximation(exact, marks))


def _merging(moments: Sequence[Moment], polygons: Sequence[Sequence[Polygons]]) -> Iterator[Measurement]:
    """Merge 7 teammates of whom all, one or none changed; baseline: Algorithm 9 line by line."""
    drawing = Drawing(free_inside_edges=False, unknown_pairs=False, wide_walls=True, close_slivers=True)
    team = TeamMap(drawing)

    def merge(own: Grid, changed: Sequence[Polygons]) -> Grid:
        for robot, outlines in enumerate(changed, 1):
            team.update(robot, Objects.of(outlines))
        return team.merged(own)

    steps = min(map(len, polygons))
    all_changed, one_changed, none_changed, by_lines = [], [], [], []
    for step in np.linspace(steps // 4, steps - 1, SAMPLES).astype(int).tolist():
        own, outlines = moments[step].grid, [of_robot[step] for of_robot in polygons[1:]]
        merged, spent = timed(partial(merge, own, outlines))
        all_changed.append(spent)
        one_changed.append(timed(partial(merge, own, outlines[:1]))[1])
        none_changed.append(timed(partial(merge, own, []))[1])
        stages, spent = timed(partial(five_stages, own, outlines, drawing))
        by_lines.append(spent)
        _check_same(merged, stages.complete, "merging")
    name = f"merging {ROBOTS - 1} teammates"
    yield compare(
        f"{name}, all changed", "ms", all_changed, "Algorithm 9 line by line", by_lines, "at most 2 ms"
    )
    yield compare(f"{name}, one changed", "ms", one_changed, "all changed", all_changed)
    yield compare(f"{name}, none changed", "ms", none_changed, "all changed", all_changed)


def _cost_field(moments: Sequence[Moment], graph: Any) -> Measurement:
    """Compute path costs to all cells; baseline: skimage's shortest paths on the same cells.

    The paths of skimage may cut corners, which is the easier problem. If that is forbidden, by a graph in three
    dimensions, skimage has our result.
    """
    kernel, baseline = [], []
    known = [(moment.grid, moment.cell) for moment in samples(moments)[SAMPLES // 4 :]]
    for grid, (x, y) in known:
        length, spent = timed(lambda: costs(Floor(grid), x, y))  # noqa: B023
        kernel.append(spent)
        prices = np.where(grid == FREE, 1.0, -1.0)
        baseline.append(timed(lambda: graph.MCP_Geometric(prices).find_costs([(y, x)]))[1])  # noqa: B023
    if not np.allclose(length, baselines.costs_by_skimage(graph, grid, (x, y)), rtol=0, atol=1e-9):
        raise AssertionError("costs: skimage finds different paths")
    return compare("costs to all cells", "ms", kernel, "skimage's MCP_Geometric", baseline, "at most 0.20")


def _predictive(plan: Plan, moments: Sequence[Moment]) -> Iterator[Measurement]:
    """Encode and decode scans with the predictive encoding; baseline: drawing the scans."""
    settings = replace(
        plan.robot_settings[0],
        map_encoding="predictive",
        dissemination="gossip",
        bandwidth=None,
    )
    encoder, decoder = PredictiveEncoding(settings), PredictiveEncoding(replace(settings, robot=1))
    drawn, rays = np.zeros_like(moments[0].grid), beams(plan)
    cells = size = 0
    encoded, decoded, scans = [], [], []
    for moment in moments:
        record = partial(encoder.encode_changes, moment.grid, moment.scan, moment.change, delivered=True)
        packets, spent = timed(record)
        scan = moment.scan
        scans.append(timed(partial(draw, drawn, rays, scan.x, scan.y, scan.readings))[1])
        encoded.append(spent)
        decoded.append(timed(partial(decoder.apply, 0, b"".join(packets), step=1000, sender=0))[1])
        cells += moment.change.cells
        size += sum(map(len, packets))
    _check_same(decoder.merge(np.zeros_like(drawn)), moments[-1].grid, "predictive encoding")
    for action, times, target in (("encode", encoded, "at most 1 ms"), ("decode", decoded, "at most 0.2 ms")):
        name = f"predictive, {action} a step"
        yield compare(name, "ms", times, "drawing its scan", scans, target)
        seconds = sum(times) / 1000
        yield Measurement(f"predictive, {action}", "cells/s", cells / seconds)
        yield Measurement(f"predictive, {action}", "bytes/s", size / seconds)
