"""The `polygons` encoding: edits of an incremental polygonal approximation (thesis, chapters 4 and 5).

A robot approximates its self-explored grid by polygons. It logs the edits that lead from the approximation logged so
far to the newest one. Teammates rebuild the approximation at every save point, draw it, and merge all drawings with
their own grid.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import fields, replace
from typing import Any

from agent.encodings.base import MapEncoding
from agent.encodings.received_grid import ChangedCells
from agent.memo_cache import NO_CACHE, MemoCache
from agent.outline.approximation import Marks, approximation, repair
from agent.outline.claims import Drawing
from agent.outline.contour import Tracer
from agent.outline.edit_reader import SavePoint
from agent.outline.edits import NumberedPolygons, edit_packets
from agent.outline.extraction import extracted
from agent.outline.merge import ErrorCount, TeamMap, exact_error
from agent.outline.polygons import Polygons
from agent.outline.receiver import Receiver
from agent.outline.simplify import refine
from agent.outline.splitting import SplitAllowance
from agent.planning.small_frontiers import without_small_frontiers
from agent.settings import Settings
from protocol.grid import Grid
from protocol.range_scans import RangeScan
from protocol.scans import GridChange, Scan


class PolygonEncoding(MapEncoding):
    """The approximation of this robot's map, and those received from its teammates."""

    name = "polygons"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        options = settings.encoding.polygons
        shape = settings.height, settings.width
        self._options = options
        self._drawing = Drawing(**{part.name: getattr(options, part.name) for part in fields(Drawing)})
        self._allowance = SplitAllowance(
            settings.robots,
            settings.medium.bandwidth.limit,
            settings.medium.reach_cells,
            settings.width,
            settings.height,
            medium_use=options.medium_use,
            bytes_per_split=options.bytes_per_split or None,
            fixed=options.splits_per_step or None,
        )
        self._outdated = True
        self._updated: set[int] = set()
        """Maps with a save point received since the last merge."""
        self._replaced: set[int] = set()
        """Maps that were decoded again since then, so that all of their drawing may have changed."""
        self._without_inference = replace(self._drawing, wide_walls=False, close_slivers=False)
        self._scan_cell = 0, 0
        self._tracer = Tracer(shape)
        self._untraced, self._unmerged, self._uncounted = ChangedCells(), ChangedCells(), ChangedCells()
        self._authors = [settings.author_of(map_id) for map_id in range(settings.maps)]
        self._make_receivers(NO_CACHE)

    def _make_receivers(self, cache: MemoCache) -> None:
        """Make a receiver for each map; this robot's own log is decoded as well, as teammates decode it."""
        settings, shape = self.settings, (self.settings.height, self.settings.width)
        self._cache = cache
        self._held = Receiver(shape, cache)
        self._receivers = {
            map_id: Receiver(shape, cache) for map_id in range(settings.maps) if map_id != settings.own_map
        }
        self._team = TeamMap(self._drawing, cache)
        self._error = ErrorCount(self._without_inference, cache)

    def use_shared_cache(self, cache: dict[str, Any]) -> None:
        """Decode and draw each log once for all robots of this process."""
        if self.settings.robots > 1:
            self._make_receivers(cache.setdefault(self.name, MemoCache()))

    def forget_received(self) -> None:
        """Forget everything decoded from the logs of others."""
        for map_id, receiver in self._receivers.items():
            if receiver.held.polygons.objects:
                self._updated.add(map_id)
                self._replaced.add(map_id)
            self._receivers[map_id] = Receiver((self.settings.height, self.settings.width), self._cache)

    @classmethod
    def infers_cells(cls, settings: Settings) -> bool:
        """Whether wide walls or closed slivers are inferred."""
        options = settings.encoding.polygons
        return settings.robots > 1 and (options.wide_walls or options.close_slivers)

    @property
    def polygons(self) -> Mapping[int, Polygons]:
        """This robot's approximation as logged so far, and those of teammates as received so far."""
        held = {map_id: receiver.held.polygons for map_id, receiver in self._receivers.items()}
        held[self.settings.own_map] = self._held.held.polygons
        return {map_id: polygons for map_id, polygons in held.items() if polygons.objects}

    def encode_changes(
        self, own: Grid, scan: Scan | RangeScan, change: GridChange, *, delivered: bool
    ) -> list[bytes]:
        """Repair and refine the approximation, and encode the edits (Algorithm 10, lines 6 to 13)."""
        self._outdated = self._outdated or change.cells > 0
        self._scan_cell = scan.x, scan.y
        for changes in (self._untraced, self._unmerged, self._uncounted):
            changes.add(own, change)
        if self._options.lazy and not delivered and self.settings.robots > 1:
            return []
        splits = self._allowance.next_step()
        if not self._outdated and not splits:
            return []
        exact = self._contours(own, scan)
        held = self._held.held
        repaired = repair(held.polygons, exact)
        refined = refine(
            exact,
            repaired,
            splits,
            mixed_first=self._options.mixed_first,
            value_function=self._options.value_function,
        )
        packets = self._edits(held, exact, refined)
        script = b"".join(packets)
        if splits and len(refined) > len(repaired):
            without = self._edits(held, exact, repaired)
            extra = len(script) - sum(map(len, without))
            self._allowance.spent(len(refined) - len(repaired), max(0, extra))
        self._outdated = False
        if script:
            self._held.feed(script)
        return packets

    def _contours(self, own: Grid, scan: Scan | RangeScan) -> Polygons:
        """Extract the contours of the self-explored grid.

        Where robots leave small frontiers, these are walls. If they stayed unknown, coarse edges would drop the walls
        around them, and teammates would find frontiers along these.
        """
        changed, least = self._untraced.take(own), self.settings.min_frontier_cells
        if least > 1:
            own, changed = without_small_frontiers(own, least), None
        exact = self._tracer.contours(own, (scan.x, scan.y), changed)
        return extracted(exact) if self._options.moving_starts else exact

    def _edits(self, held: NumberedPolygons, exact: Polygons, marks: Marks) -> list[bytes]:
        """Encode the packets that turn the held approximation into that of `marks`.

        An object that has shrunk to two unknown edges is removed without `unknown_pairs`; if it grows again, it emerges
        anew.
        """
        options = self._options
        wanted = approximation(exact, marks, unknown_pairs=options.unknown_pairs)
        return edit_packets(held, wanted, scan_order=options.scan_order, shifts=not options.moving_starts)

    def apply(self, map_id: int, frame: bytes, *, step: int, sender: int) -> None:
        """Apply edits to a received approximation."""

        def check(saved: SavePoint) -> None:
            if saved.box is not None:
                self._reachability.check(map_id, saved.box, saved.saves, step=step, sender=sender)

        if self._receivers[map_id].feed(frame, check):
            self._updated.add(map_id)

    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Merge all approximations with the self-explored grid (Algorithm 9); redraw those that have changed."""
        for map_id in sorted(self._updated):
            receiver = self._receivers[map_id]
            changed = receiver.changed()
            self._team.update(map_id, receiver.objects, None if map_id in self._replaced else changed)
        self._updated.clear()
        self._replaced.clear()
        near = [map_id for map_id in self._receivers if self._authors[map_id] in peers]
        return self._team.merged(own, near, self._unmerged.take(own))

    def approximation_error(self, own: Grid) -> int:
        """Count the cells in which the self-explored grid and its drawn approximation differ: d(t) of Eq. 6.1.

        The drawing has no inferred cells (wide walls, closed slivers).
        """
        changed = self._held.changed()
        return self._error.count(own, self._held.objects, self._uncounted.take(own), changed)

    def exact_error(self, own: Grid) -> int | None:
        """Count the same for an exact approximation: Algorithm 9 leaves some cells unknown."""
        return (
            exact_error(own, self._scan_cell, self._without_inference) if self._options.exact_error else None
        )
