"""Train the initial model of the predictive encoding's tiles at half resolution on generated maps.

``python -m deploy.study.block_tile_table FILE.npz`` writes it to a file.

The explorations are those of `deploy.study.tile_table`. Exact tiles are rare, so training begins with that table's
model of cells. The result is shipped as `agent.predictive.block_tiles.TABLE`.
"""

from __future__ import annotations

import sys

import numpy as np

from agent.predictive.block_tiles import untrained_model
from agent.predictive.model_table import packed
from agent.predictive.narrow_tile_author import NarrowTileAuthor
from agent.predictive.tile_stream import BlockTileStream
from deploy.study.tile_table import Encoder, train

ENCODERS = (
    Encoder(NarrowTileAuthor, 16, BlockTileStream, 40),
    Encoder(NarrowTileAuthor, 16, BlockTileStream, 80),
)
"""As in a team of eight with 15 to 40 bytes per step."""

if __name__ == "__main__":
    np.savez_compressed(sys.argv[1], **packed(train(untrained_model(), ENCODERS)))  # type: ignore[arg-type]
