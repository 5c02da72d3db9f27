"""Lines on a serial port: every frame survives, and a damaged stream loses no later frame."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.radios.cobs import LineReader, line, stuff, unstuff

FRAMES = st.lists(st.binary(max_size=300) | st.integers(250, 260).map(lambda n: b"\1" * n), max_size=8)


@given(st.binary(max_size=700))
def test_stuffed_bytes_have_no_zero_and_can_be_restored(data: bytes) -> None:
    assert 0 not in stuff(data)
    assert unstuff(stuff(data)) == data
    assert len(stuff(data)) <= len(data) + max(1, -(-len(data) // 254))


@pytest.mark.parametrize(
    ("data", "stuffed"),
    [
        ("00", "0101"),
        ("0000", "010101"),
        ("00110000", "0102110101"),
        ("11220033", "0311220233"),
        ("11223344", "0511223344"),
        ("11000000", "0211010101"),
        (bytes(range(1, 255)).hex(), "ff" + bytes(range(1, 255)).hex()),
        (bytes(range(255)).hex(), "01ff" + bytes(range(1, 255)).hex()),
        (bytes(range(1, 256)).hex(), "ff" + bytes(range(1, 255)).hex() + "02ff"),
        ((bytes(range(2, 256)) + b"\0").hex(), "ff" + bytes(range(2, 256)).hex() + "0101"),
    ],
)
def test_the_examples_of_the_paper_are_stuffed_as_published(data: str, stuffed: str) -> None:
    assert stuff(bytes.fromhex(data)).hex() == stuffed
    assert unstuff(bytes.fromhex(stuffed)) == bytes.fromhex(data)


@given(st.binary(max_size=300))
def test_any_bytes_are_restored_or_refused(data: bytes) -> None:
    restored = unstuff(data)
    assert restored is None or unstuff(stuff(restored)) == restored


@given(FRAMES, st.integers(0, 2**32 - 1))
def test_frames_arrive_however_the_stream_is_cut(frames: list[bytes], seed: int) -> None:
    rng, reader, arrived = np.random.default_rng(seed), LineReader(300), list[bytes]()
    stream = b"".join(map(line, frames))
    while stream:
        size = int(rng.integers(1, 50))
        arrived += reader.feed(stream[:size])
        stream = stream[size:]
    assert arrived == frames
    assert reader.damaged == 0


@given(st.binary(min_size=1, max_size=80), st.data())
def test_a_damaged_line_is_dropped_and_the_next_one_arrives(frame: bytes, data: st.DataObject) -> None:
    damaged = bytearray(line(frame))
    at = data.draw(st.integers(1, len(damaged) - 2))
    damaged[at] ^= 1 << data.draw(st.integers(0, 7))
    reader = LineReader(300)
    arrived = reader.feed(bytes(damaged) + line(b"next"))
    assert arrived == [b"next"]
    assert reader.damaged >= 1


@given(st.binary(max_size=2000))
def test_a_flood_without_a_frame_is_not_kept(flood: bytes) -> None:
    reader = LineReader(20)
    assert all(len(frame) <= 20 for frame in reader.feed(flood + b"\1" * 10_000))
    assert reader.feed(line(b"next")) == [b"next"]
    assert reader.damaged >= 1


def test_a_frame_that_is_too_long_is_dropped() -> None:
    reader = LineReader(20)
    assert reader.feed(line(b"x" * 21) + line(b"y" * 20)) == [b"y" * 20]
    assert reader.damaged == 1
