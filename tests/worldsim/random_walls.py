"""Random walls, for tests of the world."""

from __future__ import annotations

import numpy as np

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid


def random_walls(seed: int, free: float = 0.8) -> Grid:
    """Return random walls around a free block in the middle, in which the robots start."""
    rng = np.random.default_rng(seed)
    truth = rng.choice(
        np.array([UNKNOWN, FREE, OCCUPIED], np.uint8), (20, 20), p=[(1 - free) / 2, free, (1 - free) / 2]
    )
    truth[7:14, 7:14] = FREE
    return truth
