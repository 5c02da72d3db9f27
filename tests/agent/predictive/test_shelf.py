"""Shelves: a stream is read once, however many follow it, and again only for those who were told something else."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.predictive.history import History
from agent.predictive.shared_decoder import MOST, CachedReader, SharedDecoderCache
from agent.predictive.stream import Stream
from protocol.grid import FREE, ray_table

SIDE = 9
BEAMS = ray_table(3.0, 12)


class Shelves:
    """A shelf a maker, and how often its stream was begun."""

    def __init__(self, makers: int) -> None:
        self.begun = 0
        self._shelves = [SharedDecoderCache(maker, self.stream) for maker in range(makers)]

    def stream(self, maker: int, histories: Sequence[History]) -> Stream:
        self.begun += 1
        scratch = np.empty((2 * SIDE * SIDE, 2), np.int32)
        return Stream(maker, np.zeros((SIDE, SIDE), np.uint8), BEAMS, histories, scratch, team=True)

    def robot(self) -> tuple[list[CachedReader], list[History]]:
        histories = [History() for _ in self._shelves]
        return [CachedReader(shelf, maker, histories) for maker, shelf in enumerate(self._shelves)], histories


def units(seed: int, count: int) -> list[bytes]:
    """What a robot tells that drives through an empty hall, seeing a part of it at random."""
    rng = np.random.default_rng(seed)
    scratch = np.empty((2 * SIDE * SIDE, 2), np.int32)
    maker = Stream(0, np.zeros((SIDE, SIDE), np.uint8), BEAMS, [History(), History()], scratch, team=True)
    own = np.zeros((SIDE, SIDE), np.uint8)
    said: list[bytes] = []
    while len(said) < count:
        own[rng.random(own.shape) < 0.1] = FREE
        pose = int(rng.integers(SIDE)), int(rng.integers(SIDE))
        unit = maker.encode(own, [pose], (0, 0, SIDE, SIDE))
        if unit is not None:
            said.append(unit[0])
    return said


def test_a_stream_is_read_once_for_all_who_follow_it_each_at_its_own_pace() -> None:
    shelves, said = Shelves(2), units(1, 5)
    robots = [shelves.robot() for _ in range(20)]
    for followers, _ in robots:
        for unit in said:
            assert followers[0].decode(unit) is not None
    first = robots[0][1][0]
    assert shelves.begun == 1
    for followers, histories in robots:
        assert len(histories[0]) == len(said)
        assert all(histories[0].between(n, n + 1)[0] is first.between(n, n + 1)[0] for n in range(len(said)))
        assert followers[0].pose == robots[0][0][0].pose is not None


def test_who_was_told_other_units_reads_them_apart_from_the_beginning() -> None:
    shelves, one, other = Shelves(2), units(1, 4), units(2, 4)
    plain = [shelves.stream(0, [History(), History()]) for _ in range(2)]
    shelves.begun = 0
    robots = [shelves.robot() for _ in range(2)]
    for pair in zip(one, other, strict=True):
        for (followers, _), stream, unit in zip(robots, plain, pair, strict=True):
            heard, alone = followers[0].decode(unit), stream.decode(unit)
            assert heard is not None
            assert alone is not None
            assert heard.places.tolist() == alone.places.tolist()
            assert heard.key == alone.key
    assert shelves.begun == 2
    assert one != other


def test_liars_cost_bounded_memory() -> None:
    shelves = Shelves(2)
    said = {seed: units(seed, 2) for seed in range(3 * MOST)}
    robots = {seed: shelves.robot() for seed in said}
    for number in range(2):
        for seed, (followers, histories) in robots.items():
            assert followers[0].decode(said[seed][number]) is not None
            assert len(histories[0]) == number + 1
    assert shelves.begun > 3 * MOST, "some of the readings had been dropped"
