"""Shapes for the dashboard's maps: pictures of grids, positions, axes in meters, paths, numbers on robots.

The dashboard's plane is the map's frame in meters, with y pointing down as in pictures.
"""

from __future__ import annotations

import io
import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from deploy.record.colors import ALARM, CELLS
from deploy.record.ticks import tick_values
from worldsim.maps import Map

ARC_POINTS = 73
"""Points of a full circle: one per five degrees."""

Point = tuple[float, float]
Strip = list[Point]

_STROKES: tuple[tuple[Strip, ...], ...] = (
    ([(0, 0), (1, 0), (1, 2), (0, 2), (0, 0)],),
    ([(0.2, 0.3), (0.6, 0), (0.6, 2)],),
    ([(0, 0), (1, 0), (1, 1), (0, 1), (0, 2), (1, 2)],),
    ([(0, 0), (1, 0), (1, 2), (0, 2)], [(0, 1), (1, 1)]),
    ([(0, 0), (0, 1), (1, 1)], [(1, 0), (1, 2)]),
    ([(1, 0), (0, 0), (0, 1), (1, 1), (1, 2), (0, 2)],),
    ([(1, 0), (0, 0), (0, 2), (1, 2), (1, 1), (0, 1)],),
    ([(0, 0), (1, 0), (0.35, 2)],),
    ([(0, 0), (1, 0), (1, 2), (0, 2), (0, 0)], [(0, 1), (1, 1)]),
    ([(1, 1), (0, 1), (0, 0), (1, 0), (1, 2), (0, 2)],),
)
"""The strokes of each digit in a box of 1 x 2, y down."""

TALLEST, WIDEST = 0.55, 0.8
"""Half of a number's height, and of its diagonal, at most, in radii of its disc."""


def map_picture(width: int, height: int, cells: bytes) -> bytes:
    """Return a PNG picture of a grid as `protocol.cell_bytes.grid_to_bytes` packs it, two bits per cell."""
    picture = Image.frombytes("P", (width, height), cells, "raw", "P;2")
    picture.putpalette([value for color in (*CELLS, ALARM) for value in color])
    file = io.BytesIO()
    picture.save(file, "PNG")
    return file.getvalue()


def flip(place: Point) -> Point:
    """Convert a position from the map's frame to the dashboard's plane, or back."""
    return place[0], -place[1]


def number_strips(number: int, center: Point, radius: float) -> list[Strip]:
    """Draw a number as strokes on a disc of this radius: readable on any color, at any zoom."""
    digits = str(number)
    boxes = 1.6 * len(digits) - 0.6
    scale = radius * min(TALLEST, WIDEST / math.hypot(boxes / 2, 1))
    width = scale * boxes
    return [
        [(center[0] - width / 2 + scale * (1.6 * place + x), center[1] + scale * (y - 1)) for x, y in stroke]
        for place, digit in enumerate(digits)
        for stroke in _STROKES[int(digit)]
    ]


def corner(map_: Map) -> Point:
    """The upper left corner of a map in the dashboard's plane."""
    return map_.origin[0], -(map_.origin[1] + map_.height * map_.resolution)


def axes(map_: Map, most: int, room: float) -> tuple[list[Strip], list[Point], list[str]]:
    """Axes along a map's left and lower side: lines, and the positions of labels, with the unit on the last one.

    `most` is the number of labels along the longer side; `room` is that for labels, in map sides. The corner has one
    label.
    """
    left, top = corner(map_)
    right, bottom = left + map_.width * map_.resolution, top + map_.height * map_.resolution
    side = max(right - left, bottom - top)
    tick, margin = 0.012 * side, room * side
    strips: list[Strip] = [[(left, top), (left, bottom), (right, bottom)]]
    places: list[Point] = []
    labels: list[str] = []
    across = tick_values(left, right, max(1, most * (right - left) / side))
    for x in across:
        strips.append([(x, bottom), (x, bottom + tick)])
        places.append((x, bottom + 0.3 * margin))
        labels.append(f"{x:g} m" if x == across[-1] else f"{x:g}")
    for y in tick_values(-bottom, -top, max(1, most * (bottom - top) / side)):
        strips.append([(left, -y), (left - tick, -y)])
        if bottom + y > 0.4 * margin:
            places.append((left - 0.5 * margin, -y - 0.25 * margin))
            labels.append(f"{y:g}")
    return strips, places, labels


def arrow(start: Point, end: Point, gap: float) -> tuple[Point, Point]:
    """The origin and the vector of an arrow between two robots; it ends `gap` before the center of the second one."""
    length = math.dist(start, end)
    share = max(0.0, 1 - gap / length) if length else 0.0
    return start, (share * (end[0] - start[0]), share * (end[1] - start[1]))


def circle_within(map_: Map, center: Point, radius: float) -> list[Strip]:
    """The parts of a circle that lie on the map, so that it covers no labels beside it."""
    left, top = corner(map_)
    right, bottom = left + map_.width * map_.resolution, top + map_.height * map_.resolution
    angles = np.linspace(0, 2 * np.pi, ARC_POINTS)
    points = np.array(center) + radius * np.column_stack((np.cos(angles), np.sin(angles)))
    inside = np.all((points >= (left, top)) & (points <= (right, bottom)), axis=1)
    stops = np.flatnonzero(np.diff(inside)) + 1
    parts, shown = np.split(points, stops), inside[np.append(0, stops)].tolist()
    return [part.round(3).tolist() for part, on in zip(parts, shown, strict=True) if on and len(part) > 1]


def outline_strips(map_: Map, vertices: bytes) -> list[NDArray[np.float64]]:
    """Closed outlines in the dashboard's plane, from the vertices of a `protocol.messages.Outlines`."""
    rows = np.frombuffer(vertices, "<i2").reshape(-1, 4)
    if not len(rows):
        return []
    places = np.array(corner(map_)) + (rows[:, 1:3] / 4 + 0.5) * map_.resolution
    parts = np.split(places, np.flatnonzero(np.diff(rows[:, 0])) + 1)
    return [np.vstack((part, part[:1])) for part in parts]


def extend(path: list[Point], place: Point) -> None:
    """Append a position to a path; it replaces the last one if it continues the line of the last two."""
    if path and path[-1] == place:
        return
    if len(path) > 1 and _straight(path[-2], path[-1], place):
        path[-1] = place
    else:
        path.append(place)


def _straight(a: Point, b: Point, c: Point) -> bool:
    along, ahead = (b[0] - a[0], b[1] - a[1]), (c[0] - b[0], c[1] - b[1])
    turn = along[0] * ahead[1] - along[1] * ahead[0]
    return abs(turn) < 1e-9 and along[0] * ahead[0] + along[1] * ahead[1] > 0
