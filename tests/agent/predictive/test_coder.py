"""The arithmetic coder: decoding returns the encoded bits, and messages are close to their entropy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.predictive.coder import (
    AHEAD,
    FAILED,
    NUMBER,
    check_end,
    code_bit,
    code_number,
    code_signed,
    reader,
    writer,
    written,
)
from protocol.errors import ProtocolError
from tests.agent.predictive.plain_predictive import Writer

MOST = 256
ROOM = 1 << 14
bits = st.lists(st.tuples(st.integers(0, 5), st.integers(0, 1)), max_size=400)
numbers = st.integers(-(2**24) + 1, 2**24 - 1) | st.integers(-20, 20)


def counts() -> np.ndarray:
    return np.zeros((2 * NUMBER, 2), np.uint16)


def write(sent: list[tuple[int, int]], most: int = MOST) -> bytes:
    state, data = writer(ROOM)
    table = counts()
    for context, bit in sent:
        code_bit((state, data, table), context, bit, most)
    assert not state[FAILED]
    return written(state, data)


def plain(sent: list[tuple[int, int]], most: int = MOST) -> Writer:
    expected = Writer(counts())
    for context, bit in sent:
        expected.bit(context, bit, most)
    return expected


@given(bits)
def test_decoding_returns_the_encoded_bits(sent: list[tuple[int, int]]) -> None:
    state, data = reader(write(sent))
    table = counts()
    assert [code_bit((state, data, table), context, 0, MOST) for context, _ in sent] == [
        bit for _, bit in sent
    ]
    check_end(state, "test")


@given(bits, st.integers(2, 5000))
def test_a_message_equals_that_of_the_reference_coder(sent: list[tuple[int, int]], most: int) -> None:
    assert write(sent, most) == plain(sent, most).message()


@pytest.mark.parametrize("chance", [0.5, 0.1, 0.01, 0.001, 0.0, 1.0])
def test_a_message_is_within_3_percent_of_the_ideal_length(chance: float) -> None:
    drawn = np.random.default_rng(7).random(100_000) < chance
    sent = [(0, int(bit)) for bit in drawn]
    assert 8 * len(write(sent)) <= 1.03 * plain(sent).ideal + 8


@given(bits)
def test_a_message_ends_in_the_byte_in_which_its_bits_end(sent: list[tuple[int, int]]) -> None:
    assert len(write(sent)) <= math.ceil(plain(sent).ideal / 8 + 0.01 * len(sent) / 8 + 1 / 8)


@given(st.lists(numbers, max_size=40))
def test_decoding_returns_the_encoded_numbers(sent: list[int]) -> None:
    state, data = writer(ROOM)
    table = counts()
    for value in sent:
        code_signed((state, data, table), 0, value, MOST)
        code_number((state, data, table), NUMBER, abs(value), MOST)
    state, data = reader(written(state, data))
    table = counts()
    for value in sent:
        assert code_signed((state, data, table), 0, 0, MOST) == value
        assert code_number((state, data, table), NUMBER, 0, MOST) == abs(value)
    check_end(state, "test")


def test_a_carry_propagates_through_full_bytes() -> None:
    for seed in range(200):
        rng = np.random.default_rng(seed)
        sent = [(0, 1)] * int(rng.integers(0, 200)) + [(1, int(bit)) for bit in rng.random(60) < 0.9]
        assert write(sent) == plain(sent).message()


@given(st.binary(max_size=40), st.integers(1, 3000))
def test_noise_decodes_without_reading_beyond_the_end(noise: bytes, decisions: int) -> None:
    state, data = reader(noise)
    table = counts()
    for number in range(decisions):
        assert code_bit((state, data, table), number % NUMBER, 0, MOST) in (0, 1)
    assert len(data) == len(noise) + AHEAD
    assert state[2] <= len(data)


@given(bits, st.binary(min_size=AHEAD + 1, max_size=9))
def test_a_message_with_trailing_bytes_is_rejected(sent: list[tuple[int, int]], more: bytes) -> None:
    state, data = reader(write(sent) + more)
    table = counts()
    for context, _ in sent:
        code_bit((state, data, table), context, 0, MOST)
    with pytest.raises(ProtocolError, match="does not end with"):
        check_end(state, "test")


def test_a_truncated_message_is_rejected() -> None:
    sent = [(0, int(bit)) for bit in np.random.default_rng(2).integers(0, 2, 400)]
    state, data = reader(write(sent)[: -AHEAD - 1])
    table = counts()
    for context, _ in sent:
        code_bit((state, data, table), context, 0, MOST)
    with pytest.raises(ProtocolError, match="does not end with"):
        check_end(state, "test")


def test_a_full_buffer_is_flagged_and_not_overrun() -> None:
    state, data = writer(8)
    table = counts()
    for bit in np.random.default_rng(1).integers(0, 2, 400).tolist():
        code_bit((state, data, table), 0, bit, MOST)
    assert state[FAILED]
