"""Merging teammates' approximations with one's own map into the planning grid (section 5.2, Algorithm 9).

Twice: `agent.outline.five_stages` goes step by step as Figure 5.6 does; `TeamMap` gets the same grid in an
order-free form that is fast. There each approximation becomes a layer of bits a cell, layers are joined by OR, and
of the claims that a cell has gathered the strongest counts:

    occupied by an inside boundary > free by one > occupied by an outside boundary > free area > beside a wall

What the robot has seen itself overrides all claims. A cell of the planning grid follows from the cells around it,
two away at most; so only where something has changed it is merged anew.

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

from collections.abc import Collection, Set

import numpy as np
from numpy.typing import NDArray

from agent.outline.boxes import NO_BOXES, Boxes, clip, united, whole
from agent.outline.claims import (
    FREE_AREA,
    INSIDE_FREE,
    INSIDE_OCCUPIED,
    OUTSIDE_OCCUPIED,
    THESIS,
    Drawing,
    Layer,
    draw_anew,
    layer,
)
from agent.outline.polygons import Polygons
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

_WALL = OUTSIDE_OCCUPIED | INSIDE_OCCUPIED


class TeamMap:
    """What a robot's teammates claim, merged with what it has seen itself; only what changes is done anew.

    Parameters
    ----------
    drawing : Drawing
        What of the teammates' approximations is drawn.
    """

    def __init__(self, drawing: Drawing = THESIS) -> None:
        self._drawing = drawing
        self._slots: dict[int, int] = {}
        """Where in `_layers` each teammate's claims are."""
        self._layers: NDArray[np.uint8] = np.zeros((0, 0, 0), np.uint8)
        self._scratch: Layer = np.zeros((0, 0), np.uint8)
        self._near: Set[int] = frozenset()
        self._rows = _numbers([]), _numbers([])
        """Of the teammates near, and of the others, where in `_layers` they are."""
        self._changed: Boxes = NO_BOXES
        """Where claims have changed since the last merge."""
        self._merged: _Merged | None = None

    def update(self, robot: int, approximation: Polygons, changed: Boxes | None = None) -> None:
        """Take over the approximation that `robot` has last saved.

        It differs from the one before in the boxes `changed` at most (None: anywhere).
        """
        if robot not in self._slots:
            self._make_room(approximation.shape)
            self._slots[robot] = len(self._slots)
            self._sort_out(self._near)
            changed = None
        if changed is None:
            changed = whole(approximation.shape)
        claims = self._layers[self._slots[robot]]
        drawn = draw_anew(claims, approximation, self._drawing, self._scratch, changed)
        self._changed = united(self._changed, drawn)

    def merged(self, own: Grid, near: Collection[int] | None = None, changed: Boxes | None = None) -> Grid:
        """Return the planning grid of a robot whose self-explored grid is `own`.

        Walls are wide only of the teammates `near` (None: all): what they have just begun to see they will soon
        tell better. `own` differs from the one merged last in the boxes `changed` at most (None: anywhere).

        The grid that is returned is written over by the next call.
        """
        near = self._slots.keys() & (self._slots if near is None else near)
        if near != self._near:
            self._sort_out(near)
            if self._drawing.wide_walls:
                self._changed = whole(own.shape)
        if self._merged is None or changed is None:
            self._merged, changed = _Merged(own, self._drawing.close_slivers), NO_BOXES
            self._changed = whole(own.shape)
        if len(self._changed) or len(changed):
            guesses = self._drawing.wide_walls, self._drawing.close_slivers
            _merge(own, self._layers, *self._rows, *guesses, self._changed, changed, *self._merged.grids)
            self._changed = NO_BOXES
        return self._merged.plan

    def _sort_out(self, near: Set[int]) -> None:
        """Note who is near."""
        self._near = near
        self._rows = (
            _numbers([slot for robot, slot in self._slots.items() if robot in near]),
            _numbers([slot for robot, slot in self._slots.items() if robot not in near]),
        )

    def _make_room(self, shape: tuple[int, int]) -> None:
        """See to it that one more layer fits."""
        held = len(self._slots)
        if not held:
            self._layers, self._scratch = np.zeros((0, *shape), np.uint8), np.zeros(shape, np.uint8)
        if held == len(self._layers):
            more = np.zeros((max(1, 2 * held), *shape), np.uint8)
            more[:held] = self._layers[:held]
            self._layers = more


def _numbers(slots: list[int]) -> NDArray[np.int64]:
    return np.array(slots, np.int64)


class _Merged:
    """What has been merged: the claims of those near and of the others, what they and the robot say, the plan."""

    def __init__(self, own: Grid, close_slivers: bool) -> None:
        near, others, resolved = (np.zeros_like(own) for _ in range(3))
        self.plan = np.zeros_like(own) if close_slivers else resolved
        self.grids = near, others, resolved, self.plan


def rendered(approximation: Polygons, drawing: Drawing = THESIS) -> Grid:
    """Return the grid that one approximation describes by itself."""
    team = TeamMap(drawing)
    team.update(0, approximation)
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
    """

    def __init__(self, drawing: Drawing = THESIS) -> None:
        if drawing.wide_walls or drawing.close_slivers:
            raise ValueError(f"{drawing}: what receivers guess is no error of the approximation")
        self._drawing = drawing
        self._layer: Layer | None = None
        self._scratch: Layer = np.zeros((0, 0), np.uint8)
        self._wrong: NDArray[np.bool_] = np.zeros((0, 0), np.bool_)
        self._count = 0

    def count(
        self,
        own: Grid,
        approximation: Polygons,
        own_changed: Boxes | None = None,
        changed: Boxes | None = None,
    ) -> int:
        """Return the error now; both differ from the last ones in the boxes at most (None: anywhere)."""
        if self._layer is None or changed is None or own_changed is None:
            self._layer = layer(approximation, self._drawing)
            self._wrong, self._scratch = np.zeros(own.shape, np.bool_), np.zeros(own.shape, np.uint8)
            self._count = 0
            boxes = whole(own.shape)
        else:
            boxes = own_changed
            if len(changed):
                drawn = draw_anew(self._layer, approximation, self._drawing, self._scratch, changed)
                boxes = united(boxes, drawn)
        if len(boxes):
            self._count += int(_count_wrong(own, self._layer, boxes, self._wrong))
        return self._count


@kernel("uint8(uint8, uint8, uint8)")
def _strongest(known: int, claim: int, beside_wall: int) -> int:
    """What a cell is by its claims and what the robot knows itself; and beside a wall."""
    cell = OCCUPIED if beside_wall else UNKNOWN
    cell = FREE if claim & FREE_AREA else cell
    cell = OCCUPIED if claim & OUTSIDE_OCCUPIED else cell
    cell = FREE if claim & INSIDE_FREE else cell
    cell = OCCUPIED if claim & INSIDE_OCCUPIED else cell
    return cell if known == UNKNOWN else known


@kernel("int64(uint8[:,::1], uint8[:,::1], int32[:,::1], boolean[:,::1])")
def _count_wrong(own: Grid, claims: Layer, boxes: Boxes, wrong: NDArray[np.bool_]) -> int:
    """Note in some boxes which cells are wrong; how many more there are than before."""
    more = 0
    box = np.empty(4, np.int32)
    for number in range(len(boxes)):
        clip(boxes[number], 0, own.shape, box)
        for y in range(box[1], box[3]):
            for x in range(box[0], box[2]):
                is_wrong = own[y, x] != _strongest(UNKNOWN, claims[y, x], 0)
                more += int(is_wrong) - int(wrong[y, x])
                wrong[y, x] = is_wrong
    return more


@kernel("void(uint8[:,:,::1], int64[::1], int32[::1], uint8[:,::1])")
def _unite(
    layers: NDArray[np.uint8], slots: NDArray[np.int64], box: NDArray[np.int32], claims: Layer
) -> None:
    """Write all claims of some teammates together."""
    x0, x1 = box[0], box[2]
    for y in range(box[1], box[3]):
        together = claims[y, x0:x1]
        together[:] = 0
        for slot in slots:
            row = layers[slot, y, x0:x1]
            for x in range(len(row)):
                together[x] |= row[x]


@kernel("void(uint8[:,::1], uint8[:,::1], uint8[:,::1], boolean, int32[::1], uint8[:,::1])")
def _resolve(
    own: Grid, near: Layer, others: Layer, wide_walls: bool, box: NDArray[np.int32], resolved: Grid
) -> None:
    """Let the strongest claim of each cell count, and what the robot knows itself above all.

    The eight neighbours of walls of those near are beside one, if walls are wide.
    """
    x0, x1 = box[0], box[2]
    height, width = own.shape
    beside = np.zeros(x1 - x0, np.uint8)
    walls = np.zeros(x1 - x0 + 2, np.uint8)
    for y in range(box[1], box[3]):
        if wide_walls:
            left, right = max(x0 - 1, 0), min(x1 + 1, width)
            column = walls[left - x0 + 1 : right - x0 + 1]
            here = near[y, left:right]
            above = near[max(y - 1, 0), left:right]
            below = near[min(y + 1, height - 1), left:right]
            for x in range(len(column)):
                column[x] = (here[x] | above[x] | below[x]) & _WALL
            for x in range(len(beside)):
                beside[x] = walls[x] | walls[x + 1] | walls[x + 2]
        known, out = own[y, x0:x1], resolved[y, x0:x1]
        one, other = near[y, x0:x1], others[y, x0:x1]
        for x in range(len(beside)):
            out[x] = _strongest(known[x], one[x] | other[x], beside[x])


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
    "void(uint8[:,::1], uint8[:,:,::1], int64[::1], int64[::1], boolean, boolean, int32[:,::1], int32[:,::1],"
    " uint8[:,::1], uint8[:,::1], uint8[:,::1], uint8[:,::1])"
)
def _merge(
    own: Grid,
    layers: NDArray[np.uint8],
    near_slots: NDArray[np.int64],
    other_slots: NDArray[np.int64],
    wide_walls: bool,
    close_slivers: bool,
    claims_changed: Boxes,
    own_changed: Boxes,
    near: Layer,
    others: Layer,
    resolved: Grid,
    plan: Grid,
) -> None:
    """Bring all up to date that follows from what has changed."""
    box = np.empty(4, np.int32)
    for number in range(len(claims_changed)):
        clip(claims_changed[number], 0, own.shape, box)
        _unite(layers, near_slots, box, near)
        _unite(layers, other_slots, box, others)
    spread = 1 if wide_walls else 0
    for number in range(len(claims_changed)):
        clip(claims_changed[number], spread, own.shape, box)
        _resolve(own, near, others, wide_walls, box, resolved)
    for number in range(len(own_changed)):
        clip(own_changed[number], 0, own.shape, box)
        _resolve(own, near, others, wide_walls, box, resolved)
    if not close_slivers:
        return
    for number in range(len(claims_changed)):
        clip(claims_changed[number], spread + 1, own.shape, box)
        _close_slivers(own, resolved, box, plan)
    for number in range(len(own_changed)):
        clip(own_changed[number], 1, own.shape, box)
        _close_slivers(own, resolved, box, plan)
