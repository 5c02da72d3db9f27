"""When tiles are sent: once they have stopped changing, or have waited for long, and again after a retraction."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agent.mapping.bound import TILE, Bound, tiles_of
from agent.mapping.estimator import SETTLED
from agent.predictive.history import DecodedUpdate, History
from agent.predictive.narrow_tile_author import NarrowTileAuthor
from agent.predictive.scan_updates import STATE
from agent.predictive.tile_author import (
    ENOUGH_TILES,
    INTERVAL,
    LONGEST_WAIT,
    QUIET_STEPS,
    TileAuthor,
)
from agent.predictive.tile_stream import TileStream
from agent.predictive.urgent_tile_author import (
    FEW_QUIET_STEPS,
    LEAST_CELLS,
    WORTHLESS_LONGEST_WAIT,
    WORTHLESS_QUIET_STEPS,
    UrgentTileAuthor,
)
from protocol.boxes import NO_BOX, Box
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.scans import GridChange, Scan
from tests.agent.mapping.plain_bound import violations

HEIGHT, WIDTH = 60, 76
MAX_UPDATES = 1 + HEIGHT * WIDTH // TILE**2
"""More updates than a step can need: each covers one tile at least."""


def make_stream() -> TileStream:
    scratch = np.empty((2 * HEIGHT * WIDTH, 2), np.int32)
    return TileStream(0, np.zeros((HEIGHT, WIDTH), np.uint8), [History()], scratch, team=False)


class Mapper:
    """A robot that writes an estimate by hand, and the author of its log."""

    def __init__(self, tolerance: int = 1, author: type[TileAuthor] = TileAuthor) -> None:
        self.tolerance = tolerance
        self.author = author(make_stream(), Bound(tolerance, SETTLED))
        self.own: Grid = np.zeros((HEIGHT, WIDTH), np.uint8)
        self.log_odds = np.zeros((HEIGHT, WIDTH), np.int8)
        self.step = 0
        self.stands = False

    def draw(self, box: Box, state: int) -> GridChange:
        """Give all cells of a box a settled state; return the change."""
        x0, y0, x1, y1 = box
        self.own[y0:y1, x0:x1] = state
        self.log_odds[y0:y1, x0:x1] = np.array([0, -40, 40])[state]
        return GridChange((x1 - x0) * (y1 - y0), box)

    def add(self, change: GridChange) -> None:
        """Begin a step, in which the robot drives to another cell unless it stands still."""
        self.step += 1
        self.author.add(Scan(3 if self.stands else self.step % 2, 4, np.empty(0, np.uint16)), change)

    def play(self, change: GridChange | None = None, most: float = math.inf) -> list[DecodedUpdate]:
        """Play a step; return the updates that the author writes, of `most` bytes as the encoding counts them."""
        self.add(change or GridChange(0, NO_BOX))
        updates: list[DecodedUpdate] = []
        if self.author.has_changes and self.author.is_due(self.own, self.log_odds, self.held):
            while most > 0 and (encoded := self.author.encode(self.own, self.log_odds, most)) is not None:
                updates.append(encoded[1])
                most -= len(encoded[0])
        return updates

    def has_news(self, *, delivered: bool) -> bool:
        """Return whether the author has news for teammates."""
        return self.author.has_news(self.own, self.log_odds, self.held, delivered=delivered)

    def retract(self) -> None:
        """Take back the last update, as the encoding does."""
        self.author.retract()
        self.author.stream.histories[0].pop()

    @property
    def held(self) -> Grid:
        """The states that receivers hold."""
        return self.author.stream.grid & np.uint8(STATE)

    def violations(self) -> list[tuple[str, int, int]]:
        return violations(self.own, self.log_odds, self.held, self.tolerance)


LARGE: Box = (0, 0, WIDTH, HEIGHT)
SMALL: Box = (2 * TILE, 2 * TILE, 3 * TILE, 3 * TILE)


def test_many_tiles_are_sent_as_soon_as_they_have_stopped_changing() -> None:
    assert math.prod(tiles_of(HEIGHT, WIDTH)) >= ENOUGH_TILES
    mapper = Mapper()
    sent = [mapper.play(mapper.draw(LARGE, FREE))] + [mapper.play() for _ in range(QUIET_STEPS)]
    assert [len(updates) for updates in sent] == [0] * QUIET_STEPS + [1]
    assert (mapper.held == FREE).all()
    assert not mapper.author.has_changes


def test_with_a_limited_budget_no_ready_tile_waits_for_others() -> None:
    mapper = Mapper(author=UrgentTileAuthor)
    sent = [mapper.play(mapper.draw(SMALL, FREE))] + [mapper.play() for _ in range(FEW_QUIET_STEPS)]
    assert [len(updates) for updates in sent] == [0] * FEW_QUIET_STEPS + [1]
    mapper.play(mapper.draw((0, 0, TILE, TILE), FREE))
    assert not mapper.play()
    assert mapper.play(), "no interval between updates"


def test_with_a_limited_budget_corrections_without_value_wait_until_they_have_not_changed_for_long() -> None:
    mapper = Mapper(author=UrgentTileAuthor)
    for _ in range(FEW_QUIET_STEPS + 1):
        mapper.play(mapper.draw(LARGE, FREE) if mapper.step == 0 else None)
    sent = [mapper.play(mapper.draw((2, 2, 3, 3), OCCUPIED))]
    sent += [mapper.play() for _ in range(WORTHLESS_QUIET_STEPS)]
    assert [len(updates) for updates in sent] == [0] * WORTHLESS_QUIET_STEPS + [1]
    changes = [
        bool(mapper.play(mapper.draw((40, 40, 41, 41), OCCUPIED))) for _ in range(WORTHLESS_LONGEST_WAIT + 1)
    ]
    assert changes.index(True) == WORTHLESS_LONGEST_WAIT


def test_with_a_limited_budget_tiles_of_a_robot_that_stands_still_are_sent_at_once() -> None:
    mapper = Mapper(author=UrgentTileAuthor)
    assert not mapper.play(mapper.draw(SMALL, FREE))
    mapper.stands = True
    mapper.play()
    assert mapper.play(), "before the tile has not changed for enough steps"
    assert mapper.play(mapper.draw((0, 0, TILE, TILE), FREE)), "in the step of the change"


def test_new_cells_are_news_until_teammates_hold_them_and_other_corrections_are_not() -> None:
    mapper = Mapper(author=UrgentTileAuthor)
    mapper.stands = True
    assert not mapper.play() + mapper.play()
    assert not mapper.has_news(delivered=True)
    mapper.add(mapper.draw(LARGE, FREE))
    assert mapper.has_news(delivered=True), "the tiles are not ready yet"
    mapper.play(most=2.0)
    assert mapper.has_news(delivered=True), "there are more tiles than the update has"
    while mapper.has_news(delivered=True):
        assert mapper.play()
    assert mapper.has_news(delivered=False)
    mapper.play()
    assert mapper.play(mapper.draw((2, 2, 3, 3), OCCUPIED))
    assert not mapper.has_news(delivered=False)


def test_with_a_limited_budget_new_cells_are_sent_before_other_corrections() -> None:
    mapper = Mapper(author=UrgentTileAuthor)
    for _ in range(FEW_QUIET_STEPS + 1):
        mapper.play(mapper.draw((0, 0, WIDTH, TILE), FREE) if mapper.step == 0 else None)
    assert mapper.author.urgency is not None and mapper.author.urgency > LEAST_CELLS
    below = (0, 2 * TILE, WIDTH, 4 * TILE)
    mapper.draw((2, 2, WIDTH, 3), OCCUPIED)
    mapper.draw(below, FREE)
    mapper.play(GridChange(1, (0, 0, WIDTH, 4 * TILE)))
    sent = [update for _ in range(WORTHLESS_QUIET_STEPS) for update in mapper.play()]
    assert sent[0].box == below
    assert [(each.box[1], each.box[3]) for each in sent[1:]] == [(2, 3)]
    assert mapper.author.urgency == 0
    assert mapper.violations() == []


def test_with_a_limited_budget_tiles_that_close_a_frontier_are_sent_before_other_corrections() -> None:
    mapper = Mapper(author=UrgentTileAuthor)
    room = (0, TILE, WIDTH, HEIGHT)
    for _ in range(LONGEST_WAIT + FEW_QUIET_STEPS):
        mapper.play(mapper.draw(room, FREE) if mapper.step == 0 else None)
    assert (mapper.held[TILE:] == FREE).all()
    mapper.draw((0, HEIGHT - 3, 4 * TILE, HEIGHT - 2), OCCUPIED)
    mapper.draw((0, TILE, 4 * TILE, TILE + 1), OCCUPIED)
    mapper.play(GridChange(8 * TILE, room))
    sent = [update for _ in range(WORTHLESS_QUIET_STEPS) for update in mapper.play()]
    assert [(each.box[1], each.box[3]) for each in sent] == [(TILE, TILE + 1), (HEIGHT - 3, HEIGHT - 2)]


def test_with_a_limited_budget_complete_tiles_are_sent_before_those_with_a_frontier() -> None:
    mapper = Mapper(author=UrgentTileAuthor)
    part, whole = (0, 0, WIDTH, TILE - 2), (0, 3 * TILE, WIDTH, HEIGHT)
    mapper.draw(part, FREE)
    mapper.draw(whole, FREE)
    mapper.draw((0, 3 * TILE, WIDTH, 3 * TILE + 1), OCCUPIED)
    mapper.play(GridChange(1, LARGE))
    sent = [update for _ in range(2 * FEW_QUIET_STEPS) for update in mapper.play()]
    assert [each.box for each in sent] == [whole, part]


def test_tiles_that_never_stop_changing_are_sent_after_the_longest_wait() -> None:
    mapper = Mapper()
    sent = [bool(mapper.play(mapper.draw(LARGE, FREE))) for _ in range(LONGEST_WAIT + 1)]
    assert sent.index(True) == LONGEST_WAIT


def test_a_few_tiles_wait_for_others() -> None:
    mapper = Mapper()
    sent = [bool(mapper.play(mapper.draw(SMALL, FREE)))]
    sent += [bool(mapper.play()) for _ in range(LONGEST_WAIT + INTERVAL)]
    assert QUIET_STEPS < sent.index(True) <= max(LONGEST_WAIT, INTERVAL)
    assert not mapper.author.has_changes


def test_a_robot_that_stands_still_sends_a_few_tiles_as_soon_as_they_have_stopped_changing() -> None:
    mapper = Mapper()
    mapper.stands = True
    assert not any(mapper.play() for _ in range(INTERVAL))
    sent = [bool(mapper.play(mapper.draw(SMALL, FREE)))] + [bool(mapper.play()) for _ in range(QUIET_STEPS)]
    assert sent == [False] * QUIET_STEPS + [True]


def test_changes_within_the_bound_are_not_sent() -> None:
    mapper = Mapper()
    mapper.draw(LARGE, FREE)
    change = mapper.draw((0, 20, WIDTH, 21), OCCUPIED)
    mapper.play(GridChange(change.cells, LARGE))
    for _ in range(LONGEST_WAIT + INTERVAL):
        mapper.play()
    assert not mapper.author.has_changes
    mapper.draw((0, 20, WIDTH, 21), FREE)
    mapper.draw((0, 21, WIDTH, 22), OCCUPIED)
    assert not mapper.play(GridChange(2 * WIDTH, (0, 20, WIDTH, 22)))
    assert mapper.author.has_changes
    assert not any(mapper.play() for _ in range(LONGEST_WAIT + INTERVAL))
    assert not mapper.author.has_changes


@pytest.mark.parametrize("most", [1, math.inf])
def test_retracted_tiles_are_sent_again(most: float) -> None:
    mapper = Mapper()
    mapper.play(mapper.draw(LARGE, FREE))
    assert not any(mapper.play(most=most) for _ in range(QUIET_STEPS - 1))
    (sent,) = mapper.play(most=most)
    mapper.retract()
    assert not mapper.held[sent.box[1], sent.box[0]]
    for _ in range(INTERVAL * MAX_UPDATES):
        mapper.play(most=most)
    assert (mapper.held == FREE).all()


def test_an_attempt_that_finds_nothing_to_send_does_not_replace_what_a_retraction_restores() -> None:
    mapper = Mapper()
    change = mapper.draw(SMALL, FREE)
    mapper.play(GridChange(change.cells, SMALL))
    for _ in range(QUIET_STEPS):
        mapper.add(GridChange(0, NO_BOX))
    mapper.add(GridChange(1, (40, 40, 41, 41)))
    for _ in range(QUIET_STEPS):
        mapper.add(GridChange(0, NO_BOX))
    assert mapper.author.encode(mapper.own, mapper.log_odds, 1) is not None
    assert mapper.author.encode(mapper.own, mapper.log_odds, 1) is None
    mapper.retract()
    assert not mapper.held.any()
    for _ in range(LONGEST_WAIT + INTERVAL):
        mapper.play()
    assert mapper.violations() == []


def test_free_cells_are_sent_if_the_wall_beside_them_was_removed_later() -> None:
    """A wall at the edge of a tile vouches for cells of the next tile, which stops changing earlier."""
    mapper = Mapper()
    wall = (TILE - 1, 0, TILE, HEIGHT)
    mapper.draw((0, 0, TILE, HEIGHT), FREE)
    mapper.play(mapper.draw(wall, OCCUPIED))
    for _ in range(LONGEST_WAIT + INTERVAL):
        mapper.play()
    mapper.play(mapper.draw((TILE, 0, TILE + 1, HEIGHT), FREE))
    for _ in range(QUIET_STEPS):
        mapper.play(GridChange(HEIGHT, wall))
    mapper.play(mapper.draw(wall, FREE))
    for _ in range(2 * LONGEST_WAIT + INTERVAL):
        mapper.play()
    assert not mapper.author.has_changes
    assert mapper.violations() == []


def test_after_a_restart_the_whole_grid_is_sent_again() -> None:
    mapper = Mapper()
    mapper.play(mapper.draw(LARGE, FREE))
    for _ in range(LONGEST_WAIT):
        mapper.play()
    assert (mapper.held == FREE).all()
    mapper.author.restart(make_stream(), [])
    assert not mapper.held.any()
    for _ in range(LONGEST_WAIT + INTERVAL):
        mapper.play()
    assert (mapper.held == FREE).all()


@pytest.mark.parametrize("most", [5, 40, math.inf])
@pytest.mark.parametrize("tolerance", [0, 1, 2])
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("author", [TileAuthor, UrgentTileAuthor, NarrowTileAuthor])
def test_when_nothing_waits_any_more_the_copy_fulfills_the_bound(
    author: type[TileAuthor], seed: int, tolerance: int, most: float
) -> None:
    """Whatever has changed meanwhile, and been retracted."""
    random, mapper = np.random.default_rng(seed), Mapper(tolerance, author)
    sent = 0
    for _ in range(4):
        for _ in range(30):
            x0, y0 = int(random.integers(WIDTH - 1)), int(random.integers(HEIGHT - 1))
            x1 = min(WIDTH, x0 + int(random.integers(1, 20)))
            y1 = min(HEIGHT, y0 + int(random.integers(1, 20)))
            states = random.choice([UNKNOWN, FREE, OCCUPIED], (y1 - y0, x1 - x0), p=[0.1, 0.8, 0.1])
            mapper.own[y0:y1, x0:x1] = states
            strength = random.integers(1, 40, states.shape)
            mapper.log_odds[y0:y1, x0:x1] = np.array([0, -1, 1])[states] * strength
            updates = mapper.play(GridChange(states.size, (x0, y0, x1, y1)), most)
            sent += len(updates)
            if len(updates) == 1 and random.random() < 0.5:
                mapper.retract()
        for _ in range(10 * MAX_UPDATES):
            if not mapper.author.has_changes:
                break
            mapper.play(most=most)
        assert mapper.violations() == []
    assert sent > 4
