"""A log is decoded once for all robots of a process, and again only for robots that received other updates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.predictive.history import DecodedUpdate, History
from agent.predictive.scan_stream import ScanStream
from agent.predictive.shared_decoder import MAX_DECODERS, CachedReader, SharedDecoderCache
from protocol.grid import FREE, ray_table

SIDE = 9
BEAMS = ray_table(3.0, 12)


class Caches:
    """A cache per map, and the number of decoders made."""

    def __init__(self, maps: int) -> None:
        self.made = 0
        self._caches = [SharedDecoderCache(map_id, self.stream) for map_id in range(maps)]

    def stream(self, map_id: int, histories: Sequence[History]) -> ScanStream:
        self.made += 1
        scratch = np.empty((2 * SIDE * SIDE, 2), np.int32)
        return ScanStream(map_id, np.zeros((SIDE, SIDE), np.uint8), BEAMS, histories, scratch, team=True)

    def add(self, map_id: int, key: bytes, update: DecodedUpdate) -> None:
        self._caches[map_id].add(key, update)

    def robot(self) -> tuple[list[CachedReader], list[History]]:
        histories = [History() for _ in self._caches]
        return [
            CachedReader(cache, map_id, histories) for map_id, cache in enumerate(self._caches)
        ], histories


def updates(seed: int, count: int) -> list[bytes]:
    """Messages of a robot in an empty hall that observes random cells."""
    return [update.message for update in encoded(seed, count)]


def encoded(seed: int, count: int) -> list[DecodedUpdate]:
    """Updates of this robot, as it knows them."""
    rng = np.random.default_rng(seed)
    scratch = np.empty((2 * SIDE * SIDE, 2), np.int32)
    author = ScanStream(
        0, np.zeros((SIDE, SIDE), np.uint8), BEAMS, [History(), History()], scratch, team=True
    )
    own = np.zeros((SIDE, SIDE), np.uint8)
    sent: list[DecodedUpdate] = []
    while len(sent) < count:
        own[rng.random(own.shape) < 0.1] = FREE
        pose = int(rng.integers(SIDE)), int(rng.integers(SIDE))
        update = author.encode(own, [pose], (0, 0, SIDE, SIDE))
        if update is not None:
            sent.append(update[1])
    return sent


def test_a_log_is_decoded_once_for_all_robots_each_at_its_own_pace() -> None:
    caches, sent = Caches(2), updates(1, 5)
    robots = [caches.robot() for _ in range(20)]
    for readers, _ in robots:
        for update in sent:
            assert readers[0].decode(update) is not None
    first = robots[0][1][0]
    assert caches.made == 1
    for readers, histories in robots:
        assert len(histories[0]) == len(sent)
        assert all(histories[0].between(n, n + 1)[0] is first.between(n, n + 1)[0] for n in range(len(sent)))
        assert readers[0].pose == robots[0][0][0].pose is not None


def test_updates_that_their_author_adds_are_those_of_a_decoder_and_need_none() -> None:
    caches, sent = Caches(2), encoded(3, 6)
    alone = caches.stream(0, [History(), History()])
    caches.made = 0
    readers, _ = caches.robot()
    key = b""
    for update in sent[:4]:
        caches.add(0, key, update)
        key = update.key
    for update in sent:
        received, plain = readers[0].decode(update.message), alone.decode(update.message)
        assert received is not None
        assert plain is not None
        for name in ("places", "states", "before"):
            assert getattr(received, name).tobytes() == getattr(plain, name).tobytes()
        assert (received.box, received.pose, received.key) == (plain.box, plain.pose, plain.key)
    assert caches.made == 1, "the decoder of the last two has decoded the others as well"


def test_other_updates_of_a_byzantine_robot_are_decoded_apart() -> None:
    caches, one, other = Caches(2), updates(1, 4), updates(2, 4)
    plain = [caches.stream(0, [History(), History()]) for _ in range(2)]
    caches.made = 0
    robots = [caches.robot() for _ in range(2)]
    for pair in zip(one, other, strict=True):
        for (readers, _), stream, update in zip(robots, plain, pair, strict=True):
            received, alone = readers[0].decode(update), stream.decode(update)
            assert received is not None
            assert alone is not None
            assert received.places.tolist() == alone.places.tolist()
            assert received.key == alone.key
    assert caches.made == 2
    assert one != other


def test_many_variants_of_a_log_need_bounded_memory() -> None:
    caches = Caches(2)
    sent = {seed: updates(seed, 2) for seed in range(3 * MAX_DECODERS)}
    robots = {seed: caches.robot() for seed in sent}
    for number in range(2):
        for seed, (readers, histories) in robots.items():
            assert readers[0].decode(sent[seed][number]) is not None
            assert len(histories[0]) == number + 1
    assert caches.made > 3 * MAX_DECODERS, "some decoders were dropped and made again"
