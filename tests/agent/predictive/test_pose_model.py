"""Predicted poses: features as documented, lossless for any pose and map, and cheap where robots drive."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.predictive import contexts
from agent.predictive.coder import PLACE, WIDTH, reader, writer, written
from agent.predictive.pose_model import (
    BEYOND,
    DIRECTION,
    DISTANCES,
    FEATURES,
    FIRST_RING,
    LEADS,
    REPEATS,
    RINGS,
    TO_UNKNOWN,
    VALUES,
    WAYS,
    code_predicted_pose,
    describe,
    start_factors,
)
from agent.predictive.scan_updates import Motion, code_pose
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid

SPEED = 5000
seeds = st.integers(0, 2**32 - 1)


def at(x: int, y: int, dx: int = 0, dy: int = 0) -> Motion:
    """A robot in cell (x, y) after a motion (dx, dy)."""
    return np.array([x, y, dx, dy, 1], np.int64)


def coded_bits(grid: Grid, motion: Motion, x: int, y: int, *, predicts: bool = True) -> float:
    """Bits of a pose."""
    state, data = writer(64)
    coder = (state, data, contexts.start(narrow=predicts))
    if predicts:
        code_predicted_pose(coder, motion.copy(), grid, start_factors(), SPEED, x, y)
    else:
        code_pose(coder, motion.copy(), x, y)
    return float(32 + 8 * state[PLACE] - math.log2(state[WIDTH]))


def features(grid: Grid, motion: Motion, ring: int, speed: int = SPEED) -> NDArray[np.int16]:
    """Features of the cells around the last pose, by row and column."""
    side = 2 * (FIRST_RING << ring) + 1
    found = np.empty((side * side, FEATURES), np.int16)
    describe(grid, motion, speed, ring, found)
    return found.reshape(side, side, FEATURES)


@given(seeds, st.sampled_from([1, 900, 5000, 70000]))
def test_a_receiver_decodes_any_poses(seed: int, speed: int) -> None:
    random = np.random.default_rng(seed)
    shape = tuple(random.integers(1, 120, 2))
    grid = random.choice((UNKNOWN, FREE, OCCUPIED), shape, p=(0.2, 0.6, 0.2)).astype(np.uint8)
    grid += (4 * random.integers(0, 2, shape)).astype(np.uint8)
    poses = [(int(random.integers(shape[1])), int(random.integers(shape[0])))]
    for _ in range(20):
        reach = int(random.choice((0, 2, 8, 20, 100)))
        x, y = np.clip(
            np.array(poses[-1]) + random.integers(-reach, reach + 1, 2), 0, np.array(shape[::-1]) - 1
        )
        poses.append((int(x), int(y)))
    state, data = writer(1 << 10)
    motion, counts = np.zeros(5, np.int64), contexts.start(narrow=True)
    for x, y in poses:
        code_predicted_pose((state, data, counts), motion, grid, start_factors(), speed, x, y)
    coder = (*reader(written(state, data)), contexts.start(narrow=True))
    received = np.zeros(5, np.int64)
    for x, y in poses:
        code_predicted_pose(coder, received, grid, start_factors(), speed, 0, 0)
        assert received[:2].tolist() == [x, y]
    assert received.tolist() == motion.tolist()


@given(seeds, st.binary(max_size=40))
def test_any_bytes_decode_to_cells_of_the_grid_or_far_ones(seed: int, noise: bytes) -> None:
    random = np.random.default_rng(seed)
    shape = tuple(random.integers(1, 80, 2))
    grid = random.integers(0, 3, shape).astype(np.uint8)
    coder = (*reader(noise), contexts.start(narrow=True))
    for _ in range(8):
        x, y = int(random.integers(shape[1])), int(random.integers(shape[0]))
        motion = at(x, y, int(random.integers(-9, 10)), int(random.integers(-9, 10)))
        code_predicted_pose(coder, motion, grid, start_factors(), SPEED, 0, 0)
        inside = 0 <= motion[0] < shape[1] and 0 <= motion[1] < shape[0]
        assert inside or abs(motion[2:4]).max() < 1 << 25


@pytest.mark.parametrize("ring", range(RINGS))
def test_features_are_those_of_open_ground(ring: int) -> None:
    grid = np.full((150, 170), FREE, np.uint8)
    grid[:, 90:] = UNKNOWN
    found = features(grid, at(80, 70, 5, 0), ring)
    outer = FIRST_RING << ring
    for y, x in ((0, outer), (-outer, 0), (outer, -outer), (outer - 1, outer), (outer, 3)):
        way, direction, repeats, unknown = found[outer + y, outer + x].tolist()
        longer, shorter = max(abs(x), abs(y)), min(abs(x), abs(y))
        assert way == min(WAYS - 1, 5 * longer + 2 * shorter >> ring)
        assert repeats == REPEATS
        distance, here = 5 * max(0, 10 - x), 50
        lead = max(0, min(LEADS - 3, (distance - here >> 2 + ring) + LEADS // 2 - 1))
        if distance < 5 * (outer + 9 - x):  # unknown cells lie within the margin
            assert unknown - TO_UNKNOWN == lead * DISTANCES + min((distance >> 2).bit_length(), DISTANCES - 1)
        assert 0 <= direction - DIRECTION <= 16
    assert found[outer, 2 * outer, 1] == DIRECTION
    assert found[outer, 0, 1] == DIRECTION + 16
    assert found[0, outer, 1] == DIRECTION + 8
    assert found[..., 0].max() < DIRECTION
    assert found[found[..., 0] >= 0].max() < BEYOND


def test_candidates_are_the_cells_of_the_ring_inside_the_grid() -> None:
    grid = np.full((30, 40), FREE, np.uint8)
    for ring in range(RINGS):
        outer = FIRST_RING << ring
        inner = outer // 2 if ring else -1
        expected = [
            0 <= 4 + x < 40 and 0 <= 20 + y < 30 and max(abs(x), abs(y)) > inner
            for y in range(-outer, outer + 1)
            for x in range(-outer, outer + 1)
        ]
        assert (features(grid, at(4, 20), ring)[..., 0] >= 0).ravel().tolist() == expected


def test_ways_lead_around_walls_and_are_measured_in_steps() -> None:
    grid = np.full((60, 60), FREE, np.uint8)
    grid[25:36, 32] = OCCUPIED
    open_ways = features(np.full((60, 60), FREE, np.uint8), at(30, 30), 0)[..., 0]
    ways = features(grid, at(30, 30), 0)[..., 0]
    assert ways[8, 12] > open_ways[8, 12]
    assert ways[8, 10] == WAYS - 1, "a wall"
    assert (ways >= open_ways).all()
    twice = features(grid, at(30, 30), 0, speed=2 * SPEED)[..., 0]
    assert (twice[ways < WAYS - 1] == ways[ways < WAYS - 1] // 2).all()


def test_a_pose_on_the_way_to_unknown_cells_takes_few_bits() -> None:
    grid = np.full((60, 90), FREE, np.uint8)
    grid[0], grid[-1] = OCCUPIED, OCCUPIED
    grid[:, 60:] = UNKNOWN
    ahead, back = at(50, 30, 5, 0), at(50, 30, -5, 0)
    assert coded_bits(grid, ahead, 55, 30) < 2.5
    assert coded_bits(grid, ahead, 55, 30) < coded_bits(grid, back, 45, 30)
    assert coded_bits(grid, ahead, 53, 33) < coded_bits(grid, ahead, 53, 33, predicts=False)
    grid[:, 53] = OCCUPIED
    assert coded_bits(grid, ahead, 55, 30) > 8, "the robot cannot drive through a wall"


def test_the_shipped_factors_fit_the_features() -> None:
    factors = start_factors()
    assert factors.shape == (RINGS, VALUES)
    assert factors.any(axis=1).all()
