"""Mixed predictions of walls: contexts as documented, and a trained model that saves bytes."""

from __future__ import annotations

import numpy as np
import pytest

from agent.predictive.coder import reader, writer, written
from agent.predictive.history import History
from agent.predictive.mixer import INPUTS, Model, mixing_coder, new_model
from agent.predictive.scan_stream import NarrowBand, ScanStream
from agent.predictive.wall_model import CONTEXTS, FAR, NEAR, code_wall, start_model
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, ray_table

HEIGHT, WIDTH = 40, 60


def drawn(seed: int) -> Grid:
    """Draw a grid of unknown, free, and wall cells, with flags above the state."""
    random = np.random.default_rng(seed)
    grid = random.choice((UNKNOWN, FREE, OCCUPIED), (HEIGHT, WIDTH), p=(0.5, 0.3, 0.2))
    flags: Grid = (grid + 4 * random.integers(0, 2, grid.shape)).astype(np.uint8)
    return flags


def plain_contexts(grid: Grid, x: int, y: int) -> list[int]:
    """Contexts of a cell, from a grid with a margin."""
    states = np.pad(grid & 3, FAR)[y : y + 2 * FAR + 1, x : x + 2 * FAR + 1].astype(int)

    def number(*cells: tuple[int, int]) -> int:
        return int("".join(str(states[FAR + row, FAR + column]) for column, row in cells), 3)

    row, column = states[FAR] == OCCUPIED, states[:, FAR] == OCCUPIED
    walls = [int(line.sum() - line[FAR]) for line in (row, column)]
    ranks = [sum(count > limit for limit in (0, 1, 2, 4, 8, 13)) for count in walls]
    rays = row[FAR + 1 :], row[:FAR][::-1], column[FAR + 1 :], column[:FAR][::-1]
    nearest = [int(ray.argmax()) + 1 if ray.any() else 0 for ray in rays]
    distances = 0
    for distance in nearest:
        distances = 5 * distances + min(distance.bit_length(), 4)
    square = states[FAR - NEAR : FAR + NEAR + 1, FAR - NEAR : FAR + NEAR + 1]
    around = number((-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1))
    cross = number((0, 1), (0, -1), (1, 0), (-1, 0))
    behind = number((2, 0), (0, 2), (0, -2), (-2, 0))
    return [
        around,
        (ranks[0] * 7 + ranks[1]) * 81 + cross,
        distances * 9 + number((1, 0), (-1, 0)),
        int((square == FREE).sum()) // 3 * 18 + min(int((square == OCCUPIED).sum()), 17),
        (around * 81 + behind) * 40503 // 8 % CONTEXTS,
        behind * 81 + cross,
    ]


@pytest.mark.parametrize("seed", range(3))
def test_contexts_are_those_of_a_plain_implementation(seed: int) -> None:
    grid, random = drawn(seed), np.random.default_rng(seed)
    model = mixing_coder(*writer(1 << 12), new_model(CONTEXTS, 1))
    for _ in range(300):
        x, y = int(random.integers(WIDTH)), int(random.integers(HEIGHT))
        grid[y, x] &= 4
        code_wall(model, grid, x, y, int(random.integers(2)))
        contexts = model[5][0].tolist()
        assert contexts == plain_contexts(grid, x, y)
        assert max(contexts) < CONTEXTS
    assert len(contexts) == INPUTS


def test_a_receiver_decodes_the_walls_that_an_author_encoded() -> None:
    random = np.random.default_rng(7)
    walls, places = random.integers(0, 2, 500).tolist(), random.integers(0, HEIGHT, (500, 2)).tolist()
    state, data = writer(1 << 12)
    grid = drawn(7)
    author = mixing_coder(state, data, start_model())
    for wall, (x, y) in zip(walls, places, strict=True):
        code_wall(author, grid, x, y, wall)
        grid[y, x] = OCCUPIED if wall else FREE
    receiver, grid = mixing_coder(*reader(written(state, data)), start_model()), drawn(7)
    for wall, (x, y) in zip(walls, places, strict=True):
        assert code_wall(receiver, grid, x, y, 0) == wall
        grid[y, x] = OCCUPIED if wall else FREE
    for one, other in zip(author[2:5], receiver[2:5], strict=True):
        assert np.array_equal(one, other)


def scan_of_a_room(*, narrow: bool, model: Model | None = None) -> bytes:
    """Encode the scans of a robot that crosses a room with two closets."""
    own = np.full((80, 120), UNKNOWN, np.uint8)
    own[10:70, 10:110] = FREE
    own[10, 10:110] = own[69, 10:110] = own[10:70, 10] = own[10:70, 109] = OCCUPIED
    own[30, 10:40] = own[30:50, 60] = OCCUPIED
    scratch, band = np.empty((2 * own.size, 2), np.int32), NarrowBand(5.0, 1000) if narrow else None
    beams = ray_table(50.0, 360)
    stream = ScanStream(0, np.zeros_like(own), beams, [History()], scratch, team=False, narrow=band)
    if model is not None:
        stream.model = model
    update = stream.encode(own, [(20, 45), (80, 20), (80, 60), (30, 20)], (0, 0, 120, 80))
    assert update is not None
    return update[0]


def test_logs_begin_with_a_trained_model_that_saves_bytes() -> None:
    plain, mixed = scan_of_a_room(narrow=False), scan_of_a_room(narrow=True)
    untrained = scan_of_a_room(narrow=True, model=new_model(CONTEXTS, 1))
    assert len(mixed) < 0.8 * len(plain)
    assert len(mixed) < len(untrained)
    assert not np.shares_memory(start_model()[0], start_model()[0])
