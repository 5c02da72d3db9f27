"""Predict the cell of the next scan from the map, for narrow media.

The plain code of poses (`agent.predictive.scan_updates.code_pose`) knows only the last motion. Here each cell around
the last pose has a weight, and the pose is coded as a choice among them. The weight is a product: of a factor for each
of four features of the cell, from a table that was trained on generated maps (a multinomial logit model, McFadden
1974). The features are the length of the way from the last pose, its direction relative to the last motion, whether
it repeats this motion, and how far unknown cells are from there: robots drive toward them.

Cells are tried in rings around the last pose, up to a distance of 8, 16, and 32 cells. Behind the last ring, the plain
code follows. The arithmetic is on integers, so all machines compute equal bits.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from agent.predictive.coder import WIDTH, Coder, Counts, Data, State, divide
from agent.predictive.scan_updates import DX, DY, SCANS, Motion, X, Y, code_pose
from protocol.arrays import Int16Rows, Int16s, Int64s
from protocol.grid import OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

RINGS = 3
"""Rings of candidate cells."""

FIRST_RING = 8
"""Chebyshev distance of the outermost cells of the first ring; that of each further ring is twice as large."""

MARGIN = 8
"""Cells around a ring in which ways and unknown cells count."""

STRAIGHT, DIAGONAL = 5, 7
"""Length of a way to a neighbor in the same row or column, or to a diagonal one."""

FAR = 30000
"""Length of a way that does not exist."""

ROUNDS = 2
"""Sweeps in both directions by which ways are found; those around more corners are longer than need be."""

FEATURES = 4
"""Features of a cell."""

WAYS, DIRECTIONS, LEADS, NEARNESSES = 64, 18, 25, 8
"""Values of the features: length of the way; direction relative to the last motion; how much nearer unknown cells are
than from the last pose; and how near they are."""

DIRECTION = WAYS
REPEATS = DIRECTION + DIRECTIONS
UNKNOWN_NEAR = REPEATS + 2
LEAVES = UNKNOWN_NEAR + LEADS * NEARNESSES
"""First value of each feature in the table; the first feature begins at 0. `LEAVES`: that of leaving the ring."""

VALUES = LEAVES + 3
"""Columns of the table."""

LOG_UNIT = 16
"""Table entries are logarithms of factors to the base 2, in 1/16."""

WEIGHT_BITS = 18
"""The largest weight is 2 to this power, the smallest is 1."""

_FRACTIONS = (262144, 251029, 240387, 230195, 220436, 211090, 202140, 193570)
_FRACTIONS += (185364, 177505, 169979, 162773, 155872, 149263, 142935, 136875)

POWERS: Int64s = np.array(
    [max(_FRACTIONS[log % LOG_UNIT] >> log // LOG_UNIT, 1) for log in range(WEIGHT_BITS * LOG_UNIT + 1)], np.int64
)
"""Weight by the difference from the logarithm of the largest one."""

TABLE = Path(__file__).with_name("pose_start.npz")
"""The shipped table, trained on generated maps (`deploy.study.pose_table`). Its arrays are the logarithms of the
`factors`, int8 of shape (`RINGS`, `VALUES`), and the initial `counts` of contexts from `MORE_SCANS_NARROW` on."""

Factors = Annotated[NDArray[np.int8], "int8[:,::1]"]


def no_factors() -> Factors:
    """Return an empty table, for streams that do not predict poses."""
    return np.zeros((0, VALUES), np.int8)


def start_factors() -> Factors:
    """Return the shipped factors."""
    return _table()[0]


def start_counts() -> Counts:
    """Return the shipped counts."""
    return _table()[1]


@cache
def _table() -> tuple[Factors, Counts]:
    with np.load(TABLE) as file:
        return file["factors"], file["counts"]


@kernel
def _sweep(ways: Int16Rows, least: Int16Rows, first: int, end: int) -> None:
    """Shorten ways to the cells of a square by ways to their neighbors, but not below `least`.

    The square has rows and columns `first` to `end` - 1. Its sides must not lie on the rim of the arrays.
    """
    one = np.uint64(1)
    for y in range(np.uint64(first), np.uint64(end)):
        for x in range(np.uint64(first), np.uint64(end)):
            straight = min(ways[y - one, x], ways[y, x - one]) + STRAIGHT
            diagonal = min(ways[y - one, x - one], ways[y - one, x + one]) + DIAGONAL
            ways[y, x] = max(np.int64(least[y, x]), min(np.int64(ways[y, x]), min(straight, diagonal)))
    last = np.uint64(first + end - 1)
    for row in range(np.uint64(first), np.uint64(end)):
        y = last - row
        for column in range(np.uint64(first), np.uint64(end)):
            x = last - column
            straight = min(ways[y + one, x], ways[y, x + one]) + STRAIGHT
            diagonal = min(ways[y + one, x + one], ways[y + one, x - one]) + DIAGONAL
            ways[y, x] = max(np.int64(least[y, x]), min(np.int64(ways[y, x]), min(straight, diagonal)))


@kernel
def _direction(x: int, y: int, last_x: int, last_y: int) -> int:
    """Return the angle between two motions: 0 if they are equal, 16 if they are opposite; 17 if one is none."""
    along, across = x * last_x + y * last_y, abs(x * last_y - y * last_x)
    size = abs(along) + across
    if size == 0:
        return 17
    angle = 0
    for limit in range(1, 16, 2):
        angle += int(16 * across >= limit * size)
    return angle if along >= 0 else 16 - angle


@kernel
def describe(grid: Grid, motion: Motion, speed: int, ring: int, features: Int16Rows) -> int:
    """Find the features of the candidate cells of a ring around the last pose.

    Parameters
    ----------
    grid : uint8 array, shape (h, w)
        The grid from which the scan is predicted.
    motion : Motion
        The last pose and motion.
    speed : int
        The robot's speed, in 1/1000 cell per step.
    features : int16 array, shape (n n, FEATURES)
        Output: for each cell of the square around the last pose, row by row, the columns of the table of its features.
        -1: the cell is no candidate, as it lies in an inner ring or outside of the grid.

    Returns n, the side of the square.
    """
    outer = FIRST_RING << ring
    inner = outer >> 1 if ring else -1
    half = outer + MARGIN + 1
    side, size = 2 * outer + 1, 2 * half + 1
    left, top = motion[X] - half, motion[Y] - half
    least = np.full((size, size), FAR, np.int16)
    ways = np.full((size, size), FAR, np.int16)
    to_unknown = np.full((size, size), FAR, np.int16)
    for row in range(max(1, -top), min(size - 1, grid.shape[0] - top)):
        for column in range(max(1, -left), min(size - 1, grid.shape[1] - left)):
            state = grid[top + row, left + column] & 3
            if state != OCCUPIED:
                least[row, column] = 0
            if state == UNKNOWN:
                to_unknown[row, column] = 0
    ways[half, half] = 0
    for _ in range(ROUNDS):
        _sweep(ways, least, MARGIN, size - MARGIN)
    _sweep(to_unknown, least, 1, size - 1)
    here = np.int64(to_unknown[half, half])
    scale = (1000 * STRAIGHT << 16) // speed
    for y in range(-outer, outer + 1):
        for x in range(-outer, outer + 1):
            index = (y + outer) * side + x + outer
            inside = 0 <= motion[X] + x < grid.shape[1] and 0 <= motion[Y] + y < grid.shape[0]
            if not inside or max(abs(x), abs(y)) <= inner:
                features[index, 0] = -1
                continue
            way, unknown = np.int64(ways[half + y, half + x]), np.int64(to_unknown[half + y, half + x])
            features[index, 0] = min(way * scale >> 16 + ring, WAYS - 1)
            features[index, 1] = DIRECTION + _direction(x, y, motion[DX], motion[DY])
            features[index, 2] = REPEATS + int(x == motion[DX] and y == motion[DY])
            lead = LEADS - 1
            if unknown < FAR:
                lead = max(0, min(LEADS - 3, (unknown - here >> 2 + ring) + LEADS // 2 - 1)) if here < FAR else LEADS - 2
            near = 0
            for place in range(2, 2 + NEARNESSES - 1):
                near += int(unknown >> place > 0)
            features[index, 3] = UNKNOWN_NEAR + lead * NEARNESSES + near
    return side


@kernel
def leaving(motion: Motion) -> int:
    """Return the column of the table of leaving a ring: by the length of the last motion."""
    last = max(abs(motion[DX]), abs(motion[DY]))
    return LEAVES + int(last > FIRST_RING) + int(last > 2 * FIRST_RING)


@kernel
def _weigh(features: Int16Rows, factors: Factors, ring: int, leaves: int, weights: Int64s) -> int:
    """Compute the weights of candidates, 0 for other cells; return that of leaving the ring."""
    most = np.int64(factors[ring, leaves])
    for index in range(len(weights)):
        weights[index] = -(1 << 20)
        if features[index, 0] >= 0:
            log = np.int64(0)
            for feature in range(FEATURES):
                log += factors[ring, features[index, feature]]
            weights[index] = log
            most = max(most, log)
    for index in range(len(weights)):
        log = most - weights[index]
        weights[index] = POWERS[min(log, len(POWERS) - 1)] if log < 1 << 19 else 0
    return int(POWERS[min(most - factors[ring, leaves], len(POWERS) - 1)])


@kernel
def _choose(state: State, data: Data, weights: Int64s, stride: int, count: int, chosen: int) -> int:
    """Encode or decode a choice, with a probability in proportion to its weight, by halving the choices; return it.

    Choice i has the weight of rows i `stride` to (i + 1) `stride` - 1.
    """
    first, end = 0, count
    total = weights[: count * stride].sum()
    while end - first > 1:
        middle = (first + end) // 2
        before = weights[first * stride : middle * stride].sum()
        bit = 1 if chosen >= middle else 0
        if before == 0 or before == total:
            bit = 0 if before else 1
        else:
            bit = divide(state, data, max(1, state[WIDTH] * before // total), bit)
        first, end = (middle, end) if bit else (first, middle)
        total = total - before if bit else before
    return first


@kernel
def code_predicted_pose(
    coder: Coder, motion: Motion, grid: Grid, factors: Factors, speed: int, x: int, y: int
) -> None:
    """Encode or decode the next pose into `motion`; `speed` is that of the robot, in 1/1000 cell per step."""
    if motion[SCANS] == 0:
        code_pose(coder, motion, x, y)
        return
    state, data = coder[0], coder[1]
    went_x, went_y = x - motion[X], y - motion[Y]
    for ring in range(RINGS):
        outer = FIRST_RING << ring
        side = 2 * outer + 1
        features = np.empty((side * side, FEATURES), np.int16)
        weights = np.empty(side * side, np.int64)
        describe(grid, motion, speed, ring, features)
        leaves = _weigh(features, factors, ring, leaving(motion), weights)
        total = weights.sum()
        if total == 0:
            continue
        away = 1 if max(abs(went_x), abs(went_y)) > outer else 0
        if divide(state, data, max(1, state[WIDTH] * total // (total + leaves)), away):
            continue
        row = _choose(state, data, weights, side, side, went_y + outer)
        column = _choose(state, data, weights[row * side : (row + 1) * side], 1, side, went_x + outer)
        motion[DX], motion[DY] = column - outer, row - outer
        motion[X] += motion[DX]
        motion[Y] += motion[DY]
        return
    code_pose(coder, motion, x, y)
