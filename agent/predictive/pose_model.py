"""Predict the cell of the next scan from the map, for narrow media.

The plain code of poses (`agent.predictive.scan_updates.code_pose`) knows only the last motion. Here, the pose is coded
as a choice among the cells around the last pose. The probability of a cell is in proportion to a product of factors,
one for each of its four features (a multinomial logit model, McFadden 1974):

1. the length of the way from the last pose, through cells that are not walls;
2. the direction from the last pose, relative to the last motion;
3. whether this motion would repeat the last one;
4. the distance to the nearest unknown cell, and how much shorter it is than from the last pose. Robots drive toward
   unknown cells, and an update contains only scans that reveal some.

The factors were trained on generated maps. The cells form rings around the last pose, which end at a distance of 8, 16,
and 32 cells. One decision per ring codes whether the pose lies farther away. Poses beyond the last ring follow in the
plain code. The arithmetic is on integers, so all machines compute equal bits.
"""

from __future__ import annotations

from functools import cache
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from agent.predictive.coder import WIDTH, Coder, Data, State, divide
from agent.predictive.contexts import NARROW_TABLE
from agent.predictive.scan_updates import DX, DY, SCANS, Motion, X, Y, code_pose
from protocol.arrays import Int8s, Int16Rows, Int64s
from protocol.grid import OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

RINGS = 3
"""Rings of candidate cells."""

FIRST_RING = 8
"""Chebyshev distance of the outermost cells of the first ring; that of each further ring is twice as large."""

MARGIN = 8
"""Cells around a ring up to which unknown cells count."""

STRAIGHT, DIAGONAL = 5, 7
"""Length of a way to a neighbor in the same row or column, or to a diagonal one."""

FAR = 30000
"""Length of a way that does not exist, or that no sweep has found."""

FEATURES = 4
"""Features of a cell."""

WAYS, DIRECTIONS, LEADS, DISTANCES = 64, 18, 25, 8
"""Number of values of features 1 and 2, and of the two parts of feature 4."""

DIRECTION = WAYS
REPEATS = DIRECTION + DIRECTIONS
TO_UNKNOWN = REPEATS + 2
BEYOND = TO_UNKNOWN + LEADS * DISTANCES
"""First column of features 2, 3, and 4 in the table of factors, and of poses beyond the ring; feature 1 begins at 0."""

VALUES = BEYOND + 3
"""Columns of the table of factors."""

LOG_UNIT = 16
"""The table holds logarithms to the base 2, in units of 1/16."""

WEIGHT_BITS = 18
"""The largest weight of a ring is 2 to this power; the smallest is 1."""

_FRACTIONS: tuple[int, ...] = (262144, 251029, 240387, 230195, 220436, 211090, 202140, 193570)
_FRACTIONS += (185364, 177505, 169979, 162773, 155872, 149263, 142935, 136875)

POWERS: Int64s = np.array(
    [max(_FRACTIONS[log % LOG_UNIT] >> log // LOG_UNIT, 1) for log in range(WEIGHT_BITS * LOG_UNIT + 1)],
    np.int64,
)
"""Weight by the difference of its logarithm from that of the largest weight."""

Factors = Annotated[NDArray[np.int8], "int8[:,::1]"]
"""Logarithms of the factors, shape (`RINGS`, `VALUES`)."""


@cache
def start_factors() -> Factors:
    """Return the shipped factors, trained on generated maps."""
    with np.load(NARROW_TABLE) as file:
        factors: Factors = file["factors"]
    return factors


@kernel
def _shortest(least: int, way: int, straight: int, diagonal: int) -> int:
    """Return the shortest of three ways to a cell, two of them by neighbors, but at least `least`."""
    return max(least, min(way, min(straight + STRAIGHT, diagonal + DIAGONAL)))  # noqa: PLW3301


@kernel
def _sweep(ways: Int16Rows, least: Int16Rows, first: int, end: int) -> None:
    """Shorten ways to the cells of a square by ways to their neighbors, first down and right, then up and left.

    No way gets shorter than `least`: `FAR` at walls, else 0. The square has rows and columns `first` to `end` - 1; it
    must not touch the rim of the arrays.
    """
    one = np.uint64(1)
    for y in range(np.uint64(first), np.uint64(end)):
        for x in range(np.uint64(first), np.uint64(end)):
            straight = min(ways[y - one, x], ways[y, x - one])
            diagonal = min(ways[y - one, x - one], ways[y - one, x + one])
            ways[y, x] = _shortest(least[y, x], ways[y, x], straight, diagonal)
    last = np.uint64(first + end - 1)
    for row in range(np.uint64(first), np.uint64(end)):
        for column in range(np.uint64(first), np.uint64(end)):
            up, left = last - np.uint64(row), last - np.uint64(column)
            straight = min(ways[up + one, left], ways[up, left + one])
            diagonal = min(ways[up + one, left + one], ways[up + one, left - one])
            ways[up, left] = _shortest(least[up, left], ways[up, left], straight, diagonal)


@kernel
def _turn(x: int, y: int, last_x: int, last_y: int) -> int:
    """Return the angle between two motions, from 0 (same direction) to 16 (opposite); 17 if one of them is 0."""
    along, across = x * last_x + y * last_y, abs(x * last_y - y * last_x)
    size = abs(along) + across
    if size == 0:
        return 17
    angle = 0
    for limit in range(1, 16, 2):
        angle += int(16 * across >= limit * size)
    return angle if along >= 0 else 16 - angle


@kernel
def _rank(distance: int, here: int, ring: int) -> int:
    """Return the value of feature 4: by the distance to unknown cells, there and from the last pose."""
    lead = LEADS - 1
    if distance < FAR and here < FAR:
        lead = max(0, min(LEADS - 3, (distance - here >> 2 + ring) + LEADS // 2 - 1))
    elif distance < FAR:
        lead = LEADS - 2
    bits = 0
    for place in range(2, 2 + DISTANCES - 1):
        bits += int(distance >> place > 0)
    return lead * DISTANCES + bits


@kernel
def describe(grid: Grid, motion: Motion, speed: int, ring: int, features: Int16Rows) -> None:
    """Find the features of the cells of a ring around the last pose.

    Ways and distances count 5 to a neighbor in the same row or column, and 7 to a diagonal one. Ways around many
    corners may be missing or too long. `grid`, shape (h, w), is that from which the scan is predicted, in which the
    last pose (`motion`) lies; `speed` is that of the robot, in 1/1000 cell per step; `ring` is below `RINGS`.

    `features`, shape (n * n, `FEATURES`), where n = 2 * (`FIRST_RING` << ring) + 1, receives of each cell of the square
    around the last pose, row by row, the columns of its features in the table of factors. The first is -1 if the cell
    is no candidate: if it lies in an inner ring or outside the grid.
    """
    outer = FIRST_RING << ring
    inner = outer >> 1 if ring else -1
    half = outer + MARGIN + 1
    size = 2 * half + 1
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
    _sweep(ways, least, MARGIN, size - MARGIN)
    _sweep(ways, least, MARGIN, size - MARGIN)
    _sweep(to_unknown, least, 1, size - 1)
    here = np.int64(to_unknown[half, half])
    steps = (1000 * STRAIGHT << 16) // speed
    for y in range(-outer, outer + 1):
        for x in range(-outer, outer + 1):
            index = (y + outer) * (2 * outer + 1) + x + outer
            inside = 0 <= motion[X] + x < grid.shape[1] and 0 <= motion[Y] + y < grid.shape[0]
            if not inside or max(abs(x), abs(y)) <= inner:
                features[index, 0] = -1
                continue
            way, distance = np.int64(ways[half + y, half + x]), np.int64(to_unknown[half + y, half + x])
            features[index, 0] = min(int(way * steps >> 16 + ring), WAYS - 1)
            features[index, 1] = DIRECTION + _turn(x, y, motion[DX], motion[DY])
            features[index, 2] = REPEATS + int(x == motion[DX] and y == motion[DY])
            features[index, 3] = TO_UNKNOWN + _rank(int(distance), int(here), ring)


@kernel
def beyond(motion: Motion) -> int:
    """Return the column of the factor of poses beyond a ring: by the length of the last motion."""
    last = max(abs(motion[DX]), abs(motion[DY]))
    return BEYOND + int(last > FIRST_RING) + int(last > 2 * FIRST_RING)


@kernel
def _weigh(features: Int16Rows, factors: Int8s, other: int, weights: Int64s) -> int:
    """Compute the weights of a ring's cells, 0 for those that are no candidates; return that of poses beyond it.

    `factors` is a row of the table, `other` the column of poses beyond the ring.
    """
    most = np.int64(factors[other])
    for index in range(len(weights)):
        if features[index, 0] >= 0:
            log = np.int64(0)
            for feature in range(FEATURES):
                log += factors[features[index, feature]]
            weights[index] = log
            most = max(most, log)
    for index in range(len(weights)):
        if features[index, 0] >= 0:
            weights[index] = POWERS[min(most - weights[index], len(POWERS) - 1)]
        else:
            weights[index] = 0
    return int(POWERS[min(most - factors[other], len(POWERS) - 1)])


@kernel
def _choose(state: State, data: Data, weights: Int64s, stride: int, chosen: int) -> int:
    """Encode or decode a choice, with probabilities in proportion to weights, by halving the choices; return it.

    The weight of choice i is the sum of `weights` from i * `stride` to (i + 1) * `stride` - 1. Not all may be 0.
    """
    first, end = 0, len(weights) // stride
    total = weights.sum()
    while end - first > 1:
        middle = (first + end) // 2
        before = weights[first * stride : middle * stride].sum()
        bit = 1 if before == 0 else 0
        if 0 < before < total:
            part = max(1, state[WIDTH] * before // total)
            bit = divide(state, data, part, 1 if chosen >= middle else 0)
        if bit:
            first, total = middle, total - before
        else:
            end, total = middle, before
    return first


@kernel
def code_predicted_pose(
    coder: Coder, motion: Motion, grid: Grid, factors: Factors, speed: int, x: int, y: int
) -> None:
    """Encode or decode the next pose into `motion`; the first pose of a log in the plain code.

    `grid`, shape (h, w), is that from which the scan is predicted, `factors` are those of `start_factors`, and `speed`
    is that of the robot, in 1/1000 cell per step. The cell (x, y) of the scan must lie in the grid; a decoder passes
    any.
    """
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
        other = _weigh(features, factors[ring], beyond(motion), weights)
        total = weights.sum()
        if total == 0:
            continue
        is_beyond = 1 if max(abs(went_x), abs(went_y)) > outer else 0
        if divide(state, data, max(1, state[WIDTH] * total // (total + other)), is_beyond):
            continue
        row = _choose(state, data, weights, side, went_y + outer)
        column = _choose(state, data, weights[row * side : (row + 1) * side], 1, went_x + outer)
        motion[DX], motion[DY] = column - outer, row - outer
        motion[X] += motion[DX]
        motion[Y] += motion[DY]
        return
    code_pose(coder, motion, x, y)
