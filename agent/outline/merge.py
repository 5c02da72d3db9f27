"""Merging teammates' approximations with one's own map into the planning grid (section 5.2, Algorithm 9).

Twice: `agent.outline.five_stages` goes step by step as Figure 5.6 does; `TeamMap` gets the same grid in an
order-free form that is fast. There each approximation becomes a layer of bits a cell, layers are tallied, and of the
claims that a cell has gathered the strongest counts:

    occupied by an inside boundary > free by one > occupied by an outside boundary > free area > beside a wall

What the robot has seen itself overrides all claims. A cell of the planning grid follows from the cells around it,
two away at most; so only where something has changed it is merged anew.

Two guesses, which the thesis does not make, keep robots from driving to what only looks unexplored
because approximations are coarse (`Drawing`). A coarse wall runs a cell beside the true one, so who has seen
free cells up to the true one finds unknown cells behind them: with `wide_walls` these are wall; without
`wide_seen_walls` only beside walls that the robot has not seen itself, so that no small opening is lost. And
approximations of areas that meet leave slivers between them: with `close_slivers` these are free.

From an approximation refined until it is exact, the teammate's own grid comes back (`rendered`) but for
the cells of which Algorithm 9 cannot know:

- free cells that were out of the teammate's reach (not 4-connected to it) come back unknown;
- occupied cells without a free 4-neighbour in reach, inside walls, come back unknown: no contour meets them;
- unknown cells on the inside contour come back free, for a free edge of an inside object is drawn (stage 4).
  With ``Drawing(free_inside_edges=False)`` they come back unknown.
"""

from __future__ import annotations

from collections.abc import Collection, Set

import numpy as np
from numpy.typing import NDArray

from agent.memo_cache import NO_CACHE, MemoCache
from agent.outline.claims import (
    FREE_AREA,
    INSIDE_FREE,
    INSIDE_OCCUPIED,
    NEAR_WALL,
    NO_TALLY,
    OUTSIDE_OCCUPIED,
    THESIS,
    THIN,
    WIDE_UNSEEN,
    Drawing,
    Drawn,
    Layer,
    Tally,
)
from agent.outline.objects import Objects
from agent.outline.polygons import Polygons
from protocol.boxes import NO_BOXES, Boxes, clip, union, whole_grid
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel


class TeamMap:
    """What a robot's teammates claim, merged with what it has seen itself; only what changes is done anew.

    Parameters
    ----------
    drawing : Drawing
        What of the teammates' approximations is drawn.
    cache : MemoCache
        Cache of intermediate results, shared by the robots of this process.
    """

    def __init__(self, drawing: Drawing = THESIS, cache: MemoCache = NO_CACHE) -> None:
        self._drawing = drawing
        self._cache = cache
        self._drawn: dict[int, Drawn] = {}
        self._near: Set[int] = frozenset()
        """Teammates whose claims count as those of robots near."""
        self._tally = NO_TALLY
        self._changed: list[Boxes] = []
        """Where claims have changed since the last merge."""
        self._resolved: Grid | None = None
        """What the robot and its teammates say of each cell."""
        self._plan: Grid | None = None
        """The same with slivers closed."""

    def update(self, robot: int, approximation: Objects, changed: Boxes | None = None) -> None:
        """Take over the approximation that `robot` has last saved.

        It differs from the one before in the boxes `changed` at most (None: anywhere).
        """
        shape = approximation.shape
        self._lay_out(shape)
        if robot not in self._drawn:
            self._drawn[robot] = Drawn(shape, self._drawing, self._cache)
        news = self._drawn[robot].follow(approximation, changed)
        self._tally.count(news, robot in self._near)
        self._changed.append(news.boxes)

    def merged(self, own: Grid, near: Collection[int] | None = None, changed: Boxes | None = None) -> Grid:
        """Return the planning grid of a robot whose self-explored grid is `own`.

        Walls are wide only of the teammates `near` (None: all): what they have just begun to see they will soon
        tell better. `own` differs from the one merged last in the boxes `changed` at most (None: anywhere).

        The grid that is returned is written over by the next call.
        """
        self._lay_out(own.shape)
        if self._drawing.wide_walls:
            self._sort_out(self._drawn.keys() & (self._drawn if near is None else near))
        if self._resolved is None or self._plan is None or changed is None:
            self._resolved = np.zeros_like(own)
            self._plan = np.zeros_like(own) if self._drawing.close_slivers else self._resolved
            self._changed, changed = [whole_grid(own.shape)], NO_BOXES
        if self._changed or len(changed):
            claims_changed = np.concatenate([NO_BOXES, *self._changed])
            guesses = self._drawing.wide, self._drawing.close_slivers
            _merge(own, self._tally.claims, *guesses, claims_changed, changed, self._resolved, self._plan)
            self._changed = []
        return self._plan

    def _lay_out(self, shape: tuple[int, ...]) -> None:
        """Begin with nothing claimed."""
        if self._tally is NO_TALLY:
            self._tally = Tally(shape)

    def _sort_out(self, near: Set[int]) -> None:
        """Note who is near."""
        for robot in sorted(near ^ self._near):
            self._changed.append(self._tally.turn(self._drawn[robot].layer, robot in near))
        self._near = near


def rendered(approximation: Polygons, drawing: Drawing = THESIS) -> Grid:
    """Return the grid that one approximation describes by itself."""
    team = TeamMap(drawing)
    team.update(0, Objects.of(approximation))
    return team.merged(np.zeros(approximation.shape, np.uint8))


def approximation_error(own: Grid, approximation: Polygons, drawing: Drawing = THESIS) -> int:
    """Count the cells in which a robot's grid and the rendering of its approximation differ: d(t) of Eq. 6.1.

    Not 0 even for an exact approximation, for the cells of which Algorithm 9 cannot know (see above).
    """
    return int(np.count_nonzero(own != rendered(approximation, drawing)))


class ErrorCount:
    """`approximation_error` of a grid and an approximation that change little by little.

    Parameters
    ----------
    drawing : Drawing
        What is drawn; without guesses.
    cache : MemoCache
        Cache of intermediate results, shared by the robots of this process.
    """

    def __init__(self, drawing: Drawing = THESIS, cache: MemoCache = NO_CACHE) -> None:
        if drawing.wide_walls or drawing.close_slivers:
            raise ValueError(f"{drawing}: what receivers guess is no error of the approximation")
        self._drawing = drawing
        self._cache = cache
        self._drawn: Drawn | None = None
        self._wrong: NDArray[np.bool_] = np.zeros((0, 0), np.bool_)
        self._count = 0

    def count(
        self,
        own: Grid,
        approximation: Objects,
        own_changed: Boxes | None = None,
        changed: Boxes | None = None,
    ) -> int:
        """Return the error now; both differ from the last ones in the boxes at most (None: anywhere)."""
        if self._drawn is None or changed is None or own_changed is None:
            self._drawn = Drawn(approximation.shape, self._drawing, self._cache)
            self._wrong = np.zeros(own.shape, np.bool_)
            self._count = 0
            own_changed = changed = whole_grid(approximation.shape)
        boxes = own_changed
        if len(changed):
            boxes = union(boxes, self._drawn.follow(approximation, changed).boxes)
        if len(boxes):
            self._count += int(_count_wrong(own, self._drawn.layer, boxes, self._wrong))
        return self._count


@kernel("uint8(uint8, uint8, uint8)")
def _strongest(known: int, claims: int, beside_wall: int) -> int:
    """What a cell is by its claims and what the robot knows itself; and beside a wall."""
    cell = OCCUPIED if beside_wall else UNKNOWN
    cell = FREE if claims & FREE_AREA else cell
    cell = OCCUPIED if claims & OUTSIDE_OCCUPIED else cell
    cell = FREE if claims & INSIDE_FREE else cell
    cell = OCCUPIED if claims & INSIDE_OCCUPIED else cell
    return cell if known == UNKNOWN else known


@kernel("int64(uint8[:,::1], uint8[:,::1], int32[:,::1], boolean[:,::1])")
def _count_wrong(own: Grid, claims: Layer, boxes: Boxes, wrong: NDArray[np.bool_]) -> int:
    """Note in some boxes which cells are wrong; how many more there are than before."""
    more = 0
    box = np.empty(4, np.int32)
    for number in range(len(boxes)):
        clip(boxes[number], 0, own.shape, box)
        for y in range(box[1], box[3]):
            known, claimed = own[y, box[0] : box[2]], claims[y, box[0] : box[2]]
            here = wrong[y, box[0] : box[2]]
            for x in range(len(here)):
                is_wrong = known[x] != _strongest(UNKNOWN, claimed[x], 0)
                more += int(is_wrong) - int(here[x])
                here[x] = is_wrong
    return more


@kernel("void(uint8[:,::1], uint8[:,::1], int64, int32[::1], uint8[:,::1])")
def _resolve(own: Grid, claims: Layer, wide: int, box: NDArray[np.int32], resolved: Grid) -> None:
    """Let the strongest claim of each cell count, and what the robot knows itself above all.

    The eight neighbours of walls of those near are beside one, if these are `wide`.
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
                    relayed_state = here[x] if seen_here[x] != OCCUPIED else 0
                    relayed_state |= above[x] if seen_above[x] != OCCUPIED else 0
                    relayed_state |= below[x] if seen_below[x] != OCCUPIED else 0
                    column[x] = relayed_state & NEAR_WALL
            for x in range(len(beside)):
                beside[x] = walls[x] | walls[x + 1] | walls[x + 2]
        known, claimed, out = own[y, x0:x1], claims[y, x0:x1], resolved[y, x0:x1]
        for x in range(len(beside)):
            out[x] = _strongest(known[x], claimed[x], beside[x])


@kernel("void(uint8[:,::1], uint8[:,::1], int32[::1], uint8[:,::1])")
def _close_slivers(own: Grid, resolved: Grid, box: NDArray[np.int32], plan: Grid) -> None:
    """Free the unknown cells between two free ones that the robot has not both seen itself."""
    height, width = own.shape
    for y in range(box[1], box[3]):
        for x in range(box[0], box[2]):
            plan[y, x] = resolved[y, x]
            if resolved[y, x] != UNKNOWN:
                continue
            if 0 < x < width - 1 and resolved[y, x - 1] == FREE and resolved[y, x + 1] == FREE:
                plan[y, x] = FREE if own[y, x - 1] == UNKNOWN or own[y, x + 1] == UNKNOWN else UNKNOWN
            if 0 < y < height - 1 and resolved[y - 1, x] == FREE and resolved[y + 1, x] == FREE:
                is_heard = own[y - 1, x] == UNKNOWN or own[y + 1, x] == UNKNOWN
                plan[y, x] = FREE if is_heard else plan[y, x]


@kernel(
    "void(uint8[:,::1], uint8[:,::1], int64, boolean, int32[:,::1], int32[:,::1], uint8[:,::1], uint8[:,::1])"
)
def _merge(
    own: Grid,
    claims: Layer,
    wide: int,
    close_slivers: bool,
    claims_changed: Boxes,
    own_changed: Boxes,
    resolved: Grid,
    plan: Grid,
) -> None:
    """Bring all up to date that follows from what has changed."""
    box = np.empty(4, np.int32)
    spread = 0 if wide == THIN else 1
    own_spread = 1 if wide == WIDE_UNSEEN else 0
    for number in range(len(claims_changed)):
        clip(claims_changed[number], spread, own.shape, box)
        _resolve(own, claims, wide, box, resolved)
    for number in range(len(own_changed)):
        clip(own_changed[number], own_spread, own.shape, box)
        _resolve(own, claims, wide, box, resolved)
    if not close_slivers:
        return
    for number in range(len(claims_changed)):
        clip(claims_changed[number], spread + 1, own.shape, box)
        _close_slivers(own, resolved, box, plan)
    for number in range(len(own_changed)):
        clip(own_changed[number], own_spread + 1, own.shape, box)
        _close_slivers(own, resolved, box, plan)
