"""When and in which order the tiles of a noisy map are encoded while robots explore with a limited budget.

The unused rest of a budget is worth nothing, and a late tile sends teammates to places that this robot has seen. So no
ready tile waits for others: the encoding asks for an update only if teammates hold the last one, and updates are as
frequent as the budget allows. An update takes one of three kinds of tiles, the first of which there are any:

1. tiles that are worth at least `LEAST_CELLS` to teammates (`agent.predictive.tile_value`), and that are complete or
   have waited for `LONGEST_WAIT` steps,
2. other tiles of this worth,
3. all others. They bring copies within the bound, but hardly change plans. Those of no value are only ready once they
   have not changed for `WORTHLESS_QUIET_STEPS` steps, or have waited for `WORTHLESS_LONGEST_WAIT`.

Of the first two, those with the most value per byte go first, of the last, those that have waited longest. Narrow media
have another order (`agent.predictive.narrow_tile_author`).

While the robot stands still, its scans show hardly anything new. So none of its tiles waits for further changes. Robots
that have finished stand still, so their last tiles arrive before the run ends.
"""

from __future__ import annotations

import numpy as np

from agent.mapping.bound import Bound, TileMask
from agent.mapping.estimator import Int8Grid
from agent.predictive.history import DecodedUpdate
from agent.predictive.tile_author import LONGEST_WAIT, TileAuthor
from agent.predictive.tile_stream import TileStream
from agent.predictive.tile_value import TileValues, tile_values
from protocol.arrays import Int64s
from protocol.grid import Grid

FEW_QUIET_STEPS = 2
"""Steps without a change after which a tile is encoded."""

WORTHLESS_QUIET_STEPS = 10
"""Steps without a change after which a tile is encoded that teammates do not need for their plans."""

WORTHLESS_LONGEST_WAIT = 30
"""Steps after which such a tile is encoded although it still changes."""

LEAST_CELLS = 8
"""Value from which a tile is sent before those that do not change the plans of teammates."""


class UrgentTileAuthor(TileAuthor):
    """Encodes the tiles first that change the plans of teammates the most, one update per step."""

    quiet_steps = FEW_QUIET_STEPS

    def __init__(self, stream: TileStream, bound: Bound) -> None:
        super().__init__(stream, bound)
        self._violate: TileMask = np.zeros(self._changed.shape, np.bool_)
        """The ready tiles that violate the bound, as of the last call of `is_due`."""
        self._values: TileValues | None = None
        self._is_worth_much = False
        """Whether the last update has tiles of the first two kinds."""
        self._has_more = False
        """Whether there were more of them than it has."""

    def has_news(self, own: Grid, log_odds: Int8Grid, received: Grid, *, delivered: bool) -> bool:
        """Return whether teammates lack tiles of the first two kinds, or will once those that wait are ready."""
        if self._has_more or (self._is_worth_much and not delivered):
            return True
        violate = self.stream.violations(own, log_odds, self._bound, self._waits().view(np.uint8))
        values = tile_values(self.stream.target, received, violate.view(np.uint8))
        return bool((values.cells >= LEAST_CELLS).any())

    def is_due(self, own: Grid, log_odds: Int8Grid, received: Grid) -> bool:
        """Return whether a ready tile violates the bound; those that fulfill it stop waiting."""
        self._violate = self._drop_fulfilled(own, log_odds)
        if self._violate.any():
            self._values = tile_values(self.stream.target, received, self._violate.view(np.uint8))
            self._violate &= (self._values.cells > 0) | self._waits_long()
        if not self._violate.any():
            self._has_more = False
            return False
        return True

    def _waits_long(self) -> TileMask:
        """Return the tiles that may be encoded even if they are worth nothing."""
        is_quiet = self._changed <= self._step - WORTHLESS_QUIET_STEPS
        is_late = self._waiting_since <= self._step - WORTHLESS_LONGEST_WAIT
        return is_quiet | is_late | self._stands_still

    def encode(self, own: Grid, log_odds: Int8Grid, most: float) -> tuple[bytes, DecodedUpdate] | None:
        """Encode the update of this step, and set its `urgency`: the value of its tiles per byte."""
        encoded = super().encode(own, log_odds, most)
        if encoded is not None and self._values is not None:
            self.urgency = float(self._values.cells[self._chosen].sum()) / len(encoded[0])
        return encoded

    @property
    def _stands_still(self) -> bool:
        """Whether the robot is where it was in the last step."""
        return self._arrived < self._step

    def _ready(self) -> TileMask:
        """Return the tiles that may be encoded."""
        return self._waits() if self._stands_still else super()._ready()

    def _choose(self, own: Grid, log_odds: Int8Grid, most: float) -> TileMask:
        """Return the tiles of this step's update; none if it has been encoded: a second one could not be retracted."""
        values, chosen = self._values, np.zeros_like(self._violate)
        if values is None or self._last_step == self._step:
            return chosen
        useful = self._violate & (values.cells >= LEAST_CELLS)
        places = self._order(values, useful)
        chosen.reshape(-1)[places[: self._fitting(places, values, own, log_odds, most)]] = True
        self._is_worth_much, self._has_more = bool(useful.any()), bool((useful & ~chosen).any())
        return chosen

    def _order(self, values: TileValues, useful: TileMask) -> Int64s:
        """Return the tiles of one kind, by their flat indices, those first that are to be sent first.

        `useful` marks the tiles of the first two kinds.
        """
        if not useful.any():
            places = np.flatnonzero(self._violate)
            return places[np.argsort(self._waiting_since.reshape(-1)[places], kind="stable")]
        complete = self._complete(values, useful)
        return most_per_byte(values, complete if complete.any() else useful)

    def _complete(self, values: TileValues, useful: TileMask) -> TileMask:
        """Return the tiles of the first kind."""
        is_late = self._waiting_since <= self._step - LONGEST_WAIT
        return useful & (values.is_complete | is_late | self._stands_still)

    def _fitting(self, places: Int64s, values: TileValues, own: Grid, log_odds: Int8Grid, most: float) -> int:
        """Return how many of the tiles, in their order, have about `most` bytes, but at least 1."""
        sizes = np.cumsum(values.size.reshape(-1)[places])
        return max(1, int(np.searchsorted(sizes, most, side="right")))


def most_per_byte(values: TileValues, tiles: TileMask) -> Int64s:
    """Return some tiles, by their flat indices, those with the most value per byte first."""
    places = np.flatnonzero(tiles)
    rates = values.cells.reshape(-1)[places] / values.size.reshape(-1)[places]
    return places[np.argsort(-rates, kind="stable")]
