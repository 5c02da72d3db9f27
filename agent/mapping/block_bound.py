"""The bounded error of copies at half resolution, which take fewer bytes.

In a changed tile, each block of 2 by 2 cells has one state (`agent.mapping.blocks`). Noise moves walls by a cell, which
changes few blocks. A block becomes

- a wall if the robot knows a wall in it that no wall of the copy covers yet,
- else free if it has `LEAST_FREE` free cells, or one that condition 3 or 4 of `agent.mapping.bound` requires,
- and a wall instead of free if it would be a gap that violates condition 5.

These states fulfill the bound almost always. A tile in which they violate it, or close a passage
(`agent.mapping.passages`), gets the resolution of cells: it is *exact*.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from agent.mapping.blocks import BLOCK, block_state, is_covered
from agent.mapping.bound import TILE, Bound, Estimate, borders_unknown, has_wall, shared_state, tile_box
from agent.mapping.estimator import Int8Grid
from agent.mapping.passages import closes_passage
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

LEAST_FREE = 2
"""Free cells from which a block counts as free, although receivers need not know any of them."""

_REMOVE, _MANY_WALLS, _WALLS, _FREE, _CLOSE = range(5)
"""Phases, in this order: remove walls that the robot has not found, add blocks with at least two walls, then those with
one, add free blocks, close gaps."""


@dataclass(frozen=True)
class BlockBound(Bound):
    """The error that a copy at half resolution may have: conditions 4 and 5 are weaker; `tolerance` is at least 1."""

    blocks: bool = field(default=True, init=False)
    openings: tuple[int, ...] = (2,)
    """Widths in cells of the narrowest passages that must stay open, one for each radius of the team's robots."""

    def apply_blocks(
        self,
        own: Grid,
        log_odds: Int8Grid,
        held: Grid,
        tiles: Grid,
        target: Grid,
        changed: Grid,
        exact: Grid,
    ) -> int:
        """Compute the states that receivers shall hold as `apply` does, at half resolution.

        `target` receives the states of the whole grid: passages lead through cells around the marked tiles. `exact`,
        uint8 of shape (tile rows, tile columns), receives 1 for changed tiles that have the resolution of cells, else
        0.
        """
        exact[:] = 0
        np.bitwise_and(held, 3, out=target)
        if not self.apply(own, log_odds, held, tiles, target, changed):
            return 0
        violating, fails = changed.copy(), np.empty_like(changed)
        proposed = np.empty_like(held)
        while True:
            np.bitwise_and(held, 3, out=proposed)
            _propose((own, log_odds, self.settled), held, violating & (1 - exact), proposed)
            self.apply(own, log_odds, proposed, tiles, target, fails)
            for opening in self.openings:
                fails |= _closing(own, target, violating, opening)
            fails &= violating & (1 - exact)
            if not fails.any():
                break
            exact |= fails
        _compare(held, target, tiles, changed)
        exact &= changed
        return int(np.count_nonzero(changed))


@kernel
def _closing(own: Grid, target: Grid, tiles: Grid, opening: int) -> Grid:
    """Return the marked tiles in which the copy closes a passage."""
    closing, box = np.zeros_like(tiles), np.empty(4, np.int64)
    for tile_y in range(tiles.shape[0]):
        for tile_x in range(tiles.shape[1]):
            if tiles[tile_y, tile_x]:
                tile_box(box, own, tile_x, tile_y)
                closing[tile_y, tile_x] = closes_passage(own, target, box, opening)
    return closing


@kernel
def _compare(held: Grid, target: Grid, tiles: Grid, changed: Grid) -> None:
    """Mark the tiles, of some, in which the target differs from the held states."""
    changed[:] = 0
    box = np.empty(4, np.int64)
    for tile_y in range(tiles.shape[0]):
        for tile_x in range(tiles.shape[1]):
            if not tiles[tile_y, tile_x]:
                continue
            tile_box(box, held, tile_x, tile_y)
            for y in range(box[1], box[3]):
                for x in range(box[0], box[2]):
                    changed[tile_y, tile_x] |= held[y, x] & 3 != target[y, x]


@kernel
def _is_invented(estimate: Estimate, target: Grid, x: int, y: int) -> bool:
    """Whether the target has a wall in a cell that is settled as free, and the robot has found none near by."""
    own, log_odds, settled = estimate
    is_free = own[y, x] == FREE and abs(np.int64(log_odds[y, x])) >= settled
    return bool(is_free and target[y, x] == OCCUPIED and not has_wall(own, x, y, 1))


@kernel
def _lacks_wall(estimate: Estimate, target: Grid, x: int, y: int) -> bool:
    """Whether the target needs another wall for the wall that the robot has found in a cell."""
    own, log_odds, settled = estimate
    if own[y, x] != OCCUPIED:
        return False
    if target[y, x] == UNKNOWN and not is_covered(own, target, x, y):
        return True
    return bool(abs(np.int64(log_odds[y, x])) >= settled and not has_wall(target, x, y, 1))


@kernel
def _is_gap(own: Grid, target: Grid, x: int, y: int) -> bool:
    """Whether a free cell of the target, beside an unknown one, lies where the robot has found a wall."""
    is_open = target[y, x] == FREE != own[y, x] and has_wall(own, x, y, 1)
    return bool(is_open and borders_unknown(own, target, x, y))


@kernel
def _next_state(phase: int, estimate: Estimate, target: Grid, left: int, top: int) -> int:
    """Return the state that a phase gives the block at cell (left, top), or -1 if it remains as it is."""
    own = estimate[0]
    removes, lacks, is_gap, may_be_wall, must_be_free = False, False, False, True, False
    walls, free = 0, 0
    for y in range(top, min(top + BLOCK, own.shape[0])):
        for x in range(left, min(left + BLOCK, own.shape[1])):
            walls += own[y, x] == OCCUPIED
            if phase == _REMOVE:
                removes = removes or _is_invented(estimate, target, x, y)
            elif phase in (_MANY_WALLS, _WALLS):
                lacks = lacks or _lacks_wall(estimate, target, x, y)
            elif phase == _CLOSE:
                is_gap = is_gap or _is_gap(own, target, x, y)
                may_be_wall = may_be_wall and (own[y, x] != FREE or has_wall(own, x, y, 1))
            elif target[y, x] == UNKNOWN:
                free += own[y, x] == FREE
                is_shared = shared_state(estimate, x, y) == FREE
                must_be_free = must_be_free or (is_shared and not has_wall(target, x, y, 1))
    if phase == _REMOVE:
        return int(FREE) if removes else -1
    if phase == _FREE:
        return int(FREE) if must_be_free or free >= LEAST_FREE else -1
    is_wall = is_gap and may_be_wall if phase == _CLOSE else lacks and (walls >= 2 or phase == _WALLS)
    return int(OCCUPIED) if is_wall else -1


@kernel
def _propose(estimate: Estimate, held: Grid, tiles: Grid, target: Grid) -> None:
    """Change the blocks of the marked tiles of `target`, which has the held states before.

    A block gets one state, or remains as receivers hold it.
    """
    height, width = held.shape
    for phase in range(_CLOSE + 2):
        for tile_y in range(tiles.shape[0]):
            for tile_x in range(tiles.shape[1]):
                if not tiles[tile_y, tile_x]:
                    continue
                for top in range(tile_y * TILE, min(tile_y * TILE + TILE, height), BLOCK):
                    for left in range(tile_x * TILE, min(tile_x * TILE + TILE, width), BLOCK):
                        if phase > _CLOSE:
                            _unify(held, target, left, top)
                            continue
                        state = _next_state(phase, estimate, target, left, top)
                        if state >= 0:
                            _write(target, left, top, state, phase == _FREE)


@kernel
def _write(target: Grid, left: int, top: int, state: int, unknown_only: bool) -> None:
    """Write a state to the cells of the block at cell (left, top), or only to those that are unknown."""
    for y in range(top, min(top + BLOCK, target.shape[0])):
        for x in range(left, min(left + BLOCK, target.shape[1])):
            if not unknown_only or target[y, x] == UNKNOWN:
                target[y, x] = state


@kernel
def _unify(held: Grid, target: Grid, left: int, top: int) -> None:
    """Give all cells of a block its new state, or their held states if the state of the block remains."""
    state = block_state(target, left // BLOCK, top // BLOCK)
    remains = state == block_state(held, left // BLOCK, top // BLOCK)
    for y in range(top, min(top + BLOCK, target.shape[0])):
        for x in range(left, min(left + BLOCK, target.shape[1])):
            target[y, x] = held[y, x] & 3 if remains else state
