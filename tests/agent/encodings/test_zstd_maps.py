"""The `zstd-maps` encoding: the last whole map of each robot counts; malformed data changes nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.encodings.compression import compress
from agent.encodings.zstd_maps import HEAD, INTERVAL, OVERHEAD, VALUES, ZstdMapEncoding
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.errors import ProtocolError
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.packet_codec import encode
from protocol.packets import Save
from protocol.scans import GridChange, Scan, fragments
from tests.agent.encodings.arrival import LATE

WIDTH, HEIGHT = 20, 14
SCAN = Scan(0, 0, np.zeros(36, np.uint16))
CHANGE = GridChange(1, (0, 0, WIDTH, HEIGHT))
seeds = st.integers(0, 2**32 - 1)


def settings_of(robot: int, range_cells: float = 50.0) -> Settings:
    return Settings(
        robot=robot, bodies=(Body(range_cells, 360.0, 1.0),) * 3, width=WIDTH, height=HEIGHT, beams=36, seed=0,
        strategy="meier", encoding=EncodingSettings("zstd-maps"), replication=ReplicationSettings("backoff"),
    )  # fmt: skip


def random_map(seed: int) -> Grid:
    return np.random.default_rng(seed).integers(0, 3, (HEIGHT, WIDTH)).astype(np.uint8)


def empty() -> Grid:
    return np.zeros((HEIGHT, WIDTH), np.uint8)


def record(maker: ZstdMapEncoding, own: Grid, *, delivered: bool = True) -> list[bytes]:
    return maker.encode_changes(own, SCAN, CHANGE, delivered=delivered)


def sent(seed: int) -> list[bytes]:
    """A random map as packets."""
    return record(ZstdMapEncoding(settings_of(0)), random_map(seed))


@given(st.lists(seeds, min_size=1, max_size=4))
def test_the_last_map_of_a_robot_replaces_its_earlier_ones(seen: list[int]) -> None:
    receiver, late = ZstdMapEncoding(settings_of(1)), ZstdMapEncoding(settings_of(1))
    for seed in seen:
        receiver.apply(0, b"".join(sent(seed)), **LATE)
        assert receiver.merge(empty()).tolist() == random_map(seed).tolist()
    late.apply(0, b"".join(packet for seed in seen for packet in sent(seed)), **LATE)
    assert late.merge(empty()).tolist() == random_map(seen[-1]).tolist()


@given(seeds, st.lists(st.integers(0, 8), max_size=10))
def test_fragments_of_any_size_give_the_same_map(seed: int, pieces: list[int]) -> None:
    receiver, packets = ZstdMapEncoding(settings_of(1)), sent(seed) + sent(seed + 1)
    taken = 0
    for piece in [*pieces, len(packets)]:
        receiver.apply(0, b"".join(packets[taken : taken + piece]), **LATE)
        taken += piece
    assert receiver.merge(empty()).tolist() == random_map(seed + 1).tolist()


def test_maps_of_several_robots_are_merged() -> None:
    receiver, left, right = ZstdMapEncoding(settings_of(1)), empty(), empty()
    left[:, :8], right[:, 12:] = FREE, OCCUPIED
    for robot, own in ((0, left), (2, right)):
        receiver.apply(robot, b"".join(record(ZstdMapEncoding(settings_of(robot)), own)), **LATE)
    assert receiver.merge(empty()).tolist() == (left + right).tolist()


def test_a_map_is_sent_every_five_steps_if_it_has_changed() -> None:
    maker, steps = ZstdMapEncoding(settings_of(0)), range(4 * INTERVAL)
    assert [step for step in steps if record(maker, random_map(min(step, INTERVAL)))] == [0, INTERVAL]


def test_a_map_waits_until_teammates_hold_the_last_one() -> None:
    maker = ZstdMapEncoding(settings_of(0))
    assert record(maker, random_map(0), delivered=False) == []
    assert record(maker, random_map(1))
    assert not any(record(maker, random_map(step), delivered=False) for step in range(2, 20))
    assert record(maker, random_map(20))


def packed(values: bytes, size: int | None = None) -> list[bytes]:
    frame = compress(values, 3)
    return fragments((len(frame) if size is None else size).to_bytes(HEAD, "big") + frame)


CELLS = WIDTH * HEIGHT
MALFORMED = {
    "another packet": [encode([Save()])],
    "too few cells": packed(bytes(CELLS - 1)),
    "too many cells": packed(bytes(CELLS + 1)),
    "a bomb": packed(bytes(10**7)),
    "another value": packed(bytes([50] * CELLS)),
    "no zstd": fragments((4).to_bytes(HEAD, "big") + b"nope"),
    "no bytes": fragments(bytes(HEAD)),
    "a frame cut off": fragments((10).to_bytes(HEAD, "big") + compress(bytes(CELLS), 3)[:10]),
    "bytes behind the frame": packed(bytes(CELLS), len(compress(bytes(CELLS), 3)) + 3) + fragments(b"abc"),
    "a length beyond the map": fragments((CELLS + OVERHEAD + 1).to_bytes(HEAD, "big")),
}


@pytest.mark.parametrize("packets", MALFORMED.values(), ids=list(MALFORMED))
def test_malformed_data_is_rejected_and_changes_nothing(packets: list[bytes]) -> None:
    receiver = ZstdMapEncoding(settings_of(1))
    first, second = sent(1), sent(2)
    receiver.apply(0, b"".join([*first, *second[:1]]), **LATE)
    for _ in range(2):
        with pytest.raises(ProtocolError):
            receiver.apply(0, b"".join([*second[1:], *packets]), **LATE)
        assert receiver.merge(empty()).tolist() == random_map(1).tolist()
    receiver.apply(0, b"".join(second[1:]), **LATE)
    assert receiver.merge(empty()).tolist() == random_map(2).tolist()


def test_cells_have_the_values_of_an_occupancy_grid() -> None:
    assert [VALUES[state] for state in (UNKNOWN, FREE, OCCUPIED)] == [-1, 0, 100]


def test_a_map_that_its_author_cannot_have_seen_is_rejected() -> None:
    receiver = ZstdMapEncoding(settings_of(1, range_cells=1.0))
    with pytest.raises(ProtocolError, match="can have observed"):
        receiver.apply(0, b"".join(sent(1)), step=1, sender=0)
    assert not receiver.merge(empty()).any()
