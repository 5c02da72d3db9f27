"""A ROS 2 robot that offers its map and transforms, but no laser scans: its own SLAM makes its part of the map.

The robot may report only what it can have observed, as teammates check that. So cells of its map count once they have
been within `BodySettings.reach_m` of the robot.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from agent.bodies.ros2 import BodySettings, Ros2Body
from protocol.boxes import NO_BOX, box_of
from protocol.grid import UNKNOWN, Grid, disc
from protocol.map_frame import MapFrame
from protocol.messages import Sense
from protocol.own_map import OwnMapPart, encode_own_map
from protocol.range_scans import TURN, UNIT, Laser

BEAMS = 360
"""Beams of the laser that the robot's SLAM supposedly has: one per degree."""


class MapBody(Ros2Body):
    """A robot without scans; its pose is that of its base, at the newest time at which all transforms are known."""

    silence = "no transforms (tf) arrive any more"

    def __init__(self, grid: MapFrame, settings: BodySettings) -> None:
        super().__init__(grid, settings)
        self.problem = "no map has arrived"
        self._near: Grid = np.zeros((grid.height, grid.width), np.uint8)
        """Cells that have been within reach of the robot, shape (h, w)."""
        self._states: Grid | None = None
        """The robot's map in the team's grid; None if there is a newer one."""
        self._disc = disc(settings.reach_m / grid.resolution)

    @property
    def laser(self) -> Laser | None:
        """A laser that fits the map, known once the map and the robot's pose have arrived."""
        if self._map is None or self._here is None:
            return None
        return Laser(BEAMS, -TURN // 2, TURN - TURN // BEAMS, round(1000 * self._settings.reach_m))

    def add_map(self, message: Any) -> None:
        """Take a message of ``map``; `problem` names what is wrong with a malformed one."""
        before = self._map
        super().add_map(message)
        if self._map is not before:
            self._states = None

    def take_newest(self) -> None:
        """Take the robot's pose at the newest time at which it is known and plausible."""
        root, frame = self._settings.map_frame, self._settings.base_frame
        if root not in self._transforms.ancestors(frame):
            self._note_missing(frame, "the robot's base")
            return
        newest = self._transforms.newest(frame, root)
        if newest is None or (self._pose is not None and newest == self._pose[0]):
            return
        pose = self._transforms.pose(frame, root, newest)
        if pose is not None and self._accept(int(newest), pose, "the robot"):
            self._mark()

    def sense(self, step: int, *, measures: bool = True) -> Sense | None:
        """Return where the robot is, and the part of its map that it can have observed; None without pose or map."""
        self.take_newest()
        if self._here is None or self._map is None:
            return None
        part = self._observed() if measures else b""
        return Sense(step, *self._cell(), b"", b"", "", *self._offsets(), own_map=part)

    def _mark(self) -> None:
        """Mark the cells within reach of the robot."""
        assert self._here is not None
        (column, row), reach = (each // UNIT for each in self._here), len(self._disc) // 2
        left, top = max(0, column - reach), max(0, row - reach)
        near = self._near[top : row + reach + 1, left : column + reach + 1]
        height, width = near.shape
        y, x = top - row + reach, left - column + reach
        near |= self._disc[y : y + height, x : x + width]

    def _observed(self) -> bytes:
        """Return the known cells that have been within reach, as a part of the grid (`protocol.own_map`)."""
        assert self._map is not None
        if self._states is None:
            self._states = self._map.states(self._grid, self._settings.map_pose)
        states = np.where(self._near != 0, self._states, np.uint8(UNKNOWN))
        box = box_of(states != UNKNOWN)
        if box == NO_BOX:
            return b""
        x0, y0, x1, y1 = box
        return encode_own_map(OwnMapPart(box, states[y0:y1, x0:x1]))
