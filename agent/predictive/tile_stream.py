"""Streams of maps of noisy lasers: an update codes the pose of the author, and changed tiles of its grid.

Receivers hold a grid that fits the author's own one within a tolerance (`agent.mapping.bound`). On narrow media, tiles
have half resolution (`BlockTileStream`).
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from agent.mapping.block_bound import BlockBound
from agent.mapping.bound import TILE, Bound, TileMask, tiles_of
from agent.mapping.estimator import Int8Grid
from agent.predictive import block_tiles, contexts
from agent.predictive.block_tiles import code_block_tiles
from agent.predictive.coder import Coder, code_bit
from agent.predictive.contexts import REST_MOST
from agent.predictive.history import DecodedUpdate
from agent.predictive.mixer import MixingCoder, mixing_coder
from agent.predictive.scan_updates import code_pose
from agent.predictive.stream import Stream
from agent.predictive.tiles import code_tiles, start_model
from protocol.boxes import Box, box_of
from protocol.grid import Cell, Grid


class TileStream(Stream):
    """Encoder and decoder of tiles."""

    state: ClassVar[tuple[str, ...]] = (*Stream.state, "_last_box")

    _start_model = staticmethod(start_model)

    def __init__(self, map_id: int, grid: Grid, *args: Any, **options: Any) -> None:
        super().__init__(map_id, grid, *args, **options)
        self.model = self._start_model()
        self._last_box = np.zeros(4, np.int64)
        self.target = np.zeros_like(grid)
        """The states that receivers shall hold in and around the tiles of the last call of `violations` or `encode`."""
        self._changed = np.zeros(tiles_of(*grid.shape), np.uint8)
        self.bases: list[Box] = []
        """Boxes of the other maps' updates on which the last encoded update was the first to depend."""

    def violations(self, own: Grid, log_odds: Int8Grid, bound: Bound, tiles: Grid) -> TileMask:
        """Return which of the marked tiles violate the bound; the parameters are those of `encode`."""
        self._apply(own, log_odds, bound, tiles)
        return self._changed.astype(np.bool_)

    def _apply(self, own: Grid, log_odds: Int8Grid, bound: Bound, tiles: Grid) -> int:
        """Compute which tiles change, and the states that receivers shall hold; return the number of these tiles."""
        return bound.apply(own, log_odds, self.grid, tiles, self.target, self._changed)

    def encode(
        self, own: Grid, log_odds: Int8Grid, bound: Bound, tiles: Grid, pose: Cell
    ) -> tuple[bytes, DecodedUpdate] | None:
        """Encode an update after which the cells of some tiles fulfill the bound.

        Updates of other maps may suffice for this: the update then consists of these dependencies.

        `own` and `log_odds`, shape (h, w), are states and log odds of the robot's estimator, `bound` the error that
        receivers' copies may have, `tiles` marks of the tiles, uint8 of shape (tile rows, tile columns), and `pose` the
        cell (x, y) of the robot. Returns message and update; None if all cells of the tiles fulfill the bound already:
        the stream is unchanged then.
        """
        if not self._apply(own, log_odds, bound, tiles):
            return None
        x0, y0, x1, y1 = box_of(tiles > 0)
        near = TILE * x0, TILE * y0, TILE * x1, TILE * y1

        def write(coder: Coder) -> DecodedUpdate:
            self.bases = [update.box for update in self._write_bases(coder, own, near)]
            code_pose(coder, self._motion, *pose)
            has_tiles = self._apply(own, log_odds, bound, tiles) > 0
            code_bit(coder, contexts.HAS_TILES, int(has_tiles), REST_MOST)
            return self._code_tiles(coder, self.target, has_tiles=has_tiles)

        return self._encode(write)

    def size(self, own: Grid, log_odds: Int8Grid, bound: Bound, tiles: Grid, pose: Cell) -> int:
        """Return the bytes of the update that `encode` would return, 0 for None; the stream is unchanged."""
        encoded = self.encode(own, log_odds, bound, tiles, pose)
        if encoded is None:
            return 0
        self.histories[self.map_id].pop()
        self.rollback()
        return len(encoded[0])

    def _read_content(self, coder: Coder) -> DecodedUpdate:
        """Decode the pose and the tiles."""
        self._read_pose(coder)
        self._changed[:] = 0
        has_tiles = code_bit(coder, contexts.HAS_TILES, 0, REST_MOST)
        return self._code_tiles(coder, self.grid, has_tiles=bool(has_tiles))

    def _code_tiles(self, coder: Coder, target: Grid, *, has_tiles: bool) -> DecodedUpdate:
        """Encode or decode the changed tiles, if there are any, into the grid."""
        changed = 0
        if has_tiles:
            model = mixing_coder(coder[0], coder[1], self.model)
            changed = self._code_changes(model, target)
        return self._decoded(changed, changed)

    def _code_changes(self, coder: MixingCoder, target: Grid) -> int:
        """Encode or decode the changed tiles; return the number of changed cells."""
        return int(code_tiles(coder, self.grid, target, self._changed, self._last_box, self._scratch))


class BlockTileStream(TileStream):
    """Encoder and decoder of tiles at half resolution (`agent.predictive.block_tiles`)."""

    _start_model = staticmethod(block_tiles.start_model)

    def __init__(self, map_id: int, grid: Grid, *args: Any, **options: Any) -> None:
        super().__init__(map_id, grid, *args, **options)
        self._exact = np.zeros_like(self._changed)
        """1 for changed tiles that have the resolution of cells."""

    def _apply(self, own: Grid, log_odds: Int8Grid, bound: Bound, tiles: Grid) -> int:
        assert isinstance(bound, BlockBound)
        return bound.apply_blocks(own, log_odds, self.grid, tiles, self.target, self._changed, self._exact)

    def _read_content(self, coder: Coder) -> DecodedUpdate:
        self._exact[:] = 0
        return super()._read_content(coder)

    def _code_changes(self, coder: MixingCoder, target: Grid) -> int:
        buffers = self._changed, self._exact, self._last_box, self._scratch
        return int(code_block_tiles(coder, self.grid, target, *buffers))
