"""Channel model: loss, damage, delay and duplication at the given rates, by independent draws."""

from __future__ import annotations

import binascii

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import astuple

from netshaper.channel import (
    DAMAGED,
    LOSS,
    RECEIVED,
    Channel,
    chance_of_damage,
    flip,
    next_bursts,
    with_checksum,
    without_checksum,
)
from netshaper.radio_options import RadioOptions
from protocol import packet_codec, packets

frames = st.lists(st.binary(min_size=1, max_size=40), min_size=1, max_size=4)


def rate(options: RadioOptions, cause: int, size: int = 20) -> float:
    channel, receptions = Channel(options, 1, 5), []
    frame = with_checksum(bytes(size - 3)) if options.sums else bytes(size)
    for step in range(1, 1500):
        channel.next_step(step)
        receptions += channel.carry(step, 0, 0, 0, [frame], [1, 2, 3, 4])
    assert all(len(reception.receivers) == 1 for reception in receptions)
    return sum(reception.cause == cause for reception in receptions) / len(receptions)


def test_a_perfect_channel_delivers_all_at_once() -> None:
    got = Channel(RadioOptions(), 0, 3).carry(1, 0, 0, 0, [b"a", b"b"], [1, 2])
    assert [astuple(each) for each in got] == [([1, 2], [b"a", b"b"], RECEIVED, 0, 1)]


def test_frames_are_lost_at_the_given_rate() -> None:
    assert rate(RadioOptions(loss=0.2), LOSS) == pytest.approx(0.2, abs=0.02)


def test_bursts_have_the_given_length_and_frequency() -> None:
    # With bursts of 10 steps after 30 good steps, links are bad a quarter of the time.
    options = RadioOptions(burst_every=30, burst_steps=10, burst_loss=0.8)
    assert rate(options, LOSS) == pytest.approx(0.25 * 0.8, abs=0.04)
    bad = np.zeros((4, 4), np.bool_)
    rng = np.random.default_rng(0)
    runs, length = [], 0
    for _ in range(6000):
        bad = next_bursts(bad, rng.random((4, 4)), 30, 10)
        assert (bad == bad.T).all()
        assert not bad.diagonal().any()
        if bad[0, 1]:
            length += 1
        elif length:
            runs.append(length)
            length = 0
    assert np.mean(runs) == pytest.approx(10, rel=0.2)


def test_frames_are_damaged_at_the_rate_of_bit_errors() -> None:
    expected = 1 - 0.999 ** (8 * 20)
    assert chance_of_damage(20, 0.001) == pytest.approx(expected)
    assert rate(RadioOptions(bit_errors=0.001), DAMAGED) == pytest.approx(expected, abs=0.02)


@given(frames, st.integers(0, 99), st.integers(0, 2), st.integers(0, 3))
def test_a_robot_s_reception_does_not_depend_on_other_robots(
    frames: list[bytes], seed: int, delay: int, jitter: int
) -> None:
    options = RadioOptions(
        loss=0.3, delay=delay, jitter=jitter, duplication=0.5, bit_errors=0.002, burst_every=3, burst_loss=0.7
    )
    frames = [with_checksum(frame) for frame in frames]
    alone, all_of_them = Channel(options, seed, 4), Channel(options, seed, 4)
    for channel in (alone, all_of_them):
        channel.next_step(1)
    (one,) = alone.carry(1, 0, 0, 0, frames, [2])
    assert all_of_them.carry(1, 0, 0, 0, frames, [1, 2, 3])[1] == one
    assert delay <= one.delay <= delay + jitter
    assert one.copies in (1, 2)
    assert (one.cause == RECEIVED) == (len(one.frames) == len(frames))
    assert one.frames == [without_checksum(frame) for frame in frames[: len(one.frames)]]


def test_frames_are_duplicated_and_delayed_at_the_given_rates() -> None:
    channel = Channel(RadioOptions(duplication=0.25, delay=2, jitter=3), 5, 5)
    receptions = [r for step in range(400) for r in channel.carry(step, 0, 0, 0, [b"x"], [1, 2, 3, 4])]
    assert np.mean([each.copies == 2 for each in receptions]) == pytest.approx(0.25, abs=0.04)
    late = np.bincount([each.delay for each in receptions])
    assert late[:2].sum() == 0
    assert late[2:] == pytest.approx(400, rel=0.2)


@given(st.binary(max_size=60))
def test_a_checksum_is_the_ccitt_one_and_matches_its_frame(frame: bytes) -> None:
    summed = with_checksum(frame)
    assert without_checksum(summed) == frame
    register = 0
    for byte in frame:
        register ^= byte << 8
        for _ in range(8):
            register = register << 1 ^ (0x1021 if register & 0x8000 else 0)
            register &= 0xFFFF
    assert packet_codec.decode(summed[len(frame) :]) == [packets.Check(register)]
    assert register == binascii.crc_hqx(frame, 0)


@given(st.binary(min_size=1, max_size=60), st.integers(0, 2**32 - 1))
def test_a_flipped_bit_is_always_found(frame: bytes, seed: int) -> None:
    summed = with_checksum(frame)
    damaged = flip(summed, 0.0, np.random.default_rng(seed))
    assert len(damaged) == len(summed)
    assert sum((a ^ b).bit_count() for a, b in zip(summed, damaged, strict=True)) == 1
    assert without_checksum(damaged) is None
