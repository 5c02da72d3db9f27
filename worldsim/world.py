"""The physical world: the robots' true positions and scans. It owns the clock."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import BoolRows, Bools
from protocol.body import Body, narrowest_opening
from protocol.cell_bytes import cells_from_bytes, cells_to_bytes, points_from_bytes
from protocol.grid import FINE, FREE, HEADINGS, Cell, Grid, Mask, RayTable, cell_of, disc, enlarge, ray_table
from protocol.kernels import kernel
from protocol.keyed_random import keyed_random
from protocol.messages import FaultEvent, Move, Sense
from protocol.scans import NONE, draw
from worldsim import motion
from worldsim.base import BaseWorld
from worldsim.laser import FULL_TURN, cast
from worldsim.people import People, PeopleSettings, RobotDisc
from worldsim.range_laser import NO_DISCS
from worldsim.regions import nearest_cell, part_with, wide_part
from worldsim.sensors import Sensors, SensorSettings

MOVES_AS_PLANNED = 0.7
"""Probability that a robot close to another moves as planned (Burgard et al., section IV)."""


@dataclass(frozen=True)
class WorldSettings:
    """Settings of the world."""

    bodies: tuple[Body, ...]
    """One per robot."""
    starts: tuple[Cell, ...]
    """Cell (x, y) where each robot starts."""
    beams: int = 360
    """Laser beams per full turn."""
    seed: int = 0
    interference_cells: float = 0.0
    """Robots closer to each other than this hinder each other; 0: never."""
    faults: tuple[FaultEvent, ...] = ()
    """Scheduled faults, from the scenario; not those of radios."""
    ends_with_all: bool = False
    """Whether the run ends when all robots report in one step that they are done, instead of the first."""
    cell_steps: bool = False
    """Whether a step to any of eight neighbors has length 1; else a diagonal step has length sqrt 2."""
    robots_collide: bool = True
    """Whether robots block each other's paths and laser beams."""
    min_coverage: float = 0.0
    """Share of the cells that a robot can reach which the team must have seen when it reports `explored`."""
    sensors: SensorSettings | None = None
    """Sensors with errors; None: lasers and poses are exact."""
    people: PeopleSettings | None = None
    """People in the building; only sensors with errors see them."""
    step_ns: int | None = None
    """Duration of a step by the wall clock, in nanoseconds; None: steps wait for all robots."""


class World(BaseWorld):
    """The world of one run; cells of `truth` (uint8, shape (h, w)) that are not free are solid."""

    def __init__(self, truth: Grid, settings: WorldSettings) -> None:
        super().__init__(truth, settings)
        self.floors = {body.radius_cells: enlarge(truth, body.radius_cells) for body in settings.bodies}
        """For each radius in cells: the grid of cells that a robot's center may enter."""
        self.reachable = reachable_by_team(truth, settings)
        self.seen = np.zeros_like(truth)
        """Grid of all cells seen by the team's lasers."""
        self._counted = np.zeros(truth.shape, np.bool_)
        self._taken = np.zeros(truth.shape, np.uint8)
        self._reachable_by: dict[int, Mask] = {}
        """The free cells that a robot can reach, by robots whose reports were checked."""
        self._widest = max(self.floors, default=0.0)
        self._carry = [0.0] * len(settings.starts)
        self._scanner_angle = [0.0] * len(settings.starts)
        self._sensors = None if settings.sensors is None else Sensors(settings.sensors, settings.seed)
        self._people = None
        if settings.people is not None:
            self._people = People(truth, self.reachable, self._discs(), settings.people, settings.seed)

    @property
    def people(self) -> list[Cell]:
        """The cell of each person in the building."""
        return [] if self._people is None else self._people.cells

    @cached_property
    def _ray_tables(self) -> list[RayTable]:
        """The cells of each robot's beams."""
        return [ray_table(body.range_cells, self.settings.beams) for body in self.settings.bodies]

    def restore(self, robot: int) -> None:
        """Put a removed robot back where it was, or into the nearest free cell if that one is taken."""
        if robot in self.cells:
            return
        last = self.cells[robot] = self._last_cells[robot]
        floor = self.floors[self.settings.bodies[robot].radius_cells] == FREE
        marked = self._mark_others(robot, math.inf)
        self.cells[robot] = nearest_cell(floor & self.reachable & (self._taken == 0), last) or last
        motion.clear(marked)
        self.offsets[robot] = 0, 0
        self._carry[robot] = 0.0

    def share_seen(self, robot: int) -> float:
        """Return the share of the cells that a robot can reach which the team's lasers have seen."""
        if robot not in self._reachable_by:
            body, start = self.settings.bodies[robot], self.settings.starts[robot]
            self._reachable_by[robot] = _reachable_by_body(self.truth, start, body, self.settings)
        seen = self.seen[self._reachable_by[robot]] == FREE
        return float(seen.mean())

    def move_robots(self, moves: Mapping[int, Move]) -> Iterator[tuple[int, Sense]]:
        """Begin the next step: move the robots, and return an iterator that casts one scan at a time."""
        self.step += 1
        entered: dict[int, list[Cell]] = {}
        blocked: dict[int, str] = {}
        before = dict(self.cells)
        for robot in self.active_robots():
            entered[robot], blocked[robot] = [], motion.NOT_BLOCKED
            move = moves.get(robot)
            if move is not None:
                entered[robot], blocked[robot] = self._move(robot, move, before)
        if self._people is not None:
            self._people.advance(self.step, self._discs())
        occupied = np.zeros(self.truth.shape, np.bool_)
        for x, y in self.cells.values() if self.settings.robots_collide else ():
            occupied[y, x] = True
        looking = {
            robot: scans_in(self.step, self.settings.bodies[robot].scan_rate)
            and (robot not in moves or moves[robot].look)
            for robot in entered
        }
        return (
            (robot, self._sense(robot, *self.cells[robot], occupied, entered[robot], blocked[robot], look))
            for robot, look in looking.items()
        )

    def _move(self, robot: int, move: Move, before: Mapping[int, Cell]) -> tuple[list[Cell], str]:
        """Move one robot; return the cells found free on its path, and what blocked it."""
        path = [(x, y) for x, y in cells_from_bytes(move.path).tolist()]
        points = [(x, y) for x, y in points_from_bytes(move.points).tolist()] if move.points else []
        if self._sensors is not None and not self._sensors.has_exact_pose(robot):
            points = self._sensors.true_points(robot, self.step - 1, path, points)
        self.headings[robot] = move.heading % HEADINGS
        if (path or points) and self._hindered(robot, before):
            return [], motion.INTERFERENCE
        body, start, offset = self.settings.bodies[robot], self.cells[robot], self.offsets[robot]
        floor, way = self.floors[body.radius_cells], body.speed + self._carry[robot]
        marked = self._mark_others(robot, way, [cell_of(point) for point in points] or path)
        if points:
            point = start[0] * FINE + offset[0], start[1] * FINE + offset[1]
            result = motion.glide(floor, self._taken, point, points, way)
        else:
            diagonal = 1.0 if self.settings.cell_steps else motion.DIAGONAL
            result = motion.drive(floor, self._taken, start, path, way, diagonal)
        motion.clear(marked)
        self._carry[robot] = result.carry
        self.driven[robot] += result.length
        if result.length:
            x, y = self.cells[robot] = cell_of(result.point)
            self.offsets[robot] = result.point[0] - x * FINE, result.point[1] - y * FINE
        # Robots with real sensors face the wall that stops them, and mark it. Others see it once they turn toward it.
        faces_wall = self._sensors is not None and result.bump != (0, 0)
        direction = result.bump if faces_wall else result.direction
        if direction != (0, 0):
            self.headings[robot] = motion.heading_of(*direction)
        return motion.swept(start, result.cells), result.blocked

    def _mark_others(
        self, robot: int, way: float, path: Sequence[Cell] | None = None
    ) -> list[NDArray[np.uint8]]:
        """Mark the cells that a robot's center may not enter because of other robots, or of people.

        Robots count that are within `way` cells, and near the box around `path` if that is given: the cells of the
        robot's path or of its corners. Returns the parts of `_taken` with marks, which the caller clears.
        """
        own = self.settings.bodies[robot].radius_cells
        (x, y), berth = self.cells[robot], own + self._widest + 4
        left, right, top, bottom = x - way, x + way, y - way, y + way
        if path is not None:
            columns, rows = zip((x, y), *path, strict=True)
            left, right = max(left, min(columns)), min(right, max(columns))
            top, bottom = max(top, min(rows)), min(bottom, max(rows))
        left, right, top, bottom = left - berth, right + berth, top - berth, bottom + berth
        others = [
            (other, cell)
            for other, cell in self.cells.items()
            if left <= cell[0] <= right and top <= cell[1] <= bottom and other != robot
        ]
        marked = []
        for other, cell in others if self.settings.robots_collide else ():
            reach = own + self.settings.bodies[other].radius_cells
            marked.append(motion.mark_near(self._taken, cell, reach, motion.TAKEN_BY_ROBOT))
        if self._people is not None:
            marked += self._people.mark(self._taken, own)
        return marked

    def _discs(self) -> list[RobotDisc]:
        return [(cell, self.settings.bodies[robot].radius_cells) for robot, cell in self.cells.items()]

    def _hindered(self, robot: int, before: Mapping[int, Cell]) -> bool:
        limit = self.settings.interference_cells
        if not limit:
            return False
        x, y = before[robot]
        near = any(
            other != robot and (x - ox) ** 2 + (y - oy) ** 2 < limit * limit
            for other, (ox, oy) in before.items()
        )
        if not near:
            return False
        draw_of = keyed_random(self.settings.seed, "interference", robot, self.step)
        return bool(draw_of.random() >= MOVES_AS_PLANNED)

    def _sense(
        self, robot: int, x: int, y: int, occupied: Mask, entered: list[Cell], blocked: str, look: bool
    ) -> Sense:
        body = self.settings.bodies[robot]
        heading = self.headings[robot]
        readings = cast(self.truth, occupied, self._ray_tables[robot], x, y, heading, body.field_of_view)
        angle = self._scanner_angle[robot]
        if not look:
            readings[:] = NONE
        elif body.scanner_turn:
            readings[beams_outside(len(readings), angle, body.scanner_turn)] = NONE
            self._scanner_angle[robot] = (angle + body.scanner_turn) % FULL_TURN
        driven_over = np.array(entered, np.int32).reshape(-1, 2)
        news = draw(self.seen, self._ray_tables[robot], x, y, readings, driven_over)
        if news.cells:
            self.seen_cells += int(_count_seen(self.seen, self.reachable, *news.box, self._counted))
        offset_x, offset_y = self.offsets[robot]
        driven = cells_to_bytes(driven_over)
        exact = Sense(self.step, x, y, heading, driven, readings.tobytes(), blocked, offset_x, offset_y)
        if self._sensors is None:
            return exact
        beams = self._sensors.beam_degrees(robot) + heading * FULL_TURN / HEADINGS
        active = np.full(len(beams), look)
        if body.scanner_turn:
            active &= (beams - angle) % FULL_TURN < body.scanner_turn
        discs = NO_DISCS if self._people is None else self._people.discs
        return self._sensors.sense(robot, exact, self.truth, occupied, active, discs)


@kernel
def _count_seen(
    seen: Grid, reachable: BoolRows, x0: int, y0: int, x1: int, y1: int, counted: BoolRows
) -> int:
    """Count the reachable free cells of a box that have been seen, once each."""
    fresh = 0
    for y in range(y0, y1):
        for x in range(x0, x1):
            if seen[y, x] == FREE and reachable[y, x] and not counted[y, x]:
                counted[y, x] = True
                fresh += 1
    return fresh


def scans_in(step: int, rate: float) -> bool:
    """Return whether lasers that scan `rate` times per step, at most once, scan in a step; they do in step 1."""
    return math.floor((step - 1) * rate) > math.floor((step - 2) * rate)


def beams_outside(beams: int, angle: float, width: float) -> Bools:
    """Return which beams a turning scanner does not send while it turns by `width` degrees from `angle`."""
    degrees = np.arange(beams) * (FULL_TURN / beams)
    return (degrees - angle) % FULL_TURN >= min(width, FULL_TURN)


def reachable_by_team(truth: Grid, settings: WorldSettings) -> Mask:
    """Return the free cells that at least one robot explores: those that it can reach with its disc.

    Robots with real sensors do not explore narrow openings, so cells behind them, or in them, do not count.
    """
    found: Mask = np.zeros(truth.shape, np.bool_)
    done: set[float] = set()
    for start, body in zip(settings.starts, settings.bodies, strict=True):
        x, y = start
        if body.radius_cells not in done or not found[y, x]:
            found |= _reachable_by_body(truth, start, body, settings)
            done.add(body.radius_cells)
    return found


def _reachable_by_body(truth: Grid, start: Cell, body: Body, settings: WorldSettings) -> Mask:
    """Return the free cells that a robot with this body explores from `start`."""
    found = reachable_by(truth, start, body.radius_cells)
    if settings.sensors is None:
        return found
    return wide_part(found, start, narrowest_opening(body.radius_cells, settings.sensors.resolution))


def reachable_by(truth: Grid, start: Cell, radius_cells: float) -> Mask:
    """Return the free cells that a disc starting at `start` can reach with its center, or cover from there."""
    from scipy import ndimage  # noqa: PLC0415  slow to import, and few commands need it

    floor = enlarge(truth, radius_cells)
    found = part_with(floor == FREE, start)
    if floor is truth:
        return found
    covered: Mask = ndimage.binary_dilation(found, disc(radius_cells))
    covered &= truth == FREE
    return covered
