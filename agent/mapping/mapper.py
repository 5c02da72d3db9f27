"""A robot's own grid, updated by the sensor readings of each step.

Exact readings are drawn on the grid. Scans of real lasers update an occupancy estimate. A map that the robot's own SLAM
makes is copied.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np

from agent.mapping.estimator import LEAST, MOST, SETTLED, Estimator, Int8Grid
from agent.settings import Settings
from protocol.boxes import NO_BOX, Box
from protocol.cell_bytes import cells_from_bytes
from protocol.grid import FREE, HEADINGS, OCCUPIED, UNKNOWN, Cell, Grid, Mask, check_cell, ray_table
from protocol.messages import Sense
from protocol.own_map import OwnMapPart, decode_own_map
from protocol.range_scans import (
    NO_MEASUREMENT,
    TURN,
    UNIT,
    Laser,
    RangeScan,
    beam_ends,
    decode_range_scan,
    directions_between,
    smoothed,
)
from protocol.scans import GridChange, Scan, check_readings, draw

WALL = "wall"
"""Why a move stopped short (`Sense.blocked`), if the robot bumped into something."""

UNCHANGED = GridChange(0, NO_BOX)

NEAR_M = 1.0
"""Distance in meters up to which beams of a scan cross every open cell in sight."""


class Mapper(ABC):
    """Builds the self-explored grid from one scan per step."""

    states: Grid
    """The self-explored grid."""
    log_odds: Int8Grid
    """How certain each cell is, shape (h, w); without noise, positive for known cells."""
    known_cells = 0
    """Number of cells that are known."""

    @abstractmethod
    def add(self, sense: Sense) -> tuple[Scan | RangeScan, GridChange]:
        """Add the scan of a step; return it, and the cells whose state or certainty has changed.

        ProtocolError if the readings do not fit the robot's laser; nothing has changed then.
        """

    def settled(self) -> Mask:
        """Return the cells of whose state the robot is certain, shape (h, w): with exact readings, all known ones."""
        known: Mask = self.states != UNKNOWN
        return known


class ExactMapper(Mapper):
    """Draws exact readings: the first scan of a cell decides its state."""

    def __init__(self, settings: Settings) -> None:
        self.states = np.full((settings.height, settings.width), UNKNOWN, np.uint8)
        self.log_odds = self.states.view(np.int8)
        self._ray_table = ray_table(settings.body.range_cells, settings.beams)

    def add(self, sense: Sense) -> tuple[Scan, GridChange]:
        """Draw the readings."""
        readings = np.frombuffer(sense.readings, np.uint16).copy()
        check_readings(readings, self._ray_table)
        driven = cells_from_bytes(sense.driven)
        change = draw(self.states, self._ray_table, sense.x, sense.y, readings, driven)
        self.known_cells += change.cells
        return Scan(sense.x, sense.y, readings), change


class EstimatingMapper(Mapper):
    """Estimates the occupancy of cells from ranges that may be wrong."""

    def __init__(self, settings: Settings, laser: Laser) -> None:
        self._estimator = Estimator(settings.height, settings.width)
        self.states, self.log_odds = self._estimator.states, self._estimator.log_odds
        self._laser, self._resolution, self._radius = laser, settings.resolution, settings.body.radius_cells

    def add(self, sense: Sense) -> tuple[RangeScan, GridChange]:
        """Add the scan of a real laser."""
        scan = decode_range_scan(sense.range_scan, self._laser)
        check_cell("range scan", scan.x, scan.y, self.states)
        change = add_scan(self._estimator, scan, self._laser, self._resolution)
        if sense.blocked == WALL:
            change = change.joined(self._estimator.strike(*cell_ahead(sense, self._radius)))
        self.known_cells = self._estimator.known_cells
        return scan, change

    def settled(self) -> Mask:
        """Return the cells whose log odds are far from 0."""
        return np.abs(self._estimator.log_odds) >= SETTLED


class GivenMapper(Mapper):
    """Takes the map that the robot's own SLAM makes; a cell that it does not know any more keeps its state."""

    def __init__(self, settings: Settings) -> None:
        self.states = np.full((settings.height, settings.width), UNKNOWN, np.uint8)
        self.log_odds = np.zeros((settings.height, settings.width), np.int8)

    def add(self, sense: Sense) -> tuple[RangeScan, GridChange]:
        """Take the part of the map that the robot has sent, if any; the robot's own cell is free."""
        check_cell("map part", sense.x, sense.y, self.states)
        here = OwnMapPart((sense.x, sense.y, sense.x + 1, sense.y + 1), np.full((1, 1), FREE, np.uint8))
        change = UNCHANGED
        if sense.own_map:
            change = self._apply(decode_own_map(sense.own_map, *self.states.shape), except_for=here.box)
        place = round((sense.x + 0.5) * UNIT), round((sense.y + 0.5) * UNIT)
        scan = RangeScan(place, sense.heading * TURN // HEADINGS, np.empty(0, np.uint16))
        return scan, change.joined(self._apply(here))

    def _apply(self, part: OwnMapPart, except_for: Box | None = None) -> GridChange:
        """Take the known cells of a part, but those in a box; return which of them have changed."""
        x0, y0, x1, y1 = part.box
        states, log_odds = self.states[y0:y1, x0:x1], self.log_odds[y0:y1, x0:x1]
        changed = (part.states != UNKNOWN) & (part.states != states)
        if except_for is not None:
            left, top, right, bottom = except_for
            changed[max(0, top - y0) : max(0, bottom - y0), max(0, left - x0) : max(0, right - x0)] = False
        rows, columns = np.nonzero(changed)
        if not len(rows):
            return UNCHANGED
        self.known_cells += int(np.count_nonzero(states[rows, columns] == UNKNOWN))
        states[rows, columns] = part.states[rows, columns]
        log_odds[rows, columns] = np.where(states[rows, columns] == OCCUPIED, MOST, LEAST)
        box = x0 + columns.min(), y0 + rows.min(), x0 + columns.max() + 1, y0 + rows.max() + 1
        return GridChange(len(rows), (int(box[0]), int(box[1]), int(box[2]), int(box[3])))


def add_scan(estimator: Estimator, scan: RangeScan, laser: Laser, resolution: float) -> GridChange:
    """Add a scan to a map, with medians of its ranges; the robot's own cell is free.

    If most beams have a measurement, unknown cells nearby that no beam has entered may become walls
    (`Estimator.close`).
    """
    change = estimator.add(*scan.place, *beam_ends(smoothed(scan, laser), laser, resolution))
    change = change.joined(estimator.stand(scan.x, scan.y))
    if 2 * np.count_nonzero(scan.ranges != NO_MEASUREMENT) < len(scan.ranges):
        return change
    near = _near_cells(laser, resolution)
    return change.joined(estimator.close(scan.x, scan.y, near, *directions_between(scan, laser)))


def _near_cells(laser: Laser, resolution: float) -> int:
    """Return the distance in cells, along rows and columns, up to which beams cross every open cell; `NEAR_M` at most.

    Up to there, beams are at most half a cell apart, and reach the corners of the square around the robot.
    """
    if laser.beams < 2:
        return 0
    to_corner = laser.reach_mm / 1000 / resolution
    return max(0, int(min(NEAR_M / resolution, 0.5 / laser.spacing_rad, to_corner / math.sqrt(2) - 1)))


def cell_ahead(sense: Sense, radius_cells: float) -> Cell:
    """Return the cell that a robot of this radius touches in the direction in which it drove."""
    angle, reach = sense.heading * math.pi / 4, radius_cells + 1
    return sense.x + round(reach * math.cos(angle)), sense.y + round(reach * math.sin(angle))


def make_mapper(settings: Settings) -> Mapper:
    """Make the mapper that fits the robot's sensors."""
    if settings.has_own_map:
        return GivenMapper(settings)
    return ExactMapper(settings) if settings.laser is None else EstimatingMapper(settings, settings.laser)
