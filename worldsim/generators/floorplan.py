"""Rooms along corridors: the floor plans of all office environments.

Rooms and corridors are carved out of unknown space, with one wall between them; doors are gaps in the walls. A
plan that runs from top to bottom is drawn on the transposed grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from protocol.grid import UNKNOWN, Grid
from worldsim.generators.drawing import carve, wall_thickness


@dataclass(frozen=True)
class Box:
    """Cells from (left, top) to before (right, bottom)."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def width(self) -> int:
        """Cells from left to right."""
        return self.right - self.left

    @property
    def height(self) -> int:
        """Cells from top to bottom."""
        return self.bottom - self.top

    def shrunk(self, by: int) -> Box:
        """Return the box without its outermost cells."""
        return Box(self.left + by, self.top + by, self.right - by, self.bottom - by)


def inside(cells: Grid, wall: int) -> Box:
    """Return the box of all cells inside a wall around the grid."""
    height, width = cells.shape
    return Box(0, 0, width, height).shrunk(wall)


@dataclass(frozen=True)
class Style:
    """Dimensions of an office, in meters."""

    corridor_m: float = 2.0
    """Width of corridors."""
    room_m: tuple[float, float] = (2.8, 5.5)
    """Width of rooms along the corridor; not a limit, but the target for dividing a row."""
    door_m: tuple[float, float] = (0.9, 1.2)
    """Narrowest and widest door."""
    joined: float = 0.12
    """Share of neighboring rooms with a door between them."""
    merged: float = 0.08
    """Share of neighboring rooms without a wall between them."""


class Builder:
    """Carves one floor plan into `cells`, of `resolution` meters."""

    def __init__(self, cells: Grid, random: np.random.Generator, resolution: float, style: Style) -> None:
        self.cells = cells
        self.random = random
        self.resolution = resolution
        self.style = style
        self.wall = wall_thickness(resolution)
        self.corridor = self.cells_in(style.corridor_m)

    def transposed(self) -> Builder:
        """Return the builder of the same world with x and y swapped."""
        return Builder(self.cells.T, self.random, self.resolution, self.style)

    def cells_in(self, meters: float) -> int:
        """Return a length in cells."""
        return round(meters / self.resolution)

    def offices(self, box: Box, corridors: int) -> tuple[list[Box], list[Box]]:
        """Fill the box with parallel corridors, rooms on both sides of each, and cross corridors.

        Returns the parallel corridors, each from the left to the right side, and the rooms row by row, from the top.
        """
        height = box.height - corridors * self.corridor - (3 * corridors - 1) * self.wall
        depths = self.divide(box.top, height, 2 * corridors, 0)
        lanes = []
        rows = []
        shift = 0
        for i, (top, bottom) in enumerate(depths):
            rows.append((top + shift, bottom + shift))
            shift += self.wall
            if i % 2 == 0:
                lanes.append(Box(box.left, bottom + shift, box.right, bottom + shift + self.corridor))
                shift += self.corridor + self.wall
        for lane in lanes:
            carve(self.cells, lane.left, lane.top, lane.right, lane.bottom)
        rooms = self.row(box.left, box.right, *rows[0], door_above=False)
        for i in range(corridors - 1):
            for left, right in self._crossed(box, lanes[i], lanes[i + 1]):
                upper, lower = rows[2 * i + 1], rows[2 * i + 2]
                if right - left < self.cells_in(12.0) and self.random.random() < 0.3:
                    rooms.append(self._hall(left, right, upper[0], lower[1]))
                else:
                    rooms += self.row(left, right, *upper, door_above=True)
                    rooms += self.row(left, right, *lower, door_above=False)
        rooms += self.row(box.left, box.right, *rows[-1], door_above=True)
        return lanes, rooms

    def ring(self, box: Box, depth: int) -> None:
        """Fill the box with a corridor around a core, rooms along its four outer sides and in the core."""
        around = depth + self.wall
        outer = box.shrunk(around)
        core = outer.shrunk(self.corridor)
        carve(self.cells, outer.left, outer.top, outer.right, outer.bottom)
        self.cells[core.top : core.bottom, core.left : core.right] = UNKNOWN
        self.row(box.left, box.right, box.top, box.top + depth, door_above=False)
        self.row(box.left, box.right, box.bottom - depth, box.bottom, door_above=True)
        sideways = self.transposed()
        sideways.row(outer.top, outer.bottom, box.left, box.left + depth, door_above=False)
        sideways.row(outer.top, outer.bottom, box.right - depth, box.right, door_above=True)
        inner = core.shrunk(self.wall)
        halves = self.divide(inner.left, inner.width, 2, self.wall)
        sideways.row(inner.top, inner.bottom, *halves[0], door_above=True)
        sideways.row(inner.top, inner.bottom, *halves[1], door_above=False)

    def _crossed(self, box: Box, above: Box, below: Box) -> list[tuple[int, int]]:
        """Carve cross corridors between two parallel ones; return the intervals between them."""
        wanted = max(1, round(box.width * self.resolution / 12) - 1)
        stretches = self.divide(box.left, box.width, wanted + 1, self.corridor + 2 * self.wall)
        for left, _ in stretches[1:]:
            carve(self.cells, left - self.wall - self.corridor, above.bottom, left - self.wall, below.top)
        return stretches

    def _hall(self, left: int, right: int, top: int, bottom: int) -> Box:
        carve(self.cells, left, top, right, bottom)
        self.door(left, right, top - self.wall)
        self.door(left, right, bottom)
        return Box(left, top, right, bottom)

    def row(self, left: int, right: int, top: int, bottom: int, door_above: bool) -> list[Box]:
        """Carve rooms side by side from left to right, each with a door above it or below it."""
        sides = self.divide(left, right - left, self._rooms_in(right - left), self.wall)
        for room_left, room_right in sides:
            carve(self.cells, room_left, top, room_right, bottom)
            self.door(room_left, room_right, top - self.wall if door_above else bottom)
        for _, wall in sides[:-1]:
            chance = self.random.random()
            if chance < self.style.merged:
                carve(self.cells, wall, top, wall + self.wall, bottom)
            elif chance < self.style.merged + self.style.joined:
                self.transposed().door(top, bottom, wall)
        return [Box(room_left, top, room_right, bottom) for room_left, room_right in sides]

    def _rooms_in(self, length: int) -> int:
        narrow, wide = (self.cells_in(room_m) + self.wall for room_m in self.style.room_m)
        most = max((length + self.wall) // narrow, 1)
        least = min(-(-(length + self.wall) // wide), most)
        return int(self.random.integers(least, most + 1))

    def door(self, left: int, right: int, top: int) -> None:
        """Carve a door somewhere between left and right through the wall that begins at `top`."""
        narrow, wide = (-int(-door_m // self.resolution) for door_m in self.style.door_m)
        width = int(self.random.integers(narrow, wide + 1))
        post = min(self.cells_in(0.3), max((right - left - width) // 2, 0))
        start = int(self.random.integers(left + post, max(right - post - width, left + post) + 1))
        carve(self.cells, start, top, start + width, top + self.wall)

    def divide(self, start: int, length: int, count: int, gap: int) -> list[tuple[int, int]]:
        """Divide a length into `count` uneven intervals, `gap` cells apart."""
        weights = self.random.uniform(0.8, 1.25, count).cumsum()
        ends = [round(float(weight / weights[-1]) * (length - gap * (count - 1))) for weight in weights]
        return [
            (start + i * gap + begin, start + i * gap + end)
            for i, (begin, end) in enumerate(zip([0, *ends[:-1]], ends, strict=True))
        ]
