"""Random generators keyed by seed and purpose, so that the order of events does not affect a draw."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import NDArray


def keyed_random(seed: int, purpose: str, *numbers: int) -> np.random.Generator:
    """Return the generator of one purpose, e.g. ``keyed_random(seed, "contention", step, round_number)``."""
    text = ":".join([purpose, str(seed), *map(str, numbers)])
    key = np.frombuffer(hashlib.sha256(text.encode()).digest()[:16], "<u8")
    return np.random.Generator(np.random.Philox(_Key(key)))  # type: ignore[arg-type]


class _Key(ISeedSequence):
    """A seed sequence that returns a given key; ``Philox(key=...)`` would also read entropy from the system."""

    def __init__(self, key: NDArray[np.uint64]) -> None:
        self._key = key

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> NDArray[np.uint64]:  # noqa: ARG002
        """Return the key: two numbers, as many as Philox asks for."""
        return self._key
