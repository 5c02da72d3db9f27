"""When the tiles of a noisy map are encoded: once they have stopped changing, several at a time.

A tile is ready if its cells have not changed for `QUIET_STEPS` steps, or if it has waited for `LONGEST_WAIT` steps. A
tile that is sent while the robot still maps it costs more: it is sent again later, and the irregular border of its
known part takes more bytes than a complete tile. Ready tiles wait until there are `ENOUGH_TILES` of them, because each
update begins with some bytes of its own. Fewer suffice if one has waited for `LONGEST_WAIT` steps, or if the robot
stands still.

The option `patience` multiplies all of these numbers but `QUIET_STEPS`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.mapping.bound import TILE, Bound, TileMask, tiles_of
from agent.mapping.estimator import Int8Grid
from agent.predictive.author import Author
from agent.predictive.history import DecodedUpdate
from agent.predictive.tile_stream import TileStream
from protocol.boxes import Box
from protocol.grid import Grid
from protocol.range_scans import RangeScan
from protocol.scans import GridChange, Scan

QUIET_STEPS = 3
"""Steps without a change after which a tile is encoded."""

LONGEST_WAIT = 10
"""Steps after which a tile is encoded although it still changes."""

ENOUGH_TILES = 64
"""Tiles of an update that is sent at once."""

INTERVAL = 8
"""Steps between updates of fewer than `ENOUGH_TILES` tiles."""

TILE_BYTES = 0.75
"""Typical bytes of a tile in an update."""

_NEVER = 1 << 40


class TileAuthor(Author[TileStream]):
    """Encodes the tiles in which receivers' copies may lie outside the tolerance."""

    quiet_steps = QUIET_STEPS
    """Steps without a change after which a tile is encoded."""

    def __init__(self, stream: TileStream, bound: Bound, patience: int = 1) -> None:
        super().__init__(stream)
        self._enough_tiles, self._interval = patience * ENOUGH_TILES, patience * INTERVAL
        self._longest_wait = patience * LONGEST_WAIT
        height, width = stream.grid.shape
        shape = tiles_of(height, width)
        self._bound = bound
        self._pose = (0, 0)
        self._arrived = 0
        """The step in which the robot came to its cell."""
        self._step = 0
        self._last_step = 0
        """The step of the last update."""
        self._changed = np.full(shape, -_NEVER, np.int64)
        """The step in which each tile last changed."""
        self._waiting_since = np.full(shape, _NEVER, np.int64)
        """The step since which each tile has been waiting; `_NEVER` if it fulfills the bound."""
        self._encoded = self._waiting_since
        """`_waiting_since` before the last update."""
        self._chosen: TileMask = np.zeros(shape, np.bool_)
        """The tiles that `encode` chose last."""

    @property
    def has_changes(self) -> bool:
        """Whether tiles are waiting."""
        return bool(self._waits().any())

    def add(self, scan: Scan | RangeScan, change: GridChange) -> None:
        """Let the tiles near changed cells wait."""
        self._step += 1
        if self._pose != (scan.x, scan.y):
            self._pose, self._arrived = (scan.x, scan.y), self._step
        if change.cells:
            x0, y0, x1, y1 = change.box
            self._changed[y0 // TILE : (y1 - 1) // TILE + 1, x0 // TILE : (x1 - 1) // TILE + 1] = self._step
            self._wait(change.box)

    def _wait(self, box: Box) -> None:
        waiting = self._waiting_since[self._bound.tiles_near(box)]
        np.minimum(waiting, self._step, out=waiting)

    def is_due(self, own: Grid, log_odds: Int8Grid, received: Grid) -> bool:
        """Return whether enough tiles are ready, or fewer that should wait no longer.

        Ready tiles that fulfill the bound stop waiting.
        """
        violate = self._drop_fulfilled(own, log_odds)
        if np.count_nonzero(violate) >= self._enough_tiles:
            return True
        stands_still = violate.any() and self._arrived <= self._step - self.quiet_steps
        is_late = (self._waiting_since[violate] <= self._step - self._longest_wait).any()
        return bool((stands_still or is_late) and self._step >= self._last_step + self._interval)

    def _drop_fulfilled(self, own: Grid, log_odds: Int8Grid) -> TileMask:
        """Return the ready tiles that violate the bound; those that fulfill it stop waiting."""
        ready = self._ready()
        if not ready.any():
            return ready
        violate = self.stream.violations(own, log_odds, self._bound, ready.view(np.uint8))
        self._waiting_since[ready & ~violate] = _NEVER
        return violate

    def _ready(self) -> TileMask:
        """Return the tiles that may be encoded."""
        is_quiet = self._changed <= self._step - self.quiet_steps
        is_late = self._waiting_since <= self._step - self._longest_wait
        return self._waits() & (is_quiet | is_late)

    def _waits(self) -> TileMask:
        """Return the tiles that wait."""
        waits: TileMask = self._waiting_since != _NEVER
        return waits

    def encode(self, own: Grid, log_odds: Int8Grid, most: float) -> tuple[bytes, DecodedUpdate] | None:
        """Encode an update of tiles that are ready, of about `most` bytes."""
        since = self._waiting_since
        self._chosen = chosen = self._choose(own, log_odds, most)
        if not chosen.any():
            return None
        before = since.copy()
        encoded = self.stream.encode(own, log_odds, self._bound, chosen.view(np.uint8), self._pose)
        if encoded is not None:
            self._encoded, self._last_step = before, self._step
            for box in (encoded[1].box, *self.stream.bases):
                self._wait(box)  # cells of other tiles may have relied on walls that are gone
        since[chosen] = _NEVER
        return encoded

    def _choose(self, own: Grid, log_odds: Int8Grid, most: float) -> TileMask:
        """Return the tiles of the next update: those that are ready, or the first ones to wait."""
        chosen = self._ready()
        places = np.flatnonzero(chosen)
        limit = max(1, int(min(most / TILE_BYTES, len(places))))
        if len(places) > limit:
            first = places[np.argsort(self._waiting_since.reshape(-1)[places], kind="stable")[:limit]]
            chosen[:] = False
            chosen.reshape(-1)[first] = True
        return chosen

    def retract(self) -> None:
        """Take back the last update; its tiles wait again."""
        super().retract()
        self._last_step = self._step - self._interval
        np.minimum(self._waiting_since, self._encoded, out=self._waiting_since)

    def restart(self, stream: TileStream, withdrawn: Sequence[DecodedUpdate]) -> None:
        """Continue with another stream; all tiles wait."""
        super().restart(stream, withdrawn)
        height, width = stream.grid.shape
        self._wait((0, 0, width, height))
