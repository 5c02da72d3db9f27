"""Random numbers by purpose: never one shared stream, so that the order of events does not affect a draw."""

from __future__ import annotations

import hashlib

import numpy as np


def keyed_random(seed: int, purpose: str, *numbers: int) -> np.random.Generator:
    """Return the generator for one purpose, e.g. ``keyed_random(seed, "contention", step, exchange)``."""
    text = ":".join([purpose, str(seed), *map(str, numbers)])
    key = np.frombuffer(hashlib.sha256(text.encode()).digest()[:16], "<u8")
    return np.random.Generator(np.random.Philox(key=key))
