"""The `cells` encoding: patches of changed cells, in the shorter compression; malformed patches change nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.encodings.cells import RUNS, SAME, ZSTD, CellEncoding, pack, pack_runs, unpack, unpack_runs
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.errors import ProtocolError
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.packet_codec import encode
from protocol.packets import Fragment, Save
from protocol.scans import GridChange, Scan
from tests.agent.encodings.arrival import LATE

WIDTH, HEIGHT = 40, 30
seeds = st.integers(0, 2**32 - 1)


def settings_of(robot: int) -> Settings:
    return Settings(
        robot=robot, bodies=(Body(6.0, 360.0, 1.0),) * 3, width=WIDTH, height=HEIGHT, beams=36, seed=0,
        strategy="meier", encoding=EncodingSettings("cells"), replication=ReplicationSettings("gossip"),
    )  # fmt: skip


def changed(rng: np.random.Generator, own: Grid) -> GridChange:
    """Change a box of a grid at random, back to unknown too."""
    x0, y0 = int(rng.integers(WIDTH - 1)), int(rng.integers(HEIGHT - 1))
    x1, y1 = int(rng.integers(x0 + 1, WIDTH + 1)), int(rng.integers(y0 + 1, HEIGHT + 1))
    box = own[y0:y1, x0:x1]
    which = rng.random(box.shape) < rng.choice([0.02, 0.9])
    box[which] = rng.integers(0, 3) if rng.random() < 0.5 else rng.integers(0, 3, box.shape)[which]
    return GridChange(box.size, (x0, y0, x1, y1))


NO_SCAN = Scan(0, 0, np.zeros(36, np.uint16))


@given(seeds)
def test_receivers_hold_the_authors_grid_whenever_all_patches_are_delivered(seed: int) -> None:
    rng = np.random.default_rng(seed)
    maker, receiver = CellEncoding(settings_of(0)), CellEncoding(settings_of(1))
    own = np.zeros((HEIGHT, WIDTH), np.uint8)
    nothing = np.zeros_like(own)
    for _ in range(6):
        delivered = bool(rng.random() < 0.6)
        packets = maker.encode_changes(own, NO_SCAN, changed(rng, own), delivered=delivered)
        cut = int(rng.integers(0, len(packets) + 1))
        receiver.apply(0, b"".join(packets[:cut]), **LATE)
        receiver.apply(0, b"".join(packets[cut:]), **LATE)
        if delivered:
            assert (receiver.merge(nothing) == own).all()
        else:
            assert not packets


def test_reports_take_precedence_on_the_shared_map_and_sight_completes_it() -> None:
    maker, receiver = CellEncoding(settings_of(0)), CellEncoding(settings_of(1))
    own = np.zeros((HEIGHT, WIDTH), np.uint8)
    own[3, 4:9] = OCCUPIED
    receiver.apply(
        0, b"".join(maker.encode_changes(own, NO_SCAN, GridChange(5, (4, 3, 9, 4)), delivered=True)), **LATE
    )
    sight = np.zeros_like(own)
    sight[3, 7:12] = FREE
    expected = own.copy()
    expected[3, 9:12] = FREE
    assert (receiver.shared_map(sight, receiver.merge(sight)) == expected).all()
    assert receiver.merge(sight)[3, 7] == FREE


def test_unchanged_cells_are_not_sent_and_the_self_explored_grid_takes_precedence() -> None:
    maker, receiver = CellEncoding(settings_of(0)), CellEncoding(settings_of(1))
    own = np.zeros((HEIGHT, WIDTH), np.uint8)
    own[3, 4:9] = OCCUPIED
    change = GridChange(5, (4, 3, 9, 4))
    packets = maker.encode_changes(own, NO_SCAN, change, delivered=True)
    assert packets
    assert maker.encode_changes(own, NO_SCAN, change, delivered=True) == []
    receiver.apply(0, b"".join(packets), **LATE)
    mine = np.zeros_like(own)
    mine[3, 4] = FREE
    assert receiver.merge(mine)[3, 3:7].tolist() == [UNKNOWN, FREE, OCCUPIED, OCCUPIED]


@given(seeds, st.sampled_from((0.01, 0.3, 1.0)))
def test_a_patch_is_read_as_it_was_written_in_the_shorter_way(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    patch = np.where(rng.random((9, 17)) < share, rng.integers(1, 4, (9, 17)), SAME).astype(np.uint8)
    if rng.random() < 0.5:
        patch = np.tile(patch[:3], (3, 1))
    data = pack(5, 6, patch)
    x0, y0, read, rest = unpack(data + b"more", (HEIGHT, WIDTH)) or (0, 0, patch, b"")
    assert (x0, y0, rest) == (5, 6, b"more")
    assert (read == patch).all()
    assert data[0] in (RUNS, ZSTD)
    assert len(data) <= len(pack_runs(patch)) + 8
    for cut in range(len(data)):
        assert unpack(data[:cut], (HEIGHT, WIDTH)) is None


def test_the_patch_in_the_document_is_the_codes() -> None:
    text = (Path(__file__).parents[3] / "docs" / "protocol.md").read_text(encoding="utf-8")
    sent = text.partition("```patch\n")[2].partition("   ")[0]
    patch = np.array([[OCCUPIED] * 3, [FREE] * 3], np.uint8) + np.uint8(1)
    assert encode([Fragment(pack(5, 2, patch))]) == bytes.fromhex(sent)


def test_both_ways_of_packing_are_used() -> None:
    few = np.zeros((20, 20), np.uint8)
    few[3, 4] = 2
    comb = np.tile(np.array([1, 2], np.uint8), (20, 10))
    assert [pack(0, 0, patch)[0] for patch in (few, comb)] == [RUNS, ZSTD]


MALFORMED = {
    "another way": bytes([7, 0, 0, 1, 1, 1, 1]),
    "cells outside": bytes([RUNS, WIDTH - 1, 0, 2, 1, 1, 2]),
    "no cells": bytes([RUNS, 0, 0, 0, 1, 0]),
    "more bytes than cells": bytes([RUNS, 0, 0, 2, 1, 3, 1, 1, 1]),
    "a number without end": bytes([RUNS, 255, 255, 255, 255, 255]),
    "too few cells": bytes([RUNS, 0, 0, 4, 1, 1, 3]),
    "too many cells": bytes([RUNS, 0, 0, 4, 1, 1, 63]),
    "no zstd": bytes([ZSTD, 0, 0, 9, 9, 4]) + b"nope",
}


@pytest.mark.parametrize("wrong", MALFORMED)
def test_a_malformed_patch_is_rejected_and_changes_nothing(wrong: str) -> None:
    receiver, nothing = CellEncoding(settings_of(1)), np.zeros((HEIGHT, WIDTH), np.uint8)
    patch = pack(0, 0, np.full((2, 2), OCCUPIED + 1, np.uint8))
    with pytest.raises(ProtocolError):
        receiver.apply(0, b"".join([encode([Fragment(patch + MALFORMED[wrong])])]), **LATE)
    assert not receiver.merge(nothing).any()
    with pytest.raises(ProtocolError):
        receiver.apply(0, encode([Save()]), **LATE)
    receiver.apply(0, encode([Fragment(patch)]), **LATE)
    assert receiver.merge(nothing)[:2, :2].all()


def test_rejected_frames_do_not_count_as_entries_of_their_author() -> None:
    # Robot 2 forges two patches of robot 0 in step 5. Robot 0 can have seen the first area by then, but not the second.
    receiver, cell = CellEncoding(settings_of(1)), np.full((1, 1), FREE + 1, np.uint8)
    forged = encode([Fragment(pack(0, 0, cell))]) + encode([Fragment(pack(WIDTH - 1, HEIGHT - 1, cell))])
    for _ in range(30):
        with pytest.raises(ProtocolError, match="its author can have observed"):
            receiver.apply(0, forged, step=5, sender=2)
    own = np.full((HEIGHT, WIDTH), FREE, np.uint8)
    everything = GridChange(own.size, (0, 0, WIDTH, HEIGHT))
    packets = CellEncoding(settings_of(0)).encode_changes(own, NO_SCAN, everything, delivered=True)
    receiver.apply(0, b"".join(packets), step=25, sender=0)
    assert (receiver.merge(np.zeros_like(own)) == own).all()


@given(st.binary(max_size=40))
def test_any_bytes_are_a_patch_inside_the_grid_or_none(data: bytes) -> None:
    try:
        read = unpack(data, (HEIGHT, WIDTH))
    except ProtocolError:
        return
    if read is not None:
        x0, y0, patch, rest = read
        assert x0 + patch.shape[1] <= WIDTH
        assert y0 + patch.shape[0] <= HEIGHT
        assert patch.max() <= OCCUPIED + 1
        assert data.endswith(rest)


@given(seeds)
def test_runs_of_any_length_come_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    patch = np.repeat(rng.integers(0, 4, 6), rng.choice([1, 63, 64, 127, 128, 5000], 6)).astype(np.uint8)
    assert (unpack_runs(pack_runs(patch), len(patch)) == patch).all()
