"""The arithmetic coder: what is written is read, in hardly more bits than it is surprising."""

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


def write(said: list[tuple[int, int]], most: int = MOST) -> bytes:
    state, data = writer(ROOM)
    table = counts()
    for context, bit in said:
        code_bit(state, data, table, context, bit, most)
    assert not state[FAILED]
    return written(state, data)


def plain(said: list[tuple[int, int]], most: int = MOST) -> Writer:
    expected = Writer(counts())
    for context, bit in said:
        expected.bit(context, bit, most)
    return expected


@given(bits)
def test_bits_that_are_written_are_read(said: list[tuple[int, int]]) -> None:
    state, data = reader(write(said))
    table = counts()
    assert [code_bit(state, data, table, context, 0, MOST) for context, _ in said] == [bit for _, bit in said]
    check_end(state, "test")


@given(bits, st.integers(2, 5000))
def test_the_message_is_the_plain_coder_s(said: list[tuple[int, int]], most: int) -> None:
    assert write(said, most) == plain(said, most).message()


@pytest.mark.parametrize("chance", [0.5, 0.1, 0.01, 0.001, 0.0, 1.0])
def test_a_message_is_within_3_percent_of_the_ideal_length(chance: float) -> None:
    drawn = np.random.default_rng(7).random(100_000) < chance
    said = [(0, int(bit)) for bit in drawn]
    assert 8 * len(write(said)) <= 1.03 * plain(said).ideal + 8


@given(bits)
def test_a_message_ends_in_the_byte_in_which_its_bits_end(said: list[tuple[int, int]]) -> None:
    assert len(write(said)) <= math.ceil(plain(said).ideal / 8 + 0.01 * len(said) / 8 + 1 / 8)


@given(st.lists(numbers, max_size=40))
def test_numbers_that_are_written_are_read(said: list[int]) -> None:
    state, data = writer(ROOM)
    table = counts()
    for value in said:
        code_signed(state, data, table, 0, value, MOST)
        code_number(state, data, table, NUMBER, abs(value), MOST)
    state, data = reader(written(state, data))
    table = counts()
    for value in said:
        assert code_signed(state, data, table, 0, 0, MOST) == value
        assert code_number(state, data, table, NUMBER, 0, MOST) == abs(value)
    check_end(state, "test")


def test_a_carry_runs_through_all_bytes_that_are_full() -> None:
    for seed in range(200):
        rng = np.random.default_rng(seed)
        said = [(0, 1)] * int(rng.integers(0, 200)) + [(1, int(bit)) for bit in rng.random(60) < 0.9]
        assert write(said) == plain(said).message()


@given(st.binary(max_size=40), st.integers(1, 3000))
def test_noise_is_read_as_something_and_never_beyond_the_end(noise: bytes, decisions: int) -> None:
    state, data = reader(noise)
    table = counts()
    for number in range(decisions):
        assert code_bit(state, data, table, number % NUMBER, 0, MOST) in (0, 1)
    assert len(data) == len(noise) + AHEAD
    assert state[2] <= len(data)


@given(bits, st.binary(min_size=AHEAD + 1, max_size=9))
def test_a_message_that_goes_on_behind_its_bits_is_refused(said: list[tuple[int, int]], more: bytes) -> None:
    state, data = reader(write(said) + more)
    table = counts()
    for context, _ in said:
        code_bit(state, data, table, context, 0, MOST)
    with pytest.raises(ProtocolError, match="does not end behind"):
        check_end(state, "test")


def test_a_message_that_is_cut_off_is_refused() -> None:
    said = [(0, int(bit)) for bit in np.random.default_rng(2).integers(0, 2, 400)]
    state, data = reader(write(said)[: -AHEAD - 1])
    table = counts()
    for context, _ in said:
        code_bit(state, data, table, context, 0, MOST)
    with pytest.raises(ProtocolError, match="does not end behind"):
        check_end(state, "test")


def test_a_writer_without_room_says_so_and_writes_nowhere_else() -> None:
    state, data = writer(8)
    table = counts()
    for bit in np.random.default_rng(1).integers(0, 2, 400).tolist():
        code_bit(state, data, table, 0, bit, MOST)
    assert state[FAILED]
