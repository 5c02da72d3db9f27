"""The streams and the author of the predictive encoding that fit a robot's laser and the medium.

    maps                        stream              author
    exact                       `ScanStream`        `ScanAuthor`
    tiles, unlimited medium     `TileStream`        `TileAuthor`
    tiles, limited medium       `TileStream`        `UrgentTileAuthor`
    tiles, narrow medium        `BlockTileStream`   `NarrowTileAuthor`

Maps are sent as tiles if they are noisy, or may have a tolerance (`Settings.shares_tiles`). With `patience` above 1,
all tiles have a `TileStream` and a `TileAuthor`. On a narrow medium without a tolerance, they have a `TileStream`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agent.encodings.update_packets import UpdateLimits
from agent.mapping.block_bound import BlockBound
from agent.mapping.bound import Bound
from agent.mapping.estimator import SETTLED
from agent.predictive.author import Author
from agent.predictive.history import History
from agent.predictive.narrow_tile_author import NarrowTileAuthor
from agent.predictive.scan_author import ScanAuthor
from agent.predictive.scan_stream import NarrowBand, ScanStream
from agent.predictive.stream import Stream
from agent.predictive.tile_author import TileAuthor
from agent.predictive.tile_stream import BlockTileStream, TileStream
from agent.predictive.urgent_tile_author import UrgentTileAuthor
from agent.settings import Settings
from protocol.arrays import Cells
from protocol.body import narrowest_opening
from protocol.grid import ray_table


def make_stream(
    settings: Settings, limits: UpdateLimits, scratch: Cells, map_id: int, histories: Sequence[History]
) -> Stream:
    """Make the encoder or decoder of a log, at its beginning; streams may share the buffer `scratch` (`Stream`)."""
    grid = np.zeros((settings.height, settings.width), np.uint8)
    predictive = settings.encoding.predictive
    base = {"team": predictive.base == "team", "base_maps": settings.robots}
    if settings.shares_tiles:
        in_blocks = limits.is_narrow and settings.encoding.tolerance > 0 and predictive.patience == 1
        kind = BlockTileStream if in_blocks else TileStream
        return kind(map_id, grid, histories, scratch, **base)
    body = settings.bodies[settings.author_of(map_id)]
    narrow = NarrowBand(body.speed, int(limits.step_bytes)) if limits.is_narrow else None
    beams = ray_table(body.range_cells, settings.beams)
    return ScanStream(map_id, grid, beams, histories, scratch, narrow=narrow, **base)


def make_author(settings: Settings, limits: UpdateLimits, stream: Stream) -> Author[Any]:
    """Make the author of this robot's log, which encodes its updates by a stream."""
    if isinstance(stream, ScanStream):
        return ScanAuthor(stream, limits.wait_steps, ranks=limits.fills > 0)
    assert isinstance(stream, TileStream)
    settled = 1 if settings.laser is None else SETTLED
    patience, tolerance = settings.encoding.predictive.patience, settings.encoding.tolerance
    if isinstance(stream, BlockTileStream):
        radii = {body.radius_cells for body in settings.bodies}
        openings = {narrowest_opening(radius, settings.resolution) for radius in radii}
        bound: Bound = BlockBound(tolerance, settled, openings=tuple(sorted(openings)))
    else:
        bound = Bound(tolerance, settled, closes_gaps=patience == 1)
    if settings.medium.bandwidth.limit is None or patience != 1:
        return TileAuthor(stream, bound, patience)
    return (NarrowTileAuthor if limits.is_narrow else UrgentTileAuthor)(stream, bound)
