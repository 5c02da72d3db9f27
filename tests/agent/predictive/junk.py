"""Random bytes for decoders of the predictive encoding."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from protocol.errors import ProtocolError

MESSAGES = 300


def count_refused(decode: Callable[[bytes], object]) -> int:
    """Decode `MESSAGES` random messages of up to 59 bytes; return how many were refused with a ProtocolError."""
    random, refused = np.random.default_rng(1), 0
    for size in random.integers(0, 60, MESSAGES).tolist():
        try:
            decode(random.bytes(size))
        except ProtocolError:
            refused += 1
    return refused
