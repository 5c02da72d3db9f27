"""Errors of a robot's believed pose: bounded, and varying over tens to hundreds of steps.

Each error is a sum of sine waves with random phases and periods: it needs no state, so a step can be repeated.
"""

from __future__ import annotations

import math

import numpy as np

from protocol.keyed_random import keyed_random
from protocol.range_scans import DIRECTION_LENGTH, TURN, UNIT, directions
from worldsim.sensor_options import PoseOptions

WAVES = 4
"""Sine waves per error; the largest error is sqrt(2 * WAVES), 2.8, standard deviations."""

SHORTEST, LONGEST = 40, 400
"""Periods in steps."""


class PoseError:
    """The errors of one robot; `resolution` is the side of a cell in meters."""

    def __init__(self, options: PoseOptions, resolution: float, seed: int, robot: int) -> None:
        random = keyed_random(seed, "pose", robot)
        self._phases = random.integers(0, TURN, (3, WAVES))
        periods = SHORTEST * (LONGEST / SHORTEST) ** random.random((3, WAVES))
        self._advance = np.rint(TURN / periods).astype(np.int64)
        position = options.position_error_m / resolution * UNIT
        deviations = np.array([position, position, options.heading_error_deg / 360 * TURN])
        self._amplitudes = deviations * math.sqrt(2 / WAVES)

    def at(self, step: int) -> tuple[int, int, int]:
        """Return the errors of a step: x and y in 1 / `UNIT` cell, the heading in 1 / `TURN`."""
        sines = directions()[(self._phases + step * self._advance) & (TURN - 1), 1] / DIRECTION_LENGTH
        x, y, heading = np.rint(sines.sum(axis=1) * self._amplitudes).astype(int).tolist()
        return x, y, heading
