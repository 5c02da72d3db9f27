"""Benchmark of a robot's computations per step: processor time on one core, each compared with a baseline.

The input is one exploration by 8 robots at 1 kB a step, on a generated office of 300 x 300 cells. If the environment
variable MURMUR_MAPS names a folder with the map ``intel``, the benchmark uses that map.
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
from agent.outline.merge import TeamMap
from agent.outline.objects import Objects
from agent.outline.polygons import Polygons
from agent.outline.simplify import refine
from agent.planning.cost_field import Field, costs
from agent.planning.frontier import Floor
from agent.settings import EncodingSettings, MediumSettings, ReplicationSettings
from deploy.bench import baselines
from deploy.bench.estimation import estimation
from deploy.bench.explorations import SAMPLES, Moment, beams, explore, office, samples
from deploy.bench.five_stages import five_stages
from deploy.bench.measurement import Measurement, compare, timed
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from protocol.grid import Cell, Grid
from protocol.packages import require
from protocol.scans import draw
from worldsim import maps
from worldsim.laser import cast

ROBOTS = 8
BUDGET = 1000


def kernels() -> Iterator[Measurement]:
    """Measure each part of a robot's step, in the order of execution."""
    for package in ("cv2", "skimage"):
        require(package, "bench", "the benchmark needs")
    import cv2  # noqa: PLC0415
    from skimage import graph  # noqa: PLC0415

    cv2.setNumThreads(1)
    scenario = Scenario(
        robots=ROBOTS, map_encoding="polygons", strategy="meier", bandwidth=BUDGET, bus="memory"
    )
    intel = Path(os.environ.get("MURMUR_MAPS", "")) / "intel.yaml"
    plan = plans.make(scenario, maps.load(intel) if intel.is_file() else office())
    explorations = explore(plan)
    yield _scanning(plan, explorations[0])
    yield _contours(explorations, cv2)
    polygons: list[list[Polygons]] = []
    yield _polygon_updates(plan, explorations, polygons)
    yield from _merging(explorations[0], polygons)
    yield _cost_field(explorations[0], graph)
    yield from _predictive(plan, explorations[0])
    yield from estimation(plan, explorations[0])


def _scanning(plan: Plan, moments: Sequence[Moment]) -> Measurement:
    """Cast a scan on the true map and draw it; baseline: the same beams in numpy."""
    truth, rays = plan.map.cells, beams(plan)
    no_teammates = np.zeros(truth.shape, np.bool_)
    kernel, baseline = [], []

    def scan(known: Grid, x: int, y: int) -> None:
        draw(known, rays, x, y, cast(truth, no_teammates, rays, x, y))

    for moment in samples(moments):
        known, other = np.zeros_like(truth), np.zeros_like(truth)
        kernel.append(timed(partial(scan, known, *moment.cell))[1])
        baseline.append(timed(partial(baselines.scan_in_numpy, truth, rays, moment.cell, other))[1])
    return compare("scan, cast and drawn", "ms", kernel, "the same beams in numpy", baseline)


def _contours(explorations: Sequence[Sequence[Moment]], cv2: Any) -> Measurement:
    """Trace exact contours; baseline: OpenCV, which returns only the cells along each contour."""
    kernel, baseline = [], []
    height, width = explorations[0][0].grid.shape
    solid = np.ones((height + 2, width + 2), np.uint8)
    for moment in (moment for moments in explorations for moment in samples(moments)):
        kernel.append(timed(partial(contours, moment.grid, moment.cell))[1])
        baseline.append(timed(partial(baselines.trace_by_opencv, cv2, moment.grid, solid))[1])
    return compare("contours of a robot's map", "ms", kernel, "OpenCV's findContours", baseline)


def _polygon_updates(
    plan: Plan, explorations: Sequence[Sequence[Moment]], polygons: list[list[Polygons]]
) -> Measurement:
    """Encode all computations before the radio; baseline: encoding the whole map from scratch.

    `polygons` receives, per robot and step, the polygons that its teammates hold after the update.
    """
    incremental, from_scratch = [], []
    for robot, moments in enumerate(explorations):
        encoding = PolygonEncoding(plan.robot_settings[robot])
        polygons.append([])
        for moment in moments:
            record = partial(encoding.encode_changes, moment.grid, moment.scan, moment.change, delivered=True)
            packets, spent = timed(record)
            polygons[-1].append(encoding.polygons[robot])
            if packets:
                incremental.append(spent)
                vertices = len(encoding.polygons[robot].x)
                from_scratch.append(timed(partial(_encode_whole_map, moment, vertices))[1])
    return compare(
        "contours, repair, refinement and edits", "ms", incremental, "encoding the whole map", from_scratch
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
        all_changed.append(timed(partial(merge, own, outlines))[1])
        one_changed.append(timed(partial(merge, own, outlines[:1]))[1])
        none_changed.append(timed(partial(merge, own, []))[1])
        by_lines.append(timed(partial(five_stages, own, outlines, drawing))[1])
    name = f"merging {ROBOTS - 1} teammates"
    yield compare(f"{name}, all changed", "ms", all_changed, "Algorithm 9 line by line", by_lines)
    yield compare(f"{name}, one changed", "ms", one_changed, "all changed", all_changed)
    yield compare(f"{name}, none changed", "ms", none_changed, "all changed", all_changed)


def _costs(grid: Grid, cell: Cell) -> Field:
    return costs(Floor(grid), *cell)


def _cost_field(moments: Sequence[Moment], graph: Any) -> Measurement:
    """Compute path costs to all cells; baseline: skimage's paths, which may cut corners, the easier problem."""
    known = [(moment.grid, moment.cell) for moment in samples(moments)[SAMPLES // 4 :]]
    kernel = [timed(partial(_costs, grid, cell))[1] for grid, cell in known]
    baseline = [baselines.skimage_costs_ms(graph, grid, cell) for grid, cell in known]
    return compare("costs to all cells", "ms", kernel, "skimage's MCP_Geometric", baseline)


def _predictive(plan: Plan, moments: Sequence[Moment]) -> Iterator[Measurement]:
    """Encode and decode scans with the predictive encoding; baseline: drawing the scans."""
    settings = replace(
        plan.robot_settings[0],
        encoding=EncodingSettings("predictive"),
        replication=ReplicationSettings("gossip"),
        medium=MediumSettings(),
    )
    encoder, decoder = PredictiveEncoding(settings), PredictiveEncoding(replace(settings, robot=1))
    drawn, rays = np.zeros_like(moments[0].grid), beams(plan)
    encoded, decoded, drawing = [], [], []
    for moment in moments:
        scan = moment.scan
        record = partial(encoder.encode_changes, moment.grid, scan, moment.change, delivered=True)
        packets, spent = timed(record)
        encoded.append(spent)
        decoded.append(timed(partial(decoder.apply, 0, b"".join(packets), step=1000, sender=0))[1])
        drawing.append(timed(partial(draw, drawn, rays, scan.x, scan.y, scan.readings))[1])
    yield compare("predictive, encode a step", "ms", encoded, "drawing its scan", drawing)
    yield compare("predictive, decode a step", "ms", decoded, "drawing its scan", drawing)
