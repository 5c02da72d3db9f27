"""The environments of the exploration by potential fields with leaders (its Figs. 2 to 5): 10 x 10 m.

A trooper is attracted straight to its closest frontier. It stalls if a wall crosses that line, and a whole team
stalls in rooms whose doors do not face the unexplored space. Troopers slide along a short screen and past it.
"""

from __future__ import annotations

import numpy as np

from protocol.grid import Grid
from worldsim.generators.drawing import Walls, walled

_TRAP: Walls = (
    (3.6, 1.2, 3.6, 5.5),  # left of the hall, then the walls between the rooms there
    (3.6, 7.8, 3.6, 10.0),
    (0.0, 3.3, 3.6, 3.3),
    (0.0, 6.6, 3.6, 6.6),
    (6.4, 0.0, 6.4, 2.2),  # right of the hall
    (6.4, 4.5, 6.4, 8.8),
    (6.4, 3.4, 10.0, 3.4),
    (6.4, 6.7, 10.0, 6.7),
)

_ROOMS: Walls = ((5.0, 1.6, 5.0, 3.6), (5.0, 6.4, 5.0, 8.4), (1.6, 5.0, 3.6, 5.0), (6.4, 5.0, 8.4, 5.0))

_OBSTACLES: Walls = (
    (1.8, 2.0, 3.8, 2.0),  # a cup that opens downwards
    (1.8, 2.0, 1.8, 4.0),
    (3.8, 2.0, 3.8, 4.0),
    (6.2, 1.8, 6.2, 4.0),  # two angles
    (6.2, 4.0, 8.2, 4.0),
    (2.0, 6.0, 4.0, 6.0),
    (2.0, 6.0, 2.0, 8.2),
    (6.0, 6.4, 8.2, 6.4),  # a T
    (7.1, 6.4, 7.1, 8.4),
)


def obstacles(_random: np.random.Generator, *, resolution: float = 0.1) -> Grid:
    """10 x 10 m: a hall with nonconvex obstacles (leader paper, Fig. 2)."""
    return walled(10.0, 10.0, _OBSTACLES, resolution, is_centered=True)


def trap(_random: np.random.Generator, *, resolution: float = 0.1) -> Grid:
    """10 x 10 m: rooms that trap robots attracted straight to the closest frontier (leader paper, Fig. 3)."""
    return walled(10.0, 10.0, _TRAP, resolution, is_centered=True)


def rooms(_random: np.random.Generator, *, resolution: float = 0.1) -> Grid:
    """10 x 10 m: rooms behind short screens, with and without leaders (leader paper, Figs. 4, 5)."""
    return walled(10.0, 10.0, _ROOMS, resolution, is_centered=True)
