"""Benchmark of mapping with a real laser: adding scans to the occupancy estimator, and bounding the copy of its map.

A robot with a laser of 1081 beams replays the path of an exploration, and once more with every sixth beam.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from agent.mapping.bound import Bound, tiles_of
from agent.mapping.estimator import SETTLED, Estimator
from deploy.bench.explorations import Moment, beams
from deploy.bench.measurement import Measurement, compare, timed
from deploy.scenario.plan import Plan
from protocol.keyed_random import keyed_random
from protocol.range_scans import TURN, UNIT, Laser, RangeScan, beam_ends, smoothed
from protocol.scans import GridChange, draw
from worldsim.range_laser import RangeLaser
from worldsim.sensor_options import LaserOptions

BEAMS, FIELD = 1081, TURN * 3 // 4
"""Beams and field of view of the laser, as a Hokuyo UTM-30LX."""

THINNED = 6
"""Every how many-th beam remains in the second replay."""

LASER = LaserOptions(
    range_error_m=0.03, short=0.002, missing=0.005, mixed=0.1, min_range_m=0.1, max_range_m=30.0
)


def estimation(plan: Plan, moments: Sequence[Moment]) -> Iterator[Measurement]:
    """Measure the estimator and the bound of a tolerance of one cell, with both numbers of beams."""
    reach_mm = round(1000 * plan.scenario.sensor_range)
    laser = Laser(BEAMS, -FIELD // 2, FIELD, reach_mm)
    scans = _scans(plan, moments, laser)
    yield from _replay(plan, moments, laser, scans)
    ranges = [scan.ranges[::THINNED].copy() for scan in scans]
    thinned = Laser(len(ranges[0]), laser.first, laser.span, reach_mm)
    fewer = [RangeScan(scan.place, scan.heading, each) for scan, each in zip(scans, ranges, strict=True)]
    yield from _replay(plan, moments, thinned, fewer)


def _scans(plan: Plan, moments: Sequence[Moment], laser: Laser) -> list[RangeScan]:
    """Measure from the middle of the robot's cells; the heading is that of the last move."""
    truth, scanner = plan.map.cells, RangeLaser(LASER, laser, plan.map.resolution)
    no_robot, random = np.zeros(truth.shape, np.bool_), keyed_random(0, "laser")
    scans, heading, before = [], 0, moments[0].cell
    for moment in moments:
        (x, y), (last_x, last_y) = moment.cell, before
        if moment.cell != before:
            heading = round(np.arctan2(y - last_y, x - last_x) / (2 * np.pi) * TURN) % TURN
        before = moment.cell
        ranges = scanner.ranges(truth, no_robot, (x + 0.5, y + 0.5), heading, random)
        scans.append(RangeScan((x * UNIT + UNIT // 2, y * UNIT + UNIT // 2), heading, ranges))
    return scans


def _replay(
    plan: Plan, moments: Sequence[Moment], laser: Laser, scans: Sequence[RangeScan]
) -> Iterator[Measurement]:
    """Add all scans, and bound the copy after each one where the scan has changed the map.

    Baselines: drawing the exact scan from the same place, and bounding the copy of the whole map.
    """
    shape, resolution = plan.map.cells.shape, plan.map.resolution
    rays, drawn = beams(plan), np.zeros(shape, np.uint8)
    estimator, bound = Estimator(*shape), Bound(1, SETTLED)
    held, target = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    all_tiles, changed = np.ones(tiles_of(*shape), np.uint8), np.zeros(tiles_of(*shape), np.uint8)

    def add(scan: RangeScan) -> GridChange:
        change = estimator.add(*scan.place, *beam_ends(smoothed(scan, laser), laser, resolution))
        return change.joined(estimator.stand(scan.x, scan.y))

    estimated, exact, bounded, on_all = [], [], [], []
    for moment, scan in zip(moments, scans, strict=True):
        change, spent = timed(partial(add, scan))
        estimated.append(spent)
        exact.append(timed(partial(draw, drawn, rays, scan.x, scan.y, moment.scan.readings))[1])
        tiles = np.zeros_like(all_tiles)
        tiles[bound.tiles_near(change.box)] = 1
        maps = estimator.states, estimator.log_odds, held
        bounded.append(timed(partial(bound.apply, *maps, tiles, target, changed))[1])
        on_all.append(timed(partial(bound.apply, *maps, all_tiles, target, changed))[1])
        held[:] = target
    scan_of = f"a scan of {laser.beams} beams"
    yield compare(f"estimating {scan_of}", "ms", estimated, "drawing an exact scan", exact)
    yield compare(f"bound after {scan_of}", "ms", bounded, "bound on the whole map", on_all)
