"""Streams of tiles: the bound holds at every receiver after arbitrary sequences of noisy grids."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.mapping.block_bound import BlockBound
from agent.mapping.bound import Bound, tiles_of
from agent.mapping.estimator import SETTLED
from agent.predictive.history import History
from agent.predictive.scan_updates import REPORTED, STATE
from agent.predictive.tile_stream import BlockTileStream, TileStream
from protocol.errors import ProtocolError
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.mapping.plain_bound import violations

HEIGHT, WIDTH = 42, 37
MAPS = 3
BOUND = Bound(1, SETTLED)


class Side:
    """All streams, as one robot holds them."""

    def __init__(self, maps: int = MAPS, *, team: bool = True, blocks: bool = False) -> None:
        self.histories = [History() for _ in range(maps)]
        scratch = np.empty((2 * HEIGHT * WIDTH, 2), np.int32)
        grids = np.zeros((maps, HEIGHT, WIDTH), np.uint8)
        kind = BlockTileStream if blocks else TileStream
        self.streams = [kind(n, grids[n], self.histories, scratch, team=team) for n in range(maps)]

    def copy(self, map_id: int) -> Grid:
        """The states that this robot holds of a map."""
        return self.streams[map_id].grid & np.uint8(STATE)


def disturb(random: np.random.Generator, own: Grid, log_odds: NDArray[np.int8]) -> tuple[int, int, int, int]:
    """Replace a box of an estimate by noise; return the box."""
    x0, y0 = int(random.integers(WIDTH - 1)), int(random.integers(HEIGHT - 1))
    x1, y1 = min(WIDTH, x0 + int(random.integers(1, 16))), min(HEIGHT, y0 + int(random.integers(1, 16)))
    shape = (y1 - y0, x1 - x0)
    states = random.choice([UNKNOWN, FREE, OCCUPIED], shape, p=[0.2, 0.7, 0.1]).astype(np.uint8)
    own[y0:y1, x0:x1] = states
    log_odds[y0:y1, x0:x1] = np.array([0, -1, 1])[states] * random.integers(1, 40, shape)
    return x0, y0, x1, y1


@pytest.mark.parametrize(("tolerance", "blocks"), [(0, False), (1, False), (2, False), (1, True), (2, True)])
@pytest.mark.parametrize("team", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_the_bound_holds_at_every_receiver_after_every_update(
    seed: int, team: bool, tolerance: int, blocks: bool
) -> None:
    random, bound = np.random.default_rng(seed), (BlockBound if blocks else Bound)(tolerance, SETTLED)
    authors = [Side(team=team, blocks=blocks) for _ in range(MAPS)]
    own = np.zeros((MAPS, HEIGHT, WIDTH), np.uint8)
    log_odds = np.zeros((MAPS, HEIGHT, WIDTH), np.int8)
    tiles = np.zeros((MAPS, *tiles_of(HEIGHT, WIDTH)), np.uint8)
    sent = 0
    for _ in range(40):
        map_id = int(random.integers(MAPS))
        author = authors[map_id]
        for _ in range(int(random.integers(4))):
            tiles[map_id][bound.tiles_near(disturb(random, own[map_id], log_odds[map_id]))] = 1
        stream = author.streams[map_id]
        pose = int(random.integers(WIDTH)), int(random.integers(HEIGHT))
        before = stream.grid.copy()
        size = stream.size(own[map_id], log_odds[map_id], bound, tiles[map_id], pose)
        assert np.array_equal(stream.grid, before)
        encoded = stream.encode(own[map_id], log_odds[map_id], bound, tiles[map_id], pose)
        assert size == (len(encoded[0]) if encoded is not None else 0)
        tiles[map_id] = 0
        if encoded is not None:
            stream.commit()
            for box in stream.bases:
                tiles[map_id][bound.tiles_near(box)] = 1
            sent += 1
            for receiver in range(MAPS):
                if receiver != map_id:
                    assert authors[receiver].streams[map_id].decode(encoded[0]) is not None
                    authors[receiver].streams[map_id].commit()
                    assert np.array_equal(authors[receiver].copy(map_id), author.copy(map_id))
                    assert authors[receiver].streams[map_id].pose == pose
        if not tiles[map_id].any():
            assert (
                violations(own[map_id], log_odds[map_id], author.copy(map_id), tolerance, blocks=blocks) == []
            )
    assert sent > 20


def room(side: Side, map_id: int, bound: Bound = BOUND) -> tuple[bytes, Grid]:
    """Encode a room with walls, and return the message and the grid."""
    own = np.zeros((HEIGHT, WIDTH), np.uint8)
    own[8:30, 8:30], own[[8, 29], 8:30] = FREE, OCCUPIED
    log_odds = np.array([0, -40, 40], np.int8)[own]
    tiles = np.ones(tiles_of(HEIGHT, WIDTH), np.uint8)
    encoded = side.streams[map_id].encode(own, log_odds, bound, tiles, (10, 10))
    assert encoded is not None
    return encoded[0], own


def test_a_robot_that_sees_the_same_as_a_teammate_sends_a_few_bytes() -> None:
    author = Side()
    first, _ = room(author, 0)
    second, own = room(author, 1)
    assert len(second) < len(first) / 2
    receiver = Side()
    assert receiver.streams[1].decode(second) is None
    assert receiver.streams[0].decode(first) is not None
    update = receiver.streams[1].decode(second)
    assert update is not None
    assert len(update.places) == 0
    assert np.array_equal(receiver.copy(1), own)


def test_a_rolled_back_update_leaves_no_trace() -> None:
    author = Side()
    room(author, 0)
    author.streams[0].rollback()
    author.histories[0].pop()
    assert not author.copy(0).any()
    assert author.streams[0].pose is None
    assert room(author, 0)[0] == room(Side(), 0)[0]


def test_a_receiver_marks_the_cells_that_the_author_has_reported() -> None:
    author, receiver = Side(), Side()
    message, own = room(author, 0)
    assert receiver.streams[0].decode(message) is not None
    assert np.array_equal(receiver.streams[0].grid & REPORTED != 0, own != UNKNOWN)


@pytest.mark.parametrize("bound", [BOUND, BlockBound(1, SETTLED)])
def test_malformed_updates_are_refused_and_change_nothing(bound: Bound) -> None:
    random, refused = np.random.default_rng(2), 0
    message, _ = room(Side(blocks=bound.blocks), 0, bound)
    side = Side(1, team=False, blocks=bound.blocks)
    for size in random.integers(0, 60, 200).tolist():
        damaged = bytearray(message[: len(message) // 2] + random.bytes(size))
        before = side.streams[0].grid.copy()
        try:
            side.streams[0].decode(bytes(damaged))
        except ProtocolError:
            refused += 1
            assert np.array_equal(side.streams[0].grid, before)
            assert len(side.histories[0]) == 0
        else:
            side.streams[0].rollback()
            side.histories[0].pop()
    assert refused > 150
