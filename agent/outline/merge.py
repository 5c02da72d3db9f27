"""Merging of teammates' approximations with the self-explored grid into the planning grid (section 5.2, Algorithm 9).

`TeamMap` computes the grid of Figure 5.6 (stage by stage: `deploy.bench.five_stages`) faster, and independent of the
order of approximations. Each approximation is drawn as claims about cells (`agent.outline.claims`). The claims
of all teammates are counted, and the strongest claim about a cell decides:

    occupied inside edge > free inside edge > occupied outside edge > free area > beside a wall

With ``keep_walls`` the second and the third change places, so that no free edge opens a wall that another robot has
seen.

The self-explored grid overrides all claims. A cell of the planning grid depends on the cells at most two away, so only
the surroundings of changes are merged again.

Two inferences, which the thesis does not make, keep robots from driving to cells that are unknown only because
approximations are coarse (`Drawing`). First, a coarse wall can lie a cell beside the true wall. A robot that has seen
free cells up to the true wall then finds unknown cells behind them: with `wide_walls` these become wall. Without
`wide_seen_walls` this applies only beside walls that the robot has not seen itself, so that no small opening is lost.
Second, approximations of adjacent areas leave slivers between them: with `close_slivers` these become free.

An approximation refined until it is exact gives the teammate's grid (`rendered`), except for cells that Algorithm 9
cannot determine:

- free cells that are not 4-connected to the teammate become unknown;
- occupied cells without a free 4-neighbor that the teammate can reach, inside walls, become unknown: no contour has
  them;
- unknown cells on the inside contour become free, because free edges of inside objects are drawn (stage 4). With
  ``Drawing(free_inside_edges=False)`` they stay unknown.
"""

from __future__ import annotations

from collections.abc import Collection, Set

import numpy as np

from agent.memo_cache import NO_CACHE, MemoCache
from agent.outline.approximation import approximation
from agent.outline.claims import (
    FREE_AREA,
    INSIDE_FREE,
    INSIDE_OCCUPIED,
    NEAR_WALL,
    NO_COUNTS,
    OUTSIDE_OCCUPIED,
    THESIS,
    THIN,
    WIDE_UNSEEN,
    ClaimCounts,
    Drawing,
    DrawnClaims,
    Layer,
)
from agent.outline.contour import contours
from agent.outline.objects import Objects
from agent.outline.polygons import Polygons
from protocol.arrays import BoolRows, Int32s, Uint8
from protocol.boxes import NO_BOXES, Boxes, clip, union, whole_grid
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid, Mask
from protocol.kernels import kernel


class TeamMap:
    """Planning grid of a robot: the claims of its teammates, merged with its self-explored grid, updated incrementally.

    `drawing` has the parts of the approximations that are drawn, and inferences; `cache` intermediate results, shared
    by the robots of this process.
    """

    def __init__(self, drawing: Drawing = THESIS, cache: MemoCache = NO_CACHE) -> None:
        self._drawing = drawing
        self._cache = cache
        self._drawn: dict[int, DrawnClaims] = {}
        self._near: Set[int] = frozenset()
        """Teammates in range: their walls are widened."""
        self._counts = NO_COUNTS
        self._changed: list[Boxes] = []
        """Boxes of claims that have changed since the last merge."""
        self._resolved: Grid | None = None
        """The planning grid before slivers are closed."""
        self._plan: Grid | None = None
        """The planning grid."""

    def update(self, robot: int, objects: Objects, changed: Boxes | None = None) -> None:
        """Replace the approximation of `robot`, which has changed only in the boxes `changed` (None: anywhere)."""
        shape = objects.shape
        self._allocate(shape)
        if robot not in self._drawn:
            self._drawn[robot] = DrawnClaims(shape, self._drawing, self._cache)
        difference = self._drawn[robot].update(objects, changed)
        self._counts.apply(difference, robot in self._near)
        self._changed.append(difference.boxes)

    def merged(self, own: Grid, near: Collection[int] | None = None, changed: Boxes | None = None) -> Grid:
        """Return the planning grid of a robot whose self-explored grid is `own`.

        Only walls of the teammates `near` are widened (None: of all), because they will soon send better ones. `own`
        has changed since the last call only in the boxes `changed` (None: anywhere).

        The next call overwrites the returned grid.
        """
        self._allocate(own.shape)
        if self._drawing.wide_walls:
            self._set_near(self._drawn.keys() & (self._drawn if near is None else near))
        if self._resolved is None or self._plan is None or changed is None:
            self._resolved = np.zeros_like(own)
            self._plan = np.zeros_like(own) if self._drawing.close_slivers else self._resolved
            self._changed, changed = [whole_grid(own.shape)], NO_BOXES
        if self._changed or len(changed):
            boxes = np.concatenate([NO_BOXES, *self._changed]), changed
            drawing = self._drawing
            inferences = drawing.keep_walls, drawing.wide, drawing.close_slivers
            _merge(own, self._counts.claims, inferences, boxes, self._resolved, self._plan)
            self._changed = []
        return self._plan

    def _allocate(self, shape: tuple[int, ...]) -> None:
        """Allocate the counts at the first call."""
        if self._counts is NO_COUNTS:
            self._counts = ClaimCounts(shape)

    def _set_near(self, near: Set[int]) -> None:
        """Update the claims of teammates that have become near, or are not near any more."""
        for robot in sorted(near ^ self._near):
            self._changed.append(self._counts.set_near(self._drawn[robot].layer, robot in near))
        self._near = near


def rendered(polygons: Polygons, drawing: Drawing = THESIS) -> Grid:
    """Return the grid that one approximation represents."""
    team = TeamMap(drawing)
    team.update(0, Objects.of(polygons))
    return team.merged(np.zeros(polygons.shape, np.uint8))


def approximation_error(own: Grid, polygons: Polygons, drawing: Drawing = THESIS) -> int:
    """Count the cells in which a robot's grid and the rendering of its approximation differ: d(t) of Eq. 6.1.

    It is above 0 even for an exact approximation, because of the cells that Algorithm 9 cannot determine (see above).
    """
    return int(np.count_nonzero(own != rendered(polygons, drawing)))


def exact_error(own: Grid, robot: Cell, drawing: Drawing = THESIS) -> int:
    """Count what `approximation_error` is for the exact contours of a grid: the part that is not due to coarseness.

    Free edges of inside objects alone cover 1 to 3 % of the cells, which hides the effect of the splitting frequency.
    `robot` is a free cell (x, y), the robot's.
    """
    exact = contours(own, robot)
    every = np.arange(len(exact.symbols), dtype=np.int32)
    complete = approximation(exact, every, unknown_pairs=drawing.unknown_pairs)
    return approximation_error(own, complete, drawing)


class ErrorCount:
    """`approximation_error` of a grid and an approximation that change step by step; without inferences."""

    def __init__(self, drawing: Drawing = THESIS, cache: MemoCache = NO_CACHE) -> None:
        self._drawing = drawing
        self._cache = cache
        self._drawn: DrawnClaims | None = None
        self._wrong: Mask = np.zeros((0, 0), np.bool_)
        self._count = 0

    def count(
        self, own: Grid, objects: Objects, own_changed: Boxes | None = None, changed: Boxes | None = None
    ) -> int:
        """Return the current error; grid and approximation have changed only in these boxes (None: anywhere)."""
        if self._drawn is None or changed is None or own_changed is None:
            self._drawn = DrawnClaims(objects.shape, self._drawing, self._cache)
            self._wrong = np.zeros(own.shape, np.bool_)
            self._count = 0
            own_changed = changed = whole_grid(objects.shape)
        boxes = own_changed
        if len(changed):
            boxes = union(boxes, self._drawn.update(objects, changed).boxes)
        if len(boxes):
            keep_walls = self._drawing.keep_walls
            self._count += int(_count_wrong(own, self._drawn.layer, keep_walls, boxes, self._wrong))
        return self._count


@kernel
def _strongest(known: Uint8, claims: Uint8, beside_wall: Uint8, keep_walls: bool) -> Uint8:
    """Return the state of a cell by its strongest claim, unless the robot knows it itself."""
    cell = OCCUPIED if beside_wall else UNKNOWN
    cell = FREE if claims & FREE_AREA else cell
    cell = OCCUPIED if claims & OUTSIDE_OCCUPIED else cell
    cell = FREE if claims & INSIDE_FREE and not (keep_walls and claims & OUTSIDE_OCCUPIED) else cell
    cell = OCCUPIED if claims & INSIDE_OCCUPIED else cell
    return cell if known == UNKNOWN else known


@kernel
def _count_wrong(own: Grid, claims: Layer, keep_walls: bool, boxes: Boxes, wrong: BoolRows) -> int:
    """Update `wrong`, the cells that differ, within boxes; return by how many their number has grown."""
    more = 0
    box = np.empty(4, np.int32)
    for number in range(len(boxes)):
        clip(boxes[number], 0, own.shape, box)
        for y in range(box[1], box[3]):
            known, claimed = own[y, box[0] : box[2]], claims[y, box[0] : box[2]]
            here = wrong[y, box[0] : box[2]]
            for x in range(len(here)):
                is_wrong = known[x] != _strongest(UNKNOWN, claimed[x], 0, keep_walls)
                more += int(is_wrong) - int(here[x])
                here[x] = is_wrong
    return more


@kernel
def _resolve(own: Grid, claims: Layer, keep_walls: bool, wide: int, box: Int32s, resolved: Grid) -> None:
    """Write the state of each cell in a box by its strongest claim, or by the self-explored grid.

    Depending on `wide`, the eight neighbors of the walls of near teammates count as beside a wall.
    """
    x0, x1 = box[0], box[2]
    height, width = own.shape
    beside = np.zeros(x1 - x0, np.uint8)
    walls = np.zeros(x1 - x0 + 2, np.uint8)
    for y in range(box[1], box[3]):
        if wide != THIN:
            left, right = max(x0 - 1, 0), min(x1 + 1, width)
            column = walls[left - x0 + 1 : right - x0 + 1]
            here = claims[y, left:right]
            above = claims[max(y - 1, 0), left:right]
            below = claims[min(y + 1, height - 1), left:right]
            for x in range(len(column)):
                column[x] = (here[x] | above[x] | below[x]) & NEAR_WALL
            if wide == WIDE_UNSEEN:
                seen_here, seen_above = own[y, left:right], own[max(y - 1, 0), left:right]
                seen_below = own[min(y + 1, height - 1), left:right]
                for x in range(len(column)):
                    unseen = here[x] if seen_here[x] != OCCUPIED else 0
                    unseen |= above[x] if seen_above[x] != OCCUPIED else 0
                    unseen |= below[x] if seen_below[x] != OCCUPIED else 0
                    column[x] = unseen & NEAR_WALL
            for x in range(len(beside)):
                beside[x] = walls[x] | walls[x + 1] | walls[x + 2]
        known, claimed, out = own[y, x0:x1], claims[y, x0:x1], resolved[y, x0:x1]
        for x in range(len(beside)):
            out[x] = _strongest(known[x], claimed[x], beside[x], keep_walls)


@kernel
def _close_slivers(own: Grid, resolved: Grid, box: Int32s, plan: Grid) -> None:
    """Free, within a box, the unknown cells between two free ones of which the robot has not seen both itself."""
    height, width = own.shape
    for y in range(box[1], box[3]):
        for x in range(box[0], box[2]):
            plan[y, x] = resolved[y, x]
            if resolved[y, x] != UNKNOWN:
                continue
            if 0 < x < width - 1 and resolved[y, x - 1] == FREE and resolved[y, x + 1] == FREE:
                plan[y, x] = FREE if own[y, x - 1] == UNKNOWN or own[y, x + 1] == UNKNOWN else UNKNOWN
            if 0 < y < height - 1 and resolved[y - 1, x] == FREE and resolved[y + 1, x] == FREE:
                is_reported = own[y - 1, x] == UNKNOWN or own[y + 1, x] == UNKNOWN
                plan[y, x] = FREE if is_reported else plan[y, x]


@kernel
def _merge(
    own: Grid,
    claims: Layer,
    inferences: tuple[bool, int, bool],
    changed: tuple[Boxes, Boxes],
    resolved: Grid,
    plan: Grid,
) -> None:
    """Update all cells that depend on changed claims, or on changed cells of the self-explored grid.

    `inferences` are `keep_walls`, `wide`, and `close_slivers` of the `Drawing`.
    """
    keep_walls, wide, close_slivers = inferences
    box = np.empty(4, np.int32)
    margins = 0 if wide == THIN else 1, 1 if wide == WIDE_UNSEEN else 0
    for boxes, around in zip(changed, margins):  # noqa: B905  numba knows no `strict`
        for number in range(len(boxes)):
            clip(boxes[number], around, own.shape, box)
            _resolve(own, claims, keep_walls, wide, box, resolved)
    if not close_slivers:
        return
    for boxes, around in zip(changed, margins):  # noqa: B905
        for number in range(len(boxes)):
            clip(boxes[number], around + 1, own.shape, box)
            _close_slivers(own, resolved, box, plan)
