"""Merging teammates' approximations with one's own map into the planning grid (section 5.2, Algorithm 9).

Twice: `five_stages` goes step by step as Figure 5.6 does; `TeamMap` gets the same grid in an order-free form
that is fast. There each approximation becomes a layer of bits a cell, layers are joined by OR, and of the
claims that a cell has gathered the strongest counts:

    occupied by an inside boundary > free by one > occupied by an outside boundary > free area > beside a wall

Free area of an approximation is what its inside object encloses and none of its outside objects encloses
or bounds. What the robot has seen itself overrides all claims.

Two guesses, which the thesis does not make, keep robots from driving to what only looks unexplored
because approximations are coarse (`Drawing`). A coarse wall runs a cell beside the true one, so who has seen
free cells up to the true one finds unknown cells behind them: with `wide_walls` these are wall. And
approximations of areas that meet leave slivers between them: with `close_slivers` these are free.

From an approximation refined until it is exact, the teammate's own grid comes back (`rendered`) but for
the cells of which Algorithm 9 cannot know:

- free cells that were out of the teammate's reach (not 4-connected to it) come back unknown;
- occupied cells without a free 4-neighbour in reach, inside walls, come back unknown: no contour meets them;
- unknown cells on the inside contour come back free, for a free edge of an inside object is drawn (stage 4).
  With ``Drawing(free_inside_edges=False)`` they come back unknown.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence, Set
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from agent.outline.polygons import Polygons
from agent.outline.raster import draw, fill
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

UNDEFINED = 3
"""A cell of which no approximation has said anything yet (only between the stages)."""

BESIDE_WALL, FREE_AREA, OUTSIDE_OCCUPIED, INSIDE_FREE, INSIDE_OCCUPIED = 1, 2, 4, 8, 16
"""The claims of a layer; the stronger has the higher bit."""

Layer = NDArray[np.uint8]


@dataclass(frozen=True)
class Drawing:
    """What of an approximation is drawn. By default all of it, as in the thesis.

    Attributes
    ----------
    free_inside_edges : bool
        Draw inside edges that are labelled free. They claim cells free which their robot has not seen.
    unknown_pairs : bool
        Draw outside objects of two vertices and no occupied edge. They are the unseen specks between beams.
    wide_walls : bool
        Take the eight neighbours of a wall's cells for wall where nothing else is claimed of them.
    close_slivers : bool
        Take an unknown cell for free if its neighbours on the left and right or above and below are free, and
        not both by the robot's own sight.
    """

    free_inside_edges: bool = True
    unknown_pairs: bool = True
    wide_walls: bool = False
    close_slivers: bool = False


THESIS = Drawing()
"""All is drawn, as Algorithm 9 says."""


def layer(polygons: Polygons, drawing: Drawing = THESIS) -> Layer:
    """Render an approximation into the claims that it makes, a byte of bits a cell."""
    out = np.zeros(polygons.shape, np.uint8)
    _render(
        out,
        polygons.x,
        polygons.y,
        polygons.side,
        polygons.occupied,
        polygons.start,
        polygons.inside,
        drawing.free_inside_edges,
        drawing.unknown_pairs,
    )
    return out


@kernel(
    "void(uint8[:,::1], int16[::1], int16[::1], uint8[::1], uint8[::1], int32[::1], boolean[::1], boolean, "
    "boolean)"
)
def _render(
    out: NDArray[np.uint8],
    x: NDArray[np.int16],
    y: NDArray[np.int16],
    side: NDArray[np.uint8],
    occupied: NDArray[np.uint8],
    start: NDArray[np.int32],
    inside: NDArray[np.bool_],
    free_inside_edges: bool,
    unknown_pairs: bool,
) -> None:
    scratch = np.zeros(out.shape, np.uint8)
    for k in range(len(inside)):
        if inside[k]:
            fill(out, x, y, side, start[k], start[k + 1], scratch, FREE_AREA, 0)
    for k in range(len(inside)):
        first, end = start[k], start[k + 1]
        if inside[k]:
            continue
        if not unknown_pairs and end - first == 2 and not occupied[first] and not occupied[first + 1]:
            continue
        fill(out, x, y, side, first, end, scratch, 0, FREE_AREA)
        draw(out, x, y, side, occupied, first, end, OUTSIDE_OCCUPIED, 0, FREE_AREA)
    for k in range(len(inside)):
        if inside[k]:
            other = INSIDE_FREE if free_inside_edges else 0
            draw(out, x, y, side, occupied, start[k], start[k + 1], INSIDE_OCCUPIED, other, 0)


def _widen(claims: Layer) -> None:
    """Claim that the eight neighbours of walls are beside one."""
    walls = (claims & (OUTSIDE_OCCUPIED | INSIDE_OCCUPIED)) > 0
    across = walls.copy()
    across[:, 1:] |= walls[:, :-1]
    across[:, :-1] |= walls[:, 1:]
    beside = across * np.uint8(BESIDE_WALL)
    claims |= beside
    claims[1:] |= beside[:-1]
    claims[:-1] |= beside[1:]


def without_unknown_pairs(polygons: Polygons) -> Polygons:
    """Leave out the outside objects that have two vertices and no occupied edge."""
    sizes = np.diff(polygons.start)
    walls = np.add.reduceat(polygons.occupied, polygons.start[:-1], dtype=np.int64) if len(sizes) else sizes
    kept = polygons.inside | (sizes > 2) | (walls > 0)
    if kept.all():
        return polygons
    vertices = np.repeat(kept, sizes)
    start = np.concatenate([[0], np.cumsum(sizes[kept])]).astype(np.int32)
    return Polygons(
        polygons.shape,
        polygons.x[vertices],
        polygons.y[vertices],
        polygons.side[vertices],
        polygons.occupied[vertices],
        start,
        polygons.inside[kept],
    )


class TeamMap:
    """What a robot's teammates claim, ready for merging; only what changes is rendered anew.

    Parameters
    ----------
    drawing : Drawing
        What of the teammates' approximations is drawn.
    """

    def __init__(self, drawing: Drawing = THESIS) -> None:
        self._drawing = drawing
        self._layers: dict[int, Layer] = {}
        self._near: Set[int] = frozenset()
        self._claims: Layer | None = None

    def update(self, robot: int, approximation: Polygons) -> None:
        """Take over the approximation that `robot` has last saved."""
        self._layers[robot] = layer(approximation, self._drawing)
        self._claims = None

    def merged(self, own: Grid, near: Collection[int] | None = None) -> Grid:
        """Return the planning grid of a robot whose self-explored grid is `own`.

        Walls are wide only of the teammates `near` (None: all): what they have just begun to see they will soon
        tell better.
        """
        near = self._layers.keys() & (self._layers if near is None else near)
        if self._claims is None or near != self._near:
            self._near = near
            self._claims = self._united(own, near)
            if self._drawing.wide_walls:
                _widen(self._claims)
            self._claims |= self._united(own, self._layers.keys() - near)
        plan = _resolve(own, self._claims)
        return _close_slivers(own, plan) if self._drawing.close_slivers else plan

    def _united(self, own: Grid, robots: Set[int]) -> Layer:
        """Return all claims of some teammates together."""
        claims = np.zeros(own.shape, np.uint8)
        for robot in robots:
            claims |= self._layers[robot]
        return claims


def rendered(approximation: Polygons, drawing: Drawing = THESIS) -> Grid:
    """Return the grid that one approximation describes by itself."""
    claims = layer(approximation, drawing)
    if drawing.wide_walls:
        _widen(claims)
    return _resolve(np.zeros_like(claims), claims)


def approximation_error(own: Grid, approximation: Polygons, drawing: Drawing = THESIS) -> int:
    """Count the cells in which a robot's grid and the rendering of its approximation differ: d(t) of Eq. 6.1.

    Not 0 even for an exact approximation, for the cells of which Algorithm 9 cannot know (see above).
    """
    return int(np.count_nonzero(own != rendered(approximation, drawing)))


@dataclass(frozen=True, eq=False)
class Stages:
    """The planning grid after each of the five steps of Figure 5.6."""

    outside_filled: Grid
    """(a) Outside objects are filled with unknown; all else is undefined."""
    outside_bounded: Grid
    """(b) Their boundaries are drawn, unknown ones never over occupied ones."""
    inside_filled: Grid
    """(c), (d) Within an inside object, what is undefined, or unknown but in none of the same robot's outside
    objects, is free."""
    inside_bounded: Grid
    """(e) The boundaries of the inside objects are drawn over it, occupied ones over free ones."""
    complete: Grid
    """(f) What is undefined is unknown, and what the robot has seen itself stands. Then the guesses: what is
    unknown beside a wall of any boundary is occupied, and unknown slivers are free."""


def five_stages(own: Grid, approximations: Sequence[Polygons], drawing: Drawing = THESIS) -> Stages:
    """Merge approximations with one's own grid as Algorithm 9 does, line by line."""
    plan = np.full(own.shape, UNDEFINED, np.uint8)
    objects = [_objects(polygons, drawing) for polygons in approximations]
    outside = [[each for each in team_object if not each.inside] for team_object in objects]
    inside = [[each for each in team_object if each.inside] for team_object in objects]

    for each in chain(*outside):
        plan[each.filled] = UNKNOWN
    outside_filled = plan.copy()

    for each in chain(*outside):
        plan[each.other_edges & (plan != OCCUPIED)] = UNKNOWN
        plan[each.occupied_edges] = OCCUPIED
    outside_bounded = plan.copy()

    for around, within in zip(inside, outside, strict=True):
        contained = np.zeros(own.shape, np.bool_)
        for each in within:
            contained |= each.filled | each.other_edges | each.occupied_edges
        for each in around:
            plan[each.filled & (plan == UNKNOWN) & ~contained] = FREE
            plan[each.filled & (plan == UNDEFINED)] = FREE
    inside_filled = plan.copy()

    if drawing.free_inside_edges:
        for each in chain(*inside):
            plan[each.other_edges] = FREE
    for each in chain(*inside):
        plan[each.occupied_edges] = OCCUPIED
    inside_bounded = plan.copy()

    plan[plan == UNDEFINED] = UNKNOWN
    if drawing.wide_walls:
        walls = np.zeros(own.shape, np.bool_)
        for each in chain(*outside, *inside):
            walls |= each.occupied_edges
        plan[binary_dilation(walls, np.ones((3, 3))) & (plan == UNKNOWN)] = OCCUPIED
    plan[own != UNKNOWN] = own[own != UNKNOWN]
    if drawing.close_slivers:
        free, seen = np.pad(plan == FREE, 1), np.pad(own != UNKNOWN, 1)
        beside, above = (np.s_[1:-1, :-2], np.s_[1:-1, 2:]), (np.s_[:-2, 1:-1], np.s_[2:, 1:-1])
        for one, other in (beside, above):
            plan[(plan == UNKNOWN) & free[one] & free[other] & ~(seen[one] & seen[other])] = FREE
    return Stages(outside_filled, outside_bounded, inside_filled, inside_bounded, plan)


@dataclass(frozen=True, eq=False)
class _Object:
    inside: bool
    filled: NDArray[np.bool_]
    occupied_edges: NDArray[np.bool_]
    other_edges: NDArray[np.bool_]


def _objects(polygons: Polygons, drawing: Drawing) -> list[_Object]:
    """Rasterise each object by itself."""
    objects = []
    x, y, side, occupied = polygons.x, polygons.y, polygons.side, polygons.occupied
    for inside, first, end in zip(polygons.inside, polygons.start[:-1], polygons.start[1:], strict=True):
        if not (inside or drawing.unknown_pairs or end - first > 2 or occupied[first:end].any()):
            continue
        area, edges, scratch = (np.zeros(polygons.shape, np.uint8) for _ in range(3))
        fill(area, x, y, side, first, end, scratch, 1, 0)
        draw(edges, x, y, side, occupied, first, end, 1, 2, 0)
        objects.append(_Object(bool(inside), area == 1, edges & 1 > 0, edges & 2 > 0))
    return objects


@kernel("uint8[:,::1](uint8[:,::1], uint8[:,::1])")
def _resolve(own: NDArray[np.uint8], claims: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Let the strongest claim of each cell count, and what the robot knows itself above all."""
    out = np.empty_like(own)
    for row in range(len(own)):
        known, claim, cells = own[row], claims[row], out[row]
        for at in range(len(cells)):
            c = claim[at]
            cell = OCCUPIED if c & BESIDE_WALL else UNKNOWN
            cell = FREE if c & FREE_AREA else cell
            cell = OCCUPIED if c & OUTSIDE_OCCUPIED else cell
            cell = FREE if c & INSIDE_FREE else cell
            cell = OCCUPIED if c & INSIDE_OCCUPIED else cell
            cells[at] = cell if known[at] == UNKNOWN else known[at]
    return out


@kernel("uint8[:,::1](uint8[:,::1], uint8[:,::1])")
def _close_slivers(own: NDArray[np.uint8], plan: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Free the unknown cells between two free ones that the robot has not both seen itself."""
    out = plan.copy()
    height, width = plan.shape
    for y in range(height):
        for x in range(width):
            if plan[y, x] != UNKNOWN:
                continue
            for dy, dx in ((0, 1), (1, 0)):
                if not (dy <= y < height - dy and dx <= x < width - dx):
                    continue
                if plan[y - dy, x - dx] != FREE or plan[y + dy, x + dx] != FREE:
                    continue
                if own[y - dy, x - dx] == UNKNOWN or own[y + dy, x + dx] == UNKNOWN:
                    out[y, x] = FREE
    return out
