"""Where an author looks for updates to depend on, compared with a look at every cell."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from agent.predictive.scan_updates import REPORTED, STATE
from agent.predictive.stream import lacking_box
from protocol.boxes import Box, box_of
from protocol.grid import FREE, OCCUPIED, UNKNOWN

sides = st.integers(1, 40)
boxes = st.tuples(*[st.integers(-20, 60)] * 4)


@given(sides, sides, st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.01, 0.5]), boxes)
def test_the_box_contains_exactly_the_cells_that_only_the_author_knows(
    height: int, width: int, seed: int, share: float, near: Box
) -> None:
    rng = np.random.default_rng(seed)
    states = np.array([UNKNOWN, FREE, OCCUPIED, FREE | REPORTED, OCCUPIED | REPORTED, REPORTED], np.uint8)
    grid = rng.choice(states, (height, width))
    own = np.where(rng.random((height, width)) < share, FREE, UNKNOWN).astype(np.uint8)
    lacking = (own != UNKNOWN) & (grid & STATE == UNKNOWN)
    x0, y0, x1, y1 = near
    inside = np.zeros_like(lacking)
    inside[max(y0, 0) : max(y1, 0), max(x0, 0) : max(x1, 0)] = True
    found = lacking_box(grid, own, near)
    if (lacking & inside).any():
        assert found == box_of(lacking & inside)
    else:
        assert found[0] >= found[2]
        assert found[1] >= found[3]
