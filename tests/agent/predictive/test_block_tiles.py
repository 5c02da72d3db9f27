"""The code of tiles at half resolution: receivers read what authors write, and refuse malformed messages."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.mapping.bound import TILE
from agent.predictive import tiles
from agent.predictive.block_tiles import CONTEXTS, SETS, code_block_tiles, start_model, untrained_model
from agent.predictive.coder import check_end, reader, writer, written
from agent.predictive.mixer import MixingCoder, Model, mixing_coder, new_model
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.agent.predictive.junk import count_refused

HEIGHT, WIDTH = 37, 51


class Log:
    """Encoder or decoder of a log; without a model, it begins with one that has seen no bits."""

    def __init__(self, model: Model | None = None) -> None:
        self.model = new_model(CONTEXTS, SETS) if model is None else model
        self.last = np.array([3, 2, 0, 0])
        self.grid = np.zeros((HEIGHT, WIDTH), np.uint8)
        self.changes = np.empty((HEIGHT * WIDTH, 2), np.int32)
        self.tiles, self.exact = np.zeros((2, -(-HEIGHT // TILE), -(-WIDTH // TILE)), np.uint8)

    def code(self, coder: MixingCoder, target: Grid) -> int:
        """Code an update with a coder."""
        buffers = self.tiles, self.exact, self.last
        return int(code_block_tiles(coder, self.grid, target, *buffers, self.changes))

    def encode(self, target: Grid, exact: Grid) -> bytes:
        """Encode the tiles that differ, some of which are exact."""
        rows, columns = np.nonzero((self.grid & 3) != target)
        self.tiles[:] = 0
        self.tiles[rows // TILE, columns // TILE] = 1
        self.exact[:] = exact & self.tiles
        state, data = writer(1 << 14)
        self.code(mixing_coder(state, data, self.model), target)
        return written(state, data)

    def decode(self, message: bytes) -> int:
        """Decode an update; return the number of changed cells."""
        self.tiles[:] = self.exact[:] = 0
        state, data = reader(message)
        count = self.code(mixing_coder(state, data, self.model), self.grid)
        check_end(state, "update")
        return count


def next_target(random: np.random.Generator, grid: Grid, exact: Grid) -> Grid:
    """Return a grid in which some boxes have changed, cell by cell in exact tiles, in others by blocks."""
    cells, result = grid & np.uint8(3), (grid & np.uint8(3)).copy()
    for _ in range(int(random.integers(1, 4))):
        x, y = int(random.integers(WIDTH)), int(random.integers(HEIGHT))
        box = result[y : y + int(random.integers(1, 14)), x : x + int(random.integers(1, 14))]
        box[:] = random.choice([UNKNOWN, FREE, OCCUPIED], p=[0.05, 0.75, 0.2], size=box.shape)
    for y in range(0, HEIGHT, 2):
        for x in range(0, WIDTH, 2):
            if not exact[y // TILE, x // TILE]:
                before, block = cells[y : y + 2, x : x + 2], result[y : y + 2, x : x + 2]
                states = [OCCUPIED if (each == OCCUPIED).any() else each.max() for each in (before, block)]
                block[:] = before if states[0] == states[1] else states[1]
    return result


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_receivers_read_what_authors_write(seed: int, share: float) -> None:
    random, author, receiver = np.random.default_rng(seed), Log(start_model()), Log(start_model())
    for _ in range(5):
        exact = (random.random(author.tiles.shape) < share).astype(np.uint8)
        target = next_target(random, author.grid, exact)
        changed = int(((receiver.grid & 3) != target).sum())
        if changed:
            message = author.encode(target, exact)
            assert receiver.decode(message) == changed
            assert np.array_equal(receiver.exact, author.exact)
            assert np.array_equal(receiver.grid & 3, target)
            assert np.array_equal(receiver.grid, author.grid)


def test_malformed_messages_are_refused_or_decoded_without_leaving_the_grid() -> None:
    assert count_refused(lambda message: Log().decode(message)) > 250


def drawn_room() -> Grid:
    """Return a room whose walls are blocks."""
    room = np.full((HEIGHT, WIDTH), UNKNOWN, np.uint8)
    room[4:36, 4:48] = FREE
    room[4:6, 4:48] = room[34:36, 4:48] = room[4:36, 4:6] = room[4:36, 46:48] = OCCUPIED
    return room


def test_the_trained_model_and_blocks_save_bytes() -> None:
    room, cells = drawn_room(), np.zeros_like(Log().tiles)
    trained = len(Log(start_model()).encode(room, cells))
    assert trained < 0.8 * len(Log(untrained_model()).encode(room, cells))
    assert trained < 0.8 * len(Log(start_model()).encode(room, cells + np.uint8(1)))


def test_an_untrained_model_knows_the_tiles_of_cells() -> None:
    for array, known in zip(untrained_model(), tiles.start_model(), strict=True):
        assert np.array_equal(array[tuple(slice(size) for size in known.shape)], known)
    assert not np.shares_memory(start_model()[0], start_model()[0])
