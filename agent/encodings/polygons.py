"""The polygon exchange: incremental approximations, edits only (thesis, chapters 4 and 5).

A robot approximates its self-explored grid by polygons, keeps what teammates already hold of it, and logs the
edits that lead from there to the newest approximation. Teammates rebuild it at every save point, draw it, and
merge all drawings with their own grid.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

from agent.encodings.base import MapEncoding
from agent.encodings.changed_cells import ChangedCells
from agent.encodings.polygon_options import PolygonOptions
from agent.encodings.reachability_check import Reception
from agent.memo_cache import ALONE, MemoCache
from agent.outline.approximation import Marks, approximation, repair
from agent.outline.claims import Drawing
from agent.outline.contour import Tracer
from agent.outline.edit_reader import Saved
from agent.outline.edits import edit_units, script_size
from agent.outline.exact_error import ExactError
from agent.outline.merge import ErrorCount, TeamMap
from agent.outline.polygons import Polygons
from agent.outline.receiver import Receiver
from agent.outline.simplify import by_distance, mixed_first, refine
from agent.outline.splitting import SplitAllowance, Splitting
from agent.replication.map_ids import MapId
from agent.settings import Settings
from protocol.grid import Grid
from protocol.scans import Change, Scan


class PolygonEncoding(MapEncoding):
    """One robot's approximation of its own map, and what it holds of its teammates'."""

    name = "polygons"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        options = PolygonOptions(**settings.polygons)
        shape = settings.height, settings.width
        self._options = options
        self._value = mixed_first if options.mixed_first else by_distance
        self._drawing = Drawing(
            options.free_inside_edges,
            options.unknown_pairs,
            options.wide_walls,
            options.close_slivers,
            options.wide_seen_walls,
        )
        self._allowance = SplitAllowance(
            Splitting(
                settings.robots,
                settings.bandwidth,
                settings.reach_cells,
                settings.width,
                settings.height,
                options.medium_use,
                options.bytes_per_split or None,
                options.splits_per_step or None,
            )
        )
        self._outdated = True
        self._news: set[int] = set()
        """Teammates of whom a save point has come since the last merge."""
        self._told = replace(self._drawing, wide_walls=False, close_slivers=False)
        self._exact = ExactError(self._told) if options.exact_error else None
        self._tracer = Tracer(shape)
        self._untraced, self._unmerged, self._uncounted = ChangedCells(), ChangedCells(), ChangedCells()
        self._listen(ALONE)

    def _listen(self, once: MemoCache) -> None:
        """Begin to hear words, one's own as teammates hear them, and to draw what they say."""
        settings, shape = self.settings, (self.settings.height, self.settings.width)
        self._held = Receiver(shape, once)
        self._receivers = {
            map_id: Receiver(shape, once) for map_id in range(settings.maps) if map_id != settings.own_map
        }
        self._team = TeamMap(self._drawing, once)
        self._error = ErrorCount(self._told, once)

    def share(self, common: dict[str, Any]) -> None:
        """Read and draw what is told together with the other robots of this process."""
        if self.settings.robots > 1:
            self._listen(common.setdefault(self.name, MemoCache()))

    @classmethod
    def guesses(cls, settings: Settings) -> bool:
        """Wide walls and closed slivers are assumptions."""
        options = PolygonOptions(**settings.polygons)
        return settings.robots > 1 and (options.wide_walls or options.close_slivers)

    @property
    def polygons(self) -> Mapping[int, Polygons]:
        """One's own approximation as far as it has been logged, and teammates' as far as they came."""
        held = {map_id: receiver.held.polygons for map_id, receiver in self._receivers.items()}
        held[self.settings.own_map] = self._held.held.polygons
        return {map_id: polygons for map_id, polygons in held.items() if polygons.objects}

    def record(self, own: Grid, scan: Scan, change: Change, *, delivered: bool) -> list[bytes]:
        """Repair, refine, and log the edits (Algorithm 10, lines 6 to 13)."""
        self._outdated = self._outdated or change.cells > 0
        if self._exact is not None:
            self._exact.note(scan, change)
        for news in (self._untraced, self._unmerged, self._uncounted):
            news.add(own, change)
        if self._options.lazy and not delivered and self.settings.robots > 1:
            return []
        splits = self._allowance.next_step()
        if not self._outdated and not splits:
            return []
        exact = self._tracer.contours(own, (scan.x, scan.y), self._untraced.take(own))
        held = self._held.held
        repaired = repair(held.polygons, exact)
        refined = refine(exact, repaired, splits, self._value)
        units = edit_units(held, self._approximation(exact, refined))
        said = b"".join(units)
        if splits and len(refined) > len(repaired):
            extra = len(said) - script_size(held, self._approximation(exact, repaired))
            self._allowance.spent(len(refined) - len(repaired), max(0, extra))
        self._outdated = False
        if said:
            self._held.feed(said)
        return units

    def _approximation(self, exact: Polygons, marks: Marks) -> Polygons:
        """What is told of the contours: unless they are drawn, not the objects of two unknown edges.

        An object that was told and has shrunk to these is removed; should it grow, it emerges anew.
        """
        return approximation(exact, marks, unknown_pairs=self._options.unknown_pairs)

    def take(self, map_id: MapId, frame: bytes, reception: Reception) -> None:
        """Rebuild a teammate's approximation."""

        def check(saved: Saved) -> None:
            if saved.box is not None:
                self.reachability_check.claim(map_id, saved.box, reception, saved.saves)

        if self._receivers[map_id.number].feed(frame, check):
            self._news.add(map_id.number)

    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Merge all approximations with the robot's own grid (Algorithm 9); draw those anew that have changed."""
        for map_id in sorted(self._news):
            receiver = self._receivers[map_id]
            self._team.update(map_id, receiver.objects, receiver.changed())
        self._news.clear()
        near = [number for number in self._receivers if self.maps[number].robot in peers]
        return self._team.merged(own, near, self._unmerged.take(own))

    def error(self, own: Grid) -> int:
        """Cells in which one's own grid and the drawing of its approximation differ: d(t) of Eq. 6.1.

        Without what receivers guess.
        """
        changed = self._held.changed()
        return self._error.count(own, self._held.objects, self._uncounted.take(own), changed)

    def exact_error(self, own: Grid) -> int | None:
        """What that would be if the approximation were exact: Algorithm 9 does not know all cells."""
        return None if self._exact is None else self._exact.count(own)
