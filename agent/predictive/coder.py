"""An adaptive binary arithmetic coder with integer arithmetic (Witten, Neal and Cleary 1987; carries as in LZMA).

A message is a number between 0 and 1. Each coded bit divides the current interval in two parts, in proportion to the
counts of 0 and 1 in its context, and keeps one of them; a likely bit takes a small fraction of a bit. The message ends
with the shortest number inside the final interval, and the decoder reads zeros behind it.

The same kernels encode and decode: `code_bit` returns the bit that it was given, or the bit that it has decoded. So
the code that walks along beams exists once.
"""

from __future__ import annotations

import numpy as np

from protocol.arrays import Int64s, Uint8s, Uint16Rows
from protocol.errors import ProtocolError
from protocol.kernels import kernel

State = Int64s
Counts = Uint16Rows
Data = Uint8s
Coder = tuple[State, Data, Counts]
"""State and buffer, from `writer` or `reader`, and the counts of 0 and 1 in each context, shape (n, 2)."""

LOW, WIDTH, PLACE, SIZE, DECODES, FAILED = range(6)
"""Indices of a coder's state: the lower end of the interval (decoder: offset of the message from it) and its width, in
32 bits each; the position of the next byte; the size of the buffer; whether it decodes; whether it ran out of bytes."""

AHEAD = 4
"""Bytes of the interval; a decoder reads at most this many bytes behind the end of the message."""

_TOP = 1 << 32
_LEAST = 1 << 24

NUMBER = 64
"""Contexts of a number: whether it is 0, its sign, its length, its bits."""

LONGEST = 24
"""Bits of the largest number."""

_ZERO, _SIGN, _LENGTH, _BITS, _LOW_BITS = 0, 1, 2, 26, 37


def writer(size: int) -> tuple[State, Data]:
    """Return the state of an encoder, and its output buffer of `size` bytes."""
    return np.array([0, _TOP - 1, 0, size, 0, 0], np.int64), np.zeros(size, np.uint8)


def reader(message: bytes) -> tuple[State, Data]:
    """Return the state of a decoder of a message, and its input buffer."""
    data = np.frombuffer(message + bytes(AHEAD), np.uint8).copy()
    first = int.from_bytes(data[:AHEAD].tobytes(), "big")
    return np.array([first, _TOP - 1, AHEAD, len(message), 1, 0], np.int64), data


def written(state: State, data: Data) -> bytes:
    """End a message and return it; the output buffer must not have overflowed."""
    size = _end(state, data)
    return data[:size].tobytes()


def check_end(state: State, packet: str) -> None:
    """Raise ProtocolError unless the decoded message ends where its encoder would have ended it."""
    if state[FAILED] or not state[PLACE] - AHEAD <= state[SIZE] <= state[PLACE]:
        reason = f"the coded content does not end with the {state[SIZE]} bytes of the message"
        raise ProtocolError(packet, int(min(state[PLACE], state[SIZE])), reason)


@kernel
def _put(state: State, data: Data, byte: int) -> None:
    """Write a byte, and propagate its carry into the bytes before."""
    place = state[PLACE]
    if byte > 255:
        before = place - 1
        while data[before] == 255:
            data[before] = 0
            before -= 1
        data[before] += 1
    data[place] = byte & 255
    state[PLACE] = place + 1


@kernel
def _shift(state: State, data: Data) -> None:
    """Shift the interval by a byte: write its highest byte, or read the next."""
    place = state[PLACE]
    if state[DECODES]:
        if place >= state[SIZE] + AHEAD:
            state[FAILED] = 1
            state[LOW] = 0
            return
        state[LOW] = state[LOW] << 8 | np.int64(data[place])
        state[PLACE] = place + 1
        return
    if place >= state[SIZE] - AHEAD:
        state[FAILED] = 1
        state[LOW] = 0
        return
    _put(state, data, state[LOW] >> 24)
    state[LOW] = state[LOW] << 8 & _TOP - 1


@kernel
def divide(state: State, data: Data, part: int, bit: int) -> int:
    """Encode `bit`, or decode a bit, for which 0 takes the first `part` of the interval; return it."""
    width = state[WIDTH]
    if state[DECODES]:
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
    return bit


@kernel
def code_bit(coder: Coder, context: int, bit: int, most: int) -> int:
    """Encode `bit`, or decode a bit, in a context, a row of the counts; return it.

    The counts are updated with this bit; both are halved when their sum reaches `most`.
    """
    state, data, counts = coder
    zeros, ones = np.int64(counts[context, 0]), np.int64(counts[context, 1])
    part = (state[WIDTH] * (2 * zeros + 1)) // (2 * (zeros + ones) + 2)
    bit = divide(state, data, part, bit)
    counts[context, bit] += 1
    if zeros + ones + 1 >= most:
        counts[context, 0] >>= 1
        counts[context, 1] >>= 1
    return bit


@kernel
def _end(state: State, data: Data) -> int:
    """Write the shortest number inside the interval; return the size of the message in bytes."""
    low, last = state[LOW], state[LOW] + state[WIDTH] - 1
    for size in range(AHEAD + 1):
        behind = (np.int64(1) << 32 - 8 * size) - 1
        number = low + behind & ~behind
        if number <= last:
            if size == 0 and number >= _TOP:  # only a carry is left to write
                _put(state, data, 256)
                return int(state[PLACE]) - 1
            for _ in range(size):
                _put(state, data, number >> 24)
                number = number << 8 & _TOP - 1
            break
    return int(state[PLACE])


@kernel
def code_number(coder: Coder, context: int, value: int, most: int) -> int:
    """Encode or decode a number of 0 to `LONGEST` bits: its length, then the bits behind the first (Elias gamma code).

    `context` is the first of its `NUMBER` contexts.
    """
    if not code_bit(coder, context + _ZERO, 1 if value else 0, most):
        return 0
    length = 0
    while value >> length > 1:
        length += 1
    read = 0
    while read < LONGEST - 1 and code_bit(coder, context + _LENGTH + read, 1 if read < length else 0, most):
        read += 1
    number = 1
    for place in range(read - 1, -1, -1):
        bit = value >> place & 1
        # the context of a bit: up to 15 all bits before it, in larger numbers its place
        row = _BITS + (1 << read) - read - 1 + number - 1 if read <= 3 else _LOW_BITS + place
        number = number << 1 | code_bit(coder, context + row, bit, most)
    return number


@kernel
def code_signed(coder: Coder, context: int, value: int, most: int) -> int:
    """Encode or decode a number with a sign; otherwise as `code_number`."""
    size = code_number(coder, context, abs(value), most)
    if size and code_bit(coder, context + _SIGN, 1 if value < 0 else 0, most):
        return -size
    return size
