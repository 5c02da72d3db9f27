"""An adaptive binary arithmetic coder in whole numbers.

A message is a number between 0 and 1, written in bytes. Each decision cuts the interval in which it lies in two, in
proportion to how often either outcome has come in its context so far, and keeps one part; a decision that was
expected costs hardly anything. At the end the shortest number inside the interval is written, and who reads takes
zeros for what lies behind it.

The same kernels write and read: `code_bit` returns the outcome that it was given, or that it has read. So what walks
along beams and asks for one decision after the other stands in the code once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from protocol.errors import ProtocolError
from protocol.kernels import kernel

State = NDArray[np.int64]
Counts = NDArray[np.uint16]
Data = NDArray[np.uint8]

LOW, WIDTH, PLACE, SIZE, READS, BROKEN = range(6)
"""What a coder's state holds: the interval's lower end (the reader: how far above it the message lies) and width in
32 bits, the next byte, the bytes there are, whether it reads, and whether it ran out of bytes."""

AHEAD = 4
"""Bytes of the interval; a reader looks so far ahead, and never reads farther beyond the end."""

_TOP = 1 << 32
_LEAST = 1 << 24

NUMBER = 64
"""Contexts that a number takes: whether it is 0, its sign, its length, its bits."""

LONGEST = 24
"""Bits of the largest number."""

_ZERO, _SIGN, _LENGTH, _BITS, _LOW_BITS = 0, 1, 2, 26, 37


def writer(room: int) -> tuple[State, Data]:
    """Return the state of a coder that writes, and `room` bytes to write to."""
    return np.array([0, _TOP - 1, 0, room, 0, 0], np.int64), np.zeros(room, np.uint8)


def reader(message: bytes) -> tuple[State, Data]:
    """Return the state of a coder that reads a message, and the message."""
    data = np.frombuffer(message + bytes(AHEAD), np.uint8).copy()
    first = int.from_bytes(data[:AHEAD].tobytes(), "big")
    return np.array([first, _TOP - 1, AHEAD, len(message), 1, 0], np.int64), data


def written(state: State, data: Data) -> bytes:
    """End a message and return it; the writer must not have run out of room."""
    size = _end(state, data)
    return data[:size].tobytes()


def check_end(state: State, what: str) -> None:
    """Raise ProtocolError unless the message that was read ends where its writer would have ended it."""
    if state[BROKEN] or not state[PLACE] - AHEAD <= state[SIZE] <= state[PLACE]:
        reason = f"the message does not end behind its {state[SIZE]} bytes"
        raise ProtocolError(what, int(min(state[PLACE], state[SIZE])), reason)


@kernel("void(int64[::1], uint8[::1], int64)")
def _put(state: State, data: Data, byte: int) -> None:
    """Write a byte; a carry in it goes into those before."""
    place = state[PLACE]
    if byte > 255:
        before = place - 1
        while data[before] == 255:
            data[before] = 0
            before -= 1
        data[before] += 1
    data[place] = byte & 255
    state[PLACE] = place + 1


@kernel("void(int64[::1], uint8[::1])")
def _shift(state: State, data: Data) -> None:
    """Move the interval on by a byte: write its highest one, or read the next."""
    place = state[PLACE]
    if state[READS]:
        if place >= state[SIZE] + AHEAD:
            state[BROKEN] = 1
            state[LOW] = 0
            return
        state[LOW] = state[LOW] << 8 | np.int64(data[place])
        state[PLACE] = place + 1
        return
    if place >= state[SIZE] - AHEAD:
        state[BROKEN] = 1
        state[LOW] = 0
        return
    _put(state, data, state[LOW] >> 24)
    state[LOW] = state[LOW] << 8 & _TOP - 1


@kernel("int64(int64[::1], uint8[::1], uint16[:,::1], int64, int64, int64)")
def code_bit(state: State, data: Data, counts: Counts, context: int, bit: int, most: int) -> int:
    """Write `bit`, or read a bit and return it.

    Parameters
    ----------
    state, data : as `writer` or `reader` make them
    counts : uint16 array, shape (n, 2)
        How often 0 and 1 have come in each context; moved on by this bit. Both are halved when they are `most`
        together.
    context : int
        A row of `counts`.
    """
    zeros, ones = np.int64(counts[context, 0]), np.int64(counts[context, 1])
    width = state[WIDTH]
    part = (width * (2 * zeros + 1)) // (2 * (zeros + ones) + 2)
    if state[READS]:
        bit = 0 if state[LOW] < part else 1
        if bit:
            state[LOW] -= part
    elif bit:
        state[LOW] += part
    width = width - part if bit else part
    while width < _LEAST:
        width <<= 8
        _shift(state, data)
    state[WIDTH] = width
    counts[context, bit] += 1
    if zeros + ones + 1 >= most:
        counts[context, 0] >>= 1
        counts[context, 1] >>= 1
    return bit


@kernel("int64(int64[::1], uint8[::1])")
def _end(state: State, data: Data) -> int:
    """Write the shortest number inside the interval; return the size of the message."""
    low, last = state[LOW], state[LOW] + state[WIDTH] - 1
    for size in range(AHEAD + 1):
        behind = (np.int64(1) << 32 - 8 * size) - 1
        number = low + behind & ~behind
        if number <= last:
            if size == 0 and number >= _TOP:  # all that is left to write is a carry
                _put(state, data, 256)
                return int(state[PLACE]) - 1
            for _ in range(size):
                _put(state, data, number >> 24)
                number = number << 8 & _TOP - 1
            break
    return int(state[PLACE])


@kernel("int64(int64[::1], uint8[::1], uint16[:,::1], int64, int64, int64)")
def code_number(state: State, data: Data, counts: Counts, context: int, value: int, most: int) -> int:
    """Write a number from 0 on, of `LONGEST` bits at most, or read it: its length, then the bits behind the first.

    `context` is the first of `NUMBER` contexts of its own.
    """
    if not code_bit(state, data, counts, context + _ZERO, 1 if value else 0, most):
        return 0
    length = 0
    while value >> length > 1:
        length += 1
    read = 0
    while read < LONGEST - 1 and code_bit(
        state, data, counts, context + _LENGTH + read, 1 if read < length else 0, most
    ):
        read += 1
    number = 1
    for place in range(read - 1, -1, -1):
        bit = value >> place & 1
        # of numbers up to 15 each bit depends on those before it, of larger ones on its place alone
        row = _BITS + (1 << read) - read - 1 + number - 1 if read <= 3 else _LOW_BITS + place
        number = number << 1 | code_bit(state, data, counts, context + row, bit, most)
    return number


@kernel("int64(int64[::1], uint8[::1], uint16[:,::1], int64, int64, int64)")
def code_signed(state: State, data: Data, counts: Counts, context: int, value: int, most: int) -> int:
    """As `code_number`, with a sign."""
    size = code_number(state, data, counts, context, abs(value), most)
    if size and code_bit(state, data, counts, context + _SIGN, 1 if value < 0 else 0, most):
        return -size
    return size
