"""The tile code: a plain second implementation writes the same bytes, and malformed messages are refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agent.mapping.bound import TILE
from agent.predictive.coder import check_end, reader, writer, written
from agent.predictive.mixer import (
    INPUTS,
    LOGISTIC,
    LOGIT,
    OLDEST,
    RATES,
    MixingCoder,
    Model,
    mixing_coder,
    new_model,
)
from agent.predictive.model_table import packed, unpacked
from agent.predictive.tiles import BOX_BITS, CONTEXTS, SETS, code_tiles, start_model
from protocol.grid import FREE, MAX_SIDE, OCCUPIED, UNKNOWN, Grid
from tests.agent.predictive.junk import count_refused

HEIGHT, WIDTH = 40, 56


class PlainMixer:
    """Logistic mixing with dictionaries, and an arithmetic coder whose lower end is one large number."""

    def __init__(self) -> None:
        self.chances: dict = {}
        self.weights: dict = {}
        self.begin()

    def begin(self) -> None:
        """Begin a message."""
        self.low, self.width, self.shifts, self.ideal = 0, (1 << 32) - 1, 0, 0.0

    def bit(self, weight_set: object, contexts: list, bit: int) -> None:
        """Code a bit in contexts, which may be any hashable values, one for each input."""
        keys = list(enumerate(contexts))
        logits = [int(LOGIT[self.chances.get(key, (1 << 15, 0))[0] // 16]) for key in keys]
        weights = self.weights.setdefault(weight_set, [19661] * len(keys))
        mixed = math.floor(sum(a * b for a, b in zip(logits, weights, strict=True)) / 65536)
        chance = int(LOGISTIC[max(-2048, min(2047, mixed)) + 2048])
        part = self.width // 4096 * (4096 - chance)
        self.ideal -= math.log2((chance if bit else 4096 - chance) / 4096)
        self.low, self.width = (self.low + part, self.width - part) if bit else (self.low, part)
        while self.width < 1 << 24:
            self.low, self.width, self.shifts = self.low << 8, self.width << 8, self.shifts + 1
        error = 4096 * bit - chance
        for index, key in enumerate(keys):
            weights[index] += math.floor(logits[index] * error / 1024)
            old, age = self.chances.get(key, (1 << 15, 0))
            new = old + math.floor(((65535 if bit else 0) - old) * (655360 // (10 * age + 16)) / 65536)
            oldest = 250 if index < INPUTS - 1 else 60
            self.chances[key] = max(16, min(65519, new)), min(oldest, age + 1)

    def message(self) -> bytes:
        """End a message with the shortest number inside the interval."""
        for size in range(5):
            behind = (1 << 32 - 8 * size) - 1
            number = self.low + behind & ~behind
            if number <= self.low + self.width - 1:
                return (number >> 32 - 8 * size).to_bytes(self.shifts + size, "big")
        raise AssertionError("no number of 32 bits lies inside the interval")


def plain_update(mixer: PlainMixer, grid: Grid, target: Grid, last: list[int]) -> bytes:
    """Encode the tiles in which `target` differs, and write them to the grid."""
    mixer.begin()
    differ = grid != target
    tiles = {(y // TILE, x // TILE) for y, x in np.argwhere(differ).tolist()}
    rows, columns = sorted(y for y, _ in tiles), sorted(x for _, x in tiles)
    box = [columns[0], rows[0], columns[-1], rows[-1]]
    for edge in range(4):
        value = box[edge] - last[edge] + (1 << BOX_BITS - 1) if edge < 2 else box[edge] - box[edge - 2]
        bits = f"{value:0{BOX_BITS}b}"
        for place, bit in enumerate(bits):
            before = int("1" + bits[:place], 2)
            coarse = ("edge", edge, "place", place)
            mixer.bit("box", [("edge", edge, min(before, 39)), *[coarse] * (INPUTS - 1)], int(bit))
    last[:] = box

    def state(x: int, y: int) -> int:
        return int(grid[y, x]) if 0 <= x < WIDTH and 0 <= y < HEIGHT else UNKNOWN

    def states(x: int, y: int, *offsets: tuple[int, int]) -> tuple[int, ...]:
        return tuple(state(x + dx, y + dy) for dx, dy in offsets)

    for tile_y in range(box[1], box[3] + 1):
        for tile_x in range(box[0], box[2] + 1):
            cells = grid[tile_y * TILE : tile_y * TILE + TILE, tile_x * TILE : tile_x * TILE + TILE]
            known, walls = int((cells != UNKNOWN).sum()), int((cells == OCCUPIED).sum())

            def flag(dx: int, dy: int, x: int = tile_x, y: int = tile_y) -> int:
                inside = box[0] <= x + dx <= box[2] and y + dy >= box[1]
                return int((y + dy, x + dx) in tiles) if inside else 2

            left, up, right = flag(-1, 0), flag(0, -1), flag(1, -1)
            part = 0 if known == 0 else 3 if known == 64 else 1 if known < 32 else 2
            few = min(walls, 3)
            # contexts of one input must not meet: all of a tile's contexts have a mark of their own
            mixer.bit(
                "tile",
                [
                    ("tile", (part * 4 + few) * 27 + left * 9 + up * 3 + right),
                    ("tile", part * 4 + few),
                    ("tile", left * 9 + up * 3 + right),
                    ("tile", min(known // 4, 16) * 16 + min(walls, 15)),
                    ("tile", part * 9 + left * 3 + up),
                    ("tile", left * 3 + up),
                ],
                int((tile_y, tile_x) in tiles),
            )
            if (tile_y, tile_x) not in tiles:
                continue
            for y in range(tile_y * TILE, tile_y * TILE + TILE):
                for x in range(tile_x * TILE, tile_x * TILE + TILE):
                    now, truth = int(grid[y, x]), int(target[y, x])
                    near = [state(x + dx, y + dy) for dx in range(-3, 4) for dy in range(-3, 4)]
                    before = states(x, y, (-1, 0), (0, -1), (-1, -1), (1, -1))
                    behind = states(x, y, (1, 0), (0, 1), (1, 1), (-1, 1))
                    contexts = [
                        (before, behind),
                        (before, states(x, y, (-2, 0), (0, -2), (1, -2), (-1, -2))),
                        (near.count(FREE) // 3, min(near.count(OCCUPIED), 16)),
                        (states(x, y, (-1, 0), (0, -1), (-2, -1), (2, -1), (1, -1), (-2, 0), (0, -2))),
                        (before, states(x, y, (1, 0), (0, 1), (2, 0), (0, 2))),
                        (y % TILE, x % TILE, states(x, y, (-1, 0), (0, -1))),
                    ]
                    nearest = states(x, y, (-1, 0), (0, -1), (1, 0), (0, 1))
                    known = sum(each != UNKNOWN for each in nearest)
                    differs = [("differs", now, c) for c in contexts]
                    mixer.bit(("differs", now, known), differs, int(now != truth))
                    if now != truth:
                        first = {UNKNOWN: FREE, FREE: OCCUPIED, OCCUPIED: FREE}[now]
                        which = [("which", now, c) for c in contexts]
                        mixer.bit(("which", now, known), which, int(truth == first))
                        grid[y, x] = truth
    return mixer.message()


class Log:
    """Encoder or decoder of a log; without a model, it begins with one that has seen no bits."""

    def __init__(self, model: Model | None = None) -> None:
        self.model = new_model(CONTEXTS, SETS) if model is None else model
        self.last = np.array([3, 2, 0, 0])
        self.grid = np.zeros((HEIGHT, WIDTH), np.uint8)
        self.changes = np.empty((HEIGHT * WIDTH, 2), np.int32)
        self.tiles = np.zeros((HEIGHT // TILE, WIDTH // TILE), np.uint8)

    def code(self, coder: MixingCoder, target: Grid) -> int:
        """Code an update with a coder."""
        return int(code_tiles(coder, self.grid, target, self.tiles, self.last, self.changes))

    def encode(self, target: Grid) -> bytes:
        """Encode an update."""
        differ = (self.grid & 3) != target
        self.tiles[:] = differ.reshape(HEIGHT // TILE, TILE, WIDTH // TILE, TILE).any((1, 3))
        state, data = writer(1 << 14)
        self.code(mixing_coder(state, data, self.model), target)
        return written(state, data)

    def decode(self, message: bytes) -> int:
        """Decode an update; return the number of changed cells."""
        self.tiles[:] = 0
        state, data = reader(message)
        count = self.code(mixing_coder(state, data, self.model), self.grid)
        check_end(state, "update")
        return count


def targets(seed: int, number: int = 12) -> list[Grid]:
    """Return a sequence of grids, in each of which some boxes have changed."""
    random = np.random.default_rng(seed)
    grid, result = np.zeros((HEIGHT, WIDTH), np.uint8), []
    for _ in range(number):
        for _ in range(int(random.integers(1, 4))):
            x, y = int(random.integers(WIDTH - 1)), int(random.integers(HEIGHT - 1))
            box = grid[y : y + int(random.integers(1, 14)), x : x + int(random.integers(1, 14))]
            box[:] = random.choice([UNKNOWN, FREE, OCCUPIED], p=[0.05, 0.75, 0.2], size=box.shape)
        result.append(grid.copy())
    return result


@pytest.mark.parametrize("seed", range(3))
def test_a_plain_implementation_writes_the_same_bytes_and_a_receiver_reads_them(seed: int) -> None:
    author, receiver, mixer = Log(), Log(), PlainMixer()
    plain, last = np.zeros((HEIGHT, WIDTH), np.uint8), [3, 2, 0, 0]
    for target in targets(seed):
        if (plain == target).all():
            continue
        message = author.encode(target)
        assert message == plain_update(mixer, plain, target, last)
        assert len(message) <= mixer.ideal / 8 + 2
        changed = int(((receiver.grid & 3) != target).sum())
        assert receiver.decode(message) == changed
        assert np.array_equal(receiver.grid & 3, target)
        assert np.array_equal(receiver.grid, author.grid)


def test_malformed_messages_are_refused_or_decoded_without_leaving_the_grid() -> None:
    assert count_refused(lambda message: Log().decode(message)) > 250


def test_logs_begin_with_a_trained_model_that_saves_bytes() -> None:
    room = np.full((HEIGHT, WIDTH), UNKNOWN, np.uint8)
    room[4:37, 5:50] = FREE
    room[4, 5:50] = room[36, 5:50] = room[4:37, 5] = room[4:37, 49] = OCCUPIED
    untrained, trained = len(Log().encode(room)), len(Log(start_model()).encode(room))
    assert trained < 0.8 * untrained


def test_a_table_holds_all_of_a_model_that_has_been_trained() -> None:
    log = Log()
    for target in targets(5):
        log.encode(target)
    for before, after in zip(log.model, unpacked(packed(log.model), CONTEXTS, SETS), strict=True):
        assert np.array_equal(before, after)
    assert not np.shares_memory(start_model()[0], start_model()[0])


def test_the_tables_are_those_of_the_formulas() -> None:
    chance = 4096 / (1 + np.exp(-np.arange(-2048, 2048) / 256))
    assert np.abs(LOGISTIC - chance).max() < 12.4 + 0.6  # interpolated and rounded
    assert (np.diff(LOGISTIC) >= 0).all()
    assert (LOGISTIC[LOGIT[1:] + 2048] >= np.arange(1, 4096).clip(max=LOGISTIC[-1])).all()
    assert np.allclose(RATES / 65536, 1 / (np.arange(OLDEST + 1) + 1.6), atol=1e-4)


def test_the_box_of_an_update_may_lie_anywhere_on_the_largest_grid() -> None:
    tiles = -(-MAX_SIDE // TILE)
    assert 2 * tiles <= 1 << BOX_BITS
