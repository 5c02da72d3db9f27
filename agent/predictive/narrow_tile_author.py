"""Which tiles of a noisy map an update has on a narrow medium: the most valuable ones that fill its limit.

On a narrow medium, robots find tiles faster than it carries them. Each update begins with bytes of its own, so its
limit is high (`agent.encodings.update_packets`): some whole packets. The author encodes an update several times, with
more or fewer tiles, and sends the longest one that fits.

An update takes the tiles in this order:

1. those that are worth at least `LEAST_CELLS` to teammates and are complete, or have waited for long,
2. other tiles of this worth,
3. tiles that are worth less. Those of no value follow only in an update that has no others.

Of each kind, those with the most value per byte go first.
"""

from __future__ import annotations

import numpy as np

from agent.mapping.bound import Bound, TileMask
from agent.mapping.estimator import Int8Grid
from agent.predictive.tile_stream import TileStream
from agent.predictive.tile_value import TileValues
from agent.predictive.urgent_tile_author import UrgentTileAuthor, most_per_byte
from protocol.arrays import Int64s
from protocol.grid import Grid

TRIALS = 4
"""Times that an update is encoded at most to find out how many tiles fit."""

HEAD_BYTES = 4.0
"""Typical bytes of an update besides its tiles."""

LEAST_CORRECTION, MOST_CORRECTION = 0.2, 5.0
"""Limits of the factor by which the bytes of tiles differ from the estimates of their values."""


class NarrowTileAuthor(UrgentTileAuthor):
    """Encodes as many of the most valuable tiles as fit into the limit of an update, unless one tile takes more."""

    def __init__(self, stream: TileStream, bound: Bound) -> None:
        super().__init__(stream, bound)
        self._correction = 1.0
        """The bytes of the last update's tiles, relative to the estimates of their values."""
        self._is_full = False

    @property
    def is_full(self) -> bool:
        """Whether more tiles wait than the last update has."""
        return self._is_full

    def _order(self, values: TileValues, useful: TileMask) -> Int64s:
        complete = self._complete(values, useful)
        less = self._violate & ~useful & (values.cells > 0)
        kinds = complete, useful & ~complete, less
        places = np.concatenate([most_per_byte(values, kind) for kind in kinds])
        return places if len(places) else super()._order(values, useful)

    def _fitting(self, places: Int64s, values: TileValues, own: Grid, log_odds: Int8Grid, most: float) -> int:
        sizes = np.cumsum(values.size.reshape(-1)[places])
        fits, exceeds = 0, len(places) + 1
        for _ in range(TRIALS):
            guess = int(np.searchsorted(sizes * self._correction, most - HEAD_BYTES, side="right"))
            count = min(max(guess, fits + 1), exceeds - 1)
            size = self._size(places[:count], own, log_odds)
            if size <= most:
                fits = count
            else:
                exceeds = count
            if exceeds == fits + 1:
                break
            correction = max(size - HEAD_BYTES, 1.0) / float(sizes[count - 1])
            self._correction = min(max(correction, LEAST_CORRECTION), MOST_CORRECTION)
        count = max(fits, 1)
        self._is_full = count < len(places)
        return count

    def _size(self, places: Int64s, own: Grid, log_odds: Int8Grid) -> int:
        """Return the bytes of an update of some tiles, given by their flat indices."""
        tiles = np.zeros(self._violate.shape, np.uint8)
        tiles.reshape(-1)[places] = 1
        return self.stream.size(own, log_odds, self._bound, tiles, self._pose)
