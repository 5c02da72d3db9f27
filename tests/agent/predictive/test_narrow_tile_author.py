"""Updates of tiles on narrow media: they fill their limit, the most valuable tiles first."""

from __future__ import annotations

import numpy as np
import pytest

from agent.mapping.bound import TILE, Bound
from agent.mapping.estimator import SETTLED
from agent.predictive.history import DecodedUpdate, History
from agent.predictive.narrow_tile_author import NarrowTileAuthor
from agent.predictive.scan_updates import STATE
from agent.predictive.tile_stream import TileStream
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.scans import GridChange, Scan

HEIGHT, WIDTH = 64, 96


class Robot:
    """A robot that stands still, has seen an area at once, and encodes it."""

    def __init__(self, own: Grid) -> None:
        self.own = own
        self.log_odds = np.array([0, -40, 40], np.int8)[own]
        scratch = np.empty((2 * HEIGHT * WIDTH, 2), np.int32)
        stream = TileStream(0, np.zeros_like(own), [History()], scratch, team=False)
        self.author = NarrowTileAuthor(stream, Bound(1, SETTLED))
        for change in (GridChange(own.size, (0, 0, WIDTH, HEIGHT)), GridChange(0, (0, 0, 0, 0))):
            self.add(change)

    def add(self, change: GridChange) -> None:
        """Begin a step."""
        self.author.add(Scan(40, 30, np.empty(0, np.uint16)), change)

    @property
    def held(self) -> Grid:
        """The states that receivers hold."""
        return self.author.stream.grid & np.uint8(STATE)

    def update(self, most: float) -> tuple[bytes, DecodedUpdate] | None:
        """Return the update of a step."""
        self.add(GridChange(0, (0, 0, 0, 0)))
        if not self.author.is_due(self.own, self.log_odds, self.held):
            return None
        return self.author.encode(self.own, self.log_odds, most)


def rooms(seed: int) -> Grid:
    """Return an area with rugged walls, each tile of which takes some bytes."""
    random = np.random.default_rng(seed)
    own = np.full((HEIGHT, WIDTH), FREE, np.uint8)
    for row in range(4, HEIGHT, 8):
        own[row + random.integers(0, 2, WIDTH), np.arange(WIDTH)] = OCCUPIED
    return own


@pytest.mark.parametrize("most", [20, 40, 80])
@pytest.mark.parametrize("seed", range(3))
def test_full_updates_use_most_of_their_limit_and_never_exceed_it(seed: int, most: int) -> None:
    robot, sizes = Robot(rooms(seed)), []
    while robot.author.is_full or not sizes:
        encoded = robot.update(most)
        assert encoded is not None
        sizes.append(len(encoded[0]))
    assert len(sizes) >= 3
    assert max(sizes) <= most
    assert np.mean(sizes[:-1]) > most - 5
    assert robot.update(most) is None
    assert (robot.held == robot.own).all()


def test_an_update_is_full_only_if_it_leaves_tiles_out() -> None:
    robot = Robot(rooms(0))
    robot.update(40)
    assert robot.author.is_full
    robot.update(10_000)
    assert not robot.author.is_full


def test_a_tile_that_exceeds_the_limit_is_sent_alone() -> None:
    robot = Robot(rooms(1))
    encoded = robot.update(1)
    assert encoded is not None
    box = encoded[1].box
    assert (box[2] - box[0], box[3] - box[1]) == (TILE, TILE)
    assert robot.author.is_full


def test_an_update_that_is_too_short_for_all_tiles_has_those_with_the_most_value_per_byte() -> None:
    robot = Robot(rooms(2))
    robot.own[:, 48:] = FREE
    robot.log_odds[:, 48:] = -40
    encoded = robot.update(15)
    assert encoded is not None
    x = encoded[1].places % WIDTH
    assert (x >= 48).mean() > 0.9


def test_tiles_of_little_value_fill_an_update_but_those_of_no_value_do_not() -> None:
    own = np.full((HEIGHT, WIDTH), FREE, np.uint8)
    own[8 * TILE - 1, :3] = own[:TILE, 40:] = UNKNOWN
    robot = Robot(own)
    assert robot.update(10_000) is not None
    robot.own[8 * TILE - 1, :3] = robot.own[:TILE, 40:] = FREE
    robot.own[30, 20:24] = OCCUPIED
    robot.log_odds[:] = np.array([0, -40, 40], np.int8)[robot.own]
    robot.add(GridChange(robot.own.size, (0, 0, WIDTH, HEIGHT)))
    encoded = robot.update(10_000)
    assert encoded is not None
    assert (robot.held[0] == FREE).all()
    assert (robot.held[8 * TILE - 1] == FREE).all(), "the tile has only three new cells"
    assert (robot.held[30, 20:24] == FREE).all(), "no new cells"
    assert robot.update(10_000) is not None
    assert (robot.held[30, 20:24] == OCCUPIED).any()
