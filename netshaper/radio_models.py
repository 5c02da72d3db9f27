"""Radio models: which robots receive each other, by their positions and the walls (`netshaper.connectivity`).

The setting ``radio.model`` names one: a built-in one, or a plug-in (`protocol.plugins`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np

from netshaper import connectivity
from netshaper.connectivity import Links, Places
from netshaper.settings import RadioSettings
from protocol.grid import Grid
from protocol.plugins import Plugins


class RadioModel(ABC):
    """Which robots receive each other. It must depend on nothing but its arguments: runs repeat."""

    name: ClassVar[str]
    needs_walls: ClassVar[bool] = True
    """Whether links depend on the cells of the world."""

    @abstractmethod
    def links(self, settings: RadioSettings, step: int, places: Places) -> Links:
        """Return which robots receive each other in a step: bool array, shape (robots, robots), symmetric.

        `settings` has the communication range `range_cells` in cells, the side `cell_m` of a cell in meters, the run's
        `seed`, the `options` of the table ``[radio]``, and `walls`, the cells of the world: uint8, shape (h, w), row 0
        on top; None if the model needs none. `places`, int64 of shape (robots, 2), are the cells (x, y) of the living
        robots, in ascending order of their numbers. Steps count from 1.
        """


class Disc(RadioModel):
    """All robots within the range."""

    name = "disc"
    needs_walls = False

    def links(self, settings: RadioSettings, step: int, places: Places) -> Links:
        """Return the links of a step."""
        return connectivity.disc(places, settings.range_cells)


class LineOfSight(RadioModel):
    """Robots within the range without a wall between them."""

    name = "line-of-sight"

    def links(self, settings: RadioSettings, step: int, places: Places) -> Links:
        """Return the links of a step."""
        return connectivity.line_of_sight(places, settings.range_cells, _walls(settings))


class LogDistance(RadioModel):
    """Robots whose path loss is at most that of an open link as long as the range."""

    name = "log-distance"

    def links(self, settings: RadioSettings, step: int, places: Places) -> Links:
        """Return the links of a step."""
        options = settings.options
        extra = connectivity.shadowing(places, settings.cell_m, settings.seed, options)
        walls = _walls(settings)
        return connectivity.log_distance(places, settings.range_cells, walls, settings.cell_m, options, extra)


RADIO_MODELS: dict[str, type[RadioModel]] = {kind.name: kind for kind in (Disc, LineOfSight, LogDistance)}
"""The models of this package."""

PLUGINS: Plugins[type[RadioModel]] = Plugins(
    "radio model", "murmur.radio_models", RadioModel, RADIO_MODELS, RadioModel
)


def checked(links: Any, model: str, robots: int) -> Links:
    """Return links if they are a symmetric bool array of shape (robots, robots); else ValueError names the `model`."""
    shape = (robots, robots)
    if not (isinstance(links, np.ndarray) and links.dtype == np.bool_ and links.shape == shape):
        got = (
            f"{links.dtype} of shape {links.shape}" if isinstance(links, np.ndarray) else type(links).__name__
        )
        raise ValueError(f"radio model {model!r}: links must be a bool array of shape {shape}, not {got}")
    if (links != links.T).any():
        one, other = np.argwhere(links & ~links.T)[0]
        raise ValueError(
            f"radio model {model!r}: links must be symmetric; robot {other} receives robot {one}, but not the reverse"
        )
    return links


def _walls(settings: RadioSettings) -> Grid:
    assert settings.walls is not None
    return settings.walls
