"""The length of a map's context code, compared with an adaptive coder that codes cell by cell."""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from deploy.record.map_code import NEIGHBORS, PRIOR, STATES, map_code_bytes
from deploy.run.exploration import explore
from deploy.scenario.scenario import parse
from protocol.grid import FREE, UNKNOWN, Grid
from worldsim import generators


def coded_bits(grid: Grid) -> float:
    """The bits that an adaptive arithmetic coder writes, row by row."""
    counts: dict[tuple[int, ...], list[int]] = defaultdict(lambda: [0] * STATES)
    height, width = grid.shape
    bits = 0.0
    for y, x in np.ndindex(grid.shape):
        cells = [(y + dy, x + dx) for dy, dx in NEIGHBORS]
        context = tuple(
            int(grid[cell]) if 0 <= cell[0] < height and 0 <= cell[1] < width else UNKNOWN for cell in cells
        )
        seen, state = counts[context], int(grid[y, x])
        bits -= math.log2((seen[state] + PRIOR) / (sum(seen) + STATES * PRIOR))
        seen[state] += 1
    return bits


@given(
    arrays(np.uint8, array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.integers(0, STATES - 1))
)
def test_the_length_is_that_of_an_adaptive_coder(grid: Grid) -> None:
    assert 8 * map_code_bytes(grid) == pytest.approx(coded_bits(grid), abs=1e-6)


def test_an_empty_hall_costs_less_than_rooms_and_rooms_less_than_noise() -> None:
    office = generators.make("office", seed=0).cells
    noise = np.random.default_rng(0).integers(0, STATES, office.shape).astype(np.uint8)
    hall = np.full_like(office, FREE)
    lengths = [map_code_bytes(grid) for grid in (hall, office, noise)]
    assert lengths[0] < 10 < lengths[1] < lengths[2] / 10
    assert lengths[2] > office.size * math.log2(STATES) / 8


def test_a_summary_has_the_code_of_the_first_robot_s_map_and_the_multiple_of_it_that_was_sent() -> None:
    result = explore(parse({"map": "em", "robots": 2, "bus": "memory", "bandwidth": 100}), keep=False)
    summary = result.summary
    code = map_code_bytes(result.records.planning[summary["first_robot"]])
    assert summary["map_code_bytes"] == pytest.approx(code, abs=0.1)
    assert summary["map_code_multiple"] == pytest.approx(summary["bytes"]["total"] / code, rel=1e-3)
