"""The recording of a run: its logs, cut into one stretch per robot, and the map that all of their scans show.

Listeners have no part of a log: their stretch is one scan without a measurement.

There is no true map of the building. In its place is the map that one occupancy estimator makes of all scans of all
robots, in the order of the logs. Its extent is that of the scans.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent.mapping.estimator import Estimator
from agent.mapping.mapper import add_scan
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import Scenario
from protocol.grid import FREE, MAX_SIDE, UNKNOWN, Cell
from protocol.range_scans import MAX_REACH_M, NO_MEASUREMENT, TURN, UNIT, Laser, RangeScan, beam_ends
from worldsim.maps import Map, MapError
from worldsim.recorded import reading
from worldsim.recorded.log import MAX_BACK_S, LogError, RecordedLog
from worldsim.recorded.options import RECORDED, RecordingOptions
from worldsim.recorded.world import Stretch

MARGIN = 2
"""Cells around all cells that scans touch."""


@dataclass(frozen=True, eq=False)
class Recording:
    """All that a recorded run replays."""

    logs: tuple[RecordedLog, ...]
    """The logs, without the scans that `every` leaves out."""
    stretches: tuple[Stretch, ...]
    """One per robot; those of listeners come last."""
    lasers: tuple[Laser, ...]
    """The beams of each robot; listeners have those of the first one."""
    map: Map
    """The map of all scans."""

    @property
    def starts(self) -> list[Cell]:
        """Cell of each robot's first scan."""
        return [(scan.x, scan.y) for scan in (each.scan(0) for each in self.stretches)]

    @property
    def speed_cells(self) -> float:
        """Longest way of a robot between two scans, in cells per step."""
        return max(_fastest(each) for each in self.stretches)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the logs for the user."""
        return tuple(note for log in self.logs for note in log.notes) + tuple(
            f"{log.name}: {log.jump}; if odometry was reset there, or localization failed, maps show walls twice"
            for log in self.logs
            if log.jump
        )


@dataclass(frozen=True, eq=False)
class _Part:
    """The scans of a log that one robot replays, each in its step; other arrays as in `RecordedLog`."""

    laser: Laser
    steps: NDArray[np.int64]
    poses: NDArray[np.float64]
    ranges: NDArray[np.uint16]


def load_recording(scenario: Scenario) -> Recording:
    """Read the logs of a scenario, and cut them into stretches.

    Raises ScenarioError if a log cannot be read, they do not fit together, they have too few scans for the robots, or
    the area is too large for a map.
    """
    options = scenario.recording
    reach_mm = round(1000 * min(scenario.sensor_range, MAX_REACH_M))
    try:
        logs = [reading.read(Path(name), options.every, topic) for name, topic in options.sources]
        robots = scenario.robots - options.listeners if len(logs) == 1 else 1
        parts = [
            part
            for (name, _), log in zip(options.sources, logs, strict=True)
            for part in _cut(name, log, robots, reach_mm, recorded=options.pace == RECORDED)
        ]
        if "steps" not in scenario.model_fields_set:
            _check_steps(options, parts, scenario.steps)
        name = logs[0].name if len(logs) == 1 else f"{logs[0].name}-and-{len(logs) - 1}-more"
        jumps = [f"in {log.name}, {log.jump}" for log in logs if log.jump]
        stretches, world_map = _build(name, parts, options.resolution, jumps)
    except (LogError, MapError) as error:
        raise ScenarioError(str(error)) from None
    listeners = options.listeners
    return Recording(
        tuple(logs),
        stretches + (_silent(stretches[0]),) * listeners,
        tuple(part.laser for part in parts) + (parts[0].laser,) * listeners,
        world_map,
    )


def _check_steps(options: RecordingOptions, parts: Sequence[_Part], most: int) -> None:
    """Raise LogError if a run would end by its default number of steps before all scans are replayed."""
    last = max(int(part.steps[-1]) for part in parts)
    if last <= most:
        return
    if options.pace == RECORDED:
        gap = max(int(np.diff(part.steps, prepend=1).max()) for part in parts)
        raise LogError(
            f"{options.files[0]}: a robot's last scan is {last - 1} s after its first one (longest gap: {gap} s), and "
            f"a run ends after {most} steps: leave out --pace recorded, or set --steps to more than {last}"
        )
    raise LogError(
        f"{options.files[0]}: a robot has {last} scans, and a run ends after {most} steps: replay fewer scans (--every "
        f"{-(-last // most) * options.every}), use more robots, or set --steps to more than {last}"
    )


def _cut(name: str, log: RecordedLog, robots: int, reach_mm: int, *, recorded: bool) -> Iterator[_Part]:
    """Yield equal stretches of a log, one per robot; LogError if it has too few scans, or no times if they count."""
    if log.scans < robots:
        raise LogError(
            f"{name}: {log.scans} scans for {robots} robots; each robot needs one scan at least: "
            f"set --robots to {log.scans} at most" + (", or --every to less" if log.scans > 1 else "")
        )
    laser = Laser(log.angles.beams, log.angles.first, log.angles.span, reach_mm)
    stamps = _times(name, log) if recorded else np.empty(0)
    bounds = [log.scans * number // robots for number in range(robots + 1)]
    for begin, end in pairwise(bounds):
        steps, chosen = np.arange(1, end - begin + 1), np.arange(begin, end)
        if recorded:
            seconds = np.floor(stamps[begin:end] - stamps[begin]).astype(np.int64)
            steps, first = np.unique(seconds + 1, return_index=True)
            chosen = begin + first
        yield _Part(laser, steps.astype(np.int64), log.poses[chosen], log.ranges[chosen])


def _times(name: str, log: RecordedLog) -> NDArray[np.float64]:
    """Return the times of a log's scans, none before that of the scan before it; LogError if it has no such times."""
    remedy = "leave out --pace recorded"
    if not len(log.stamps) or not np.isfinite(log.stamps).all():
        raise LogError(f"{name}: its scans have no times: {remedy}")
    times: NDArray[np.float64] = np.maximum.accumulate(log.stamps)
    back = np.flatnonzero(times - log.stamps > MAX_BACK_S)
    if len(back):
        raise LogError(
            f"{name}: the time jumps back by more than {MAX_BACK_S:g} s at scan {back[0] + 1}: {remedy}"
        )
    if log.scans > 1 and times[0] == times[-1]:
        raise LogError(f"{name}: all scans have the same time: {remedy}")
    return times


def _build(
    name: str, parts: Sequence[_Part], resolution: float, jumps: Sequence[str]
) -> tuple[tuple[Stretch, ...], Map]:
    """Convert all poses to the frame of a grid, and map all scans; `jumps` are those of poses, for errors."""
    poses = np.concatenate([part.poses for part in parts])
    corner = np.floor(poses[:, :2].min(axis=0) / resolution)
    wrong = "".join(f", or leave out wrong poses: {each}" for each in jumps[:1])
    extent = (poses[:, :2].max(axis=0) / resolution - corner).max()
    if not extent < MAX_SIDE:
        raise LogError(
            f"{name}: its poses are up to {extent * resolution:.0f} m apart, more than {MAX_SIDE} cells of "
            f"{resolution:g} m: use larger cells (--resolution){wrong}"
        )
    left, bottom = (int(value) for value in corner)
    scans = [_scans(part, (left, bottom), resolution) for part in parts]
    shift_x, shift_y, width, height = _bounds(parts, scans, resolution)
    if max(width, height) > MAX_SIDE:
        raise LogError(
            f"{name}: its scans cover {width} x {height} cells, and the maximum is {MAX_SIDE} x {MAX_SIDE}: "
            f"use larger cells (--resolution){wrong}"
        )
    scans = [[_moved(each, -shift_x * UNIT, -shift_y * UNIT) for each in some] for some in scans]
    bottom -= shift_y + height
    origin = (left + shift_x) * resolution, bottom * resolution, 0.0
    everything = Estimator(height, width)
    found = [_map(some, part.laser, resolution, everything) for part, some in zip(parts, scans, strict=True)]
    world_map = Map(name, everything.states.copy(), resolution, origin)
    free = (world_map.cells == FREE).reshape(-1)
    stretches = tuple(
        Stretch(
            part.steps,
            np.array([each.place for each in some], np.int32),
            np.array([each.heading for each in some], np.int64),
            part.ranges,
            [cells[free[cells]] for cells in new],
        )
        for part, some, new in zip(parts, scans, found, strict=True)
    )
    return stretches, world_map


def _scans(part: _Part, corner: tuple[int, int], resolution: float) -> list[RangeScan]:
    """Return scans in a frame with y down, whose origin is the lower left corner of cell `corner`."""
    left, bottom = corner
    x = np.floor((part.poses[:, 0] / resolution - left) * UNIT).astype(np.int64)
    y = np.floor((bottom - part.poses[:, 1] / resolution) * UNIT).astype(np.int64)
    headings = np.rint(-part.poses[:, 2] / (2 * np.pi) * TURN).astype(np.int64) % TURN
    rows = zip(x.tolist(), y.tolist(), headings.tolist(), part.ranges, strict=True)
    return [RangeScan((column, row), heading, ranges) for column, row, heading, ranges in rows]


def _bounds(
    parts: Sequence[_Part], scans: Sequence[Sequence[RangeScan]], resolution: float
) -> tuple[int, int, int, int]:
    """Return column and row of the corner, width, and height of the area that scans touch, in cells; y down."""
    low, high = np.full(2, np.iinfo(np.int64).max), np.full(2, np.iinfo(np.int64).min)
    for laser, scan in ((part.laser, scan) for part, some in zip(parts, scans, strict=True) for scan in some):
        ends, _ = beam_ends(scan, laser, resolution)
        points = np.concatenate([np.array([scan.place], np.int64), ends])
        low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    first = low // UNIT - MARGIN
    width, height = high // UNIT + MARGIN + 1 - first
    return int(first[0]), int(first[1]), int(width), int(height)


def _moved(scan: RangeScan, x: int, y: int) -> RangeScan:
    return RangeScan((scan.place[0] + x, scan.place[1] + y), scan.heading, scan.ranges)


def _map(
    scans: Sequence[RangeScan], laser: Laser, resolution: float, everything: Estimator
) -> list[NDArray[np.int32]]:
    """Add a robot's scans to the map of all scans; return the cells that it knows from each scan on.

    They are indices of the flat grid.
    """
    own = Estimator(*everything.states.shape)
    width = own.states.shape[1]
    known = np.zeros(own.states.shape, np.bool_)
    found = []
    for scan in scans:
        add_scan(everything, scan, laser, resolution)
        change = add_scan(own, scan, laser, resolution)
        x0, y0, x1, y1 = change.box
        here = (own.states[y0:y1, x0:x1] != UNKNOWN) & ~known[y0:y1, x0:x1]
        rows, columns = np.nonzero(here)
        known[y0:y1, x0:x1] |= here
        found.append(((rows + y0) * width + columns + x0).astype(np.int32))
    return found


def _silent(stretch: Stretch) -> Stretch:
    """Return the stretch of a listener, which stays where another one begins, and measures nothing."""
    ranges = np.full_like(stretch.ranges[:1], NO_MEASUREMENT)
    return Stretch(
        np.ones(1, np.int64), stretch.places[:1], stretch.headings[:1], ranges, [np.empty(0, np.int32)]
    )


def _fastest(stretch: Stretch) -> float:
    """Return the longest way between two scans, in cells per step."""
    if len(stretch.steps) < 2:
        return 0.0
    ways = np.hypot(*np.diff(stretch.places.astype(np.float64), axis=0).T) / UNIT
    return float((ways / np.diff(stretch.steps)).max())
