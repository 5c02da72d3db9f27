"""Passages: a copy must not close those that are as wide as the narrowest opening."""

from __future__ import annotations

import numpy as np
import pytest

from agent.mapping.passages import MARGIN, closes_passage
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid

SIDE = 8 + 2 * MARGIN
BOX = np.array([MARGIN, MARGIN, MARGIN + 8, MARGIN + 8])
OPENING = 3


def door(width: int) -> Grid:
    """Return two rooms with a door of some cells between them."""
    grid = np.full((SIDE, SIDE), FREE, np.uint8)
    grid[12] = OCCUPIED
    grid[12, 10 : 10 + width] = FREE
    return grid


def closes(own: Grid, copy: Grid) -> bool:
    """Return whether a copy closes a passage, turned or not."""
    found = {
        bool(closes_passage(*grids, BOX, OPENING)) for grids in ((own, copy), (own.T.copy(), copy.T.copy()))
    }
    assert len(found) == 1
    return found.pop()


@pytest.mark.parametrize("width", range(2, 7))
@pytest.mark.parametrize("remaining", range(1, 7))
def test_a_door_must_stay_as_wide_as_the_narrowest_opening(width: int, remaining: int) -> None:
    is_closed = remaining < min(width, OPENING) and width >= OPENING
    assert closes(door(width), door(min(width, remaining))) == is_closed


def test_a_corridor_must_not_vanish_but_a_niche_may() -> None:
    own = np.full((SIDE, SIDE), OCCUPIED, np.uint8)
    own[11:14] = FREE
    copy = own.copy()
    copy[11] = OCCUPIED
    assert closes(own, copy)
    own[:, :10] = own[:, 14:] = copy[:, :10] = copy[:, 14:] = OCCUPIED
    assert not closes(own, copy)


def test_cells_that_receivers_do_not_know_are_as_the_robot_knows_them() -> None:
    own = door(5)
    copy = np.full_like(own, UNKNOWN)
    copy[12, 10] = OCCUPIED
    assert not closes(own, copy)
    copy[12, 11:13] = OCCUPIED
    assert closes(own, copy)


def test_walls_of_the_robot_itself_close_no_passage() -> None:
    assert not closes(door(0), door(0))
    own = door(0)
    own[12] = UNKNOWN
    copy = door(0)
    assert not closes(own, copy)
