"""Logistic mixing of predictions (Mahoney 2005), in integer arithmetic, so that all machines compute equal bits.

Each of several contexts predicts the next bit. The predictions are mixed in the logistic domain, ln(p / (1 - p)), with
weights that are trained after each bit; the arithmetic coder takes the result. A context's probability moves towards
the bit by about 1 / (n + 1.6) at its n-th bit, so it is an average at first, and follows changes later.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from agent.predictive.coder import WIDTH, Data, State, divide
from protocol.arrays import Int32Rows, Int64Rows, Int64s, Uint16Rows
from protocol.kernels import kernel

INPUTS = 6
"""Contexts of a bit."""

Ages = Annotated[NDArray[np.uint8], "uint8[:,::1]"]

Model = tuple[Uint16Rows, Ages, Int32Rows]
"""For each input and context: the probability of 1 in 1/65536, and how many bits it has seen, at most `OLDEST`; both of
shape (`INPUTS`, contexts). Weights in 1/65536, shape (sets, `INPUTS`)."""

MixingCoder = tuple[State, Data, Uint16Rows, Ages, Int32Rows, Int64Rows]
"""State and buffer of a coder, a model, and a buffer of shape (2, `INPUTS`): contexts of the next bit, and their
predictions."""

OLDEST = 250
"""Bits after which a context adapts no slower; of the last input, `OLDEST_LAST`: its contexts follow changes."""

OLDEST_LAST = 60

_ONE = 4096
"""Unit of a mixed probability; the coder gives at least 1 and at most `_ONE` - 1 of it to a bit of 1."""

_LEAST_CHANCE = 16
_LEARNING_BITS = 10
"""A weight moves by logit times error, divided by 2 to this power; faster learning costs more bytes in short logs."""
_FIRST_WEIGHT = 19661
_MOST_WEIGHT = 1 << 20

_CURVE = (1, 2, 3, 6, 10, 16, 27, 45, 73, 120, 194, 310, 488, 747, 1101, 1546, 2047)
"""4096 / (1 + e^-x) for x from -8 to 0, in steps of 1/2."""


def _logistic() -> NDArray[np.int64]:
    """Tabulate 4096 / (1 + e^(-x / 256)) for x from -2048 to 2047, by linear interpolation of integers."""
    knots = np.array([*_CURVE, *(_ONE - chance for chance in _CURVE[-2::-1])], np.int64)
    knot, rest = np.divmod(np.arange(4096), 128)
    table: NDArray[np.int64] = np.clip(
        (knots[knot] * (128 - rest) + knots[knot + 1] * rest + 64) >> 7, 1, _ONE - 1
    )
    return table


LOGISTIC: Int64s = _logistic()
"""Probability by x + 2048."""

LOGIT: Int64s = np.searchsorted(LOGISTIC, np.arange(_ONE)).clip(0, 4095) - 2048
"""The inverse: the smallest x with at least this probability."""

RATES: Int64s = 655360 // (10 * np.arange(OLDEST + 1, dtype=np.int64) + 16)
"""1 / (age + 1.6), in 1/65536."""


def new_model(contexts: int, sets: int) -> Model:
    """Return a model that has seen no bits."""
    return (
        np.full((INPUTS, contexts), 1 << 15, np.uint16),
        np.zeros((INPUTS, contexts), np.uint8),
        np.full((sets, INPUTS), _FIRST_WEIGHT, np.int32),
    )


def mixing_coder(state: State, data: Data, model: Model) -> MixingCoder:
    """Join a coder's state and buffer with a model, which the coder changes."""
    return state, data, *model, np.zeros((2, INPUTS), np.int64)


@kernel
def code_mixed(coder: MixingCoder, weight_set: int, bit: int) -> int:
    """Encode `bit`, or decode a bit, in the contexts of the buffer's first row; return it and train the model."""
    state, data, chances, ages, weights, buffer = coder
    total = np.int64(0)
    for index in range(INPUTS):
        buffer[1, index] = LOGIT[chances[index, buffer[0, index]] >> 4]
        total += buffer[1, index] * weights[weight_set, index]
    chance = LOGISTIC[min(4095, max(0, int(total >> 16) + 2048))]
    bit = divide(state, data, (state[WIDTH] >> 12) * (_ONE - chance), bit)
    error = (bit << 12) - chance
    target = 65535 if bit else 0
    for index in range(INPUTS):
        weight = weights[weight_set, index] + (buffer[1, index] * error >> _LEARNING_BITS)
        weights[weight_set, index] = min(_MOST_WEIGHT, max(-_MOST_WEIGHT, weight))
        context = buffer[0, index]
        before, age = np.int64(chances[index, context]), np.int64(ages[index, context])
        after = before + ((target - before) * RATES[age] >> 16)
        chances[index, context] = min(65535 - _LEAST_CHANCE, max(_LEAST_CHANCE, after))
        if age < (OLDEST if index < INPUTS - 1 else OLDEST_LAST):
            ages[index, context] = age + 1
    return bit
