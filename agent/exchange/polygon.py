"""The polygon exchange: incremental approximations, edits only (thesis, chapters 4 and 5).

A robot approximates its self-explored grid by polygons, keeps what teammates already hold of it, and logs the
edits that lead from there to the newest approximation. Teammates rebuild it at every save point, draw it, and
merge all drawings with their own grid.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from agent.exchange.base import Exchange
from agent.exchange.changed_cells import ChangedCells
from agent.outline.approximation import Marks, approximation, repair
from agent.outline.claims import Drawing
from agent.outline.contour import Tracer
from agent.outline.edits import edit_units, script_size
from agent.outline.merge import ErrorCount, TeamMap
from agent.outline.polygons import Polygons
from agent.outline.receiver import Receiver
from agent.outline.simplify import by_distance, mixed_first, refine
from agent.outline.splitting import SplitAllowance, Splitting
from agent.settings import Settings
from protocol.grid import Grid
from protocol.scans import Change, Scan

MAX_USE = 100
"""So many times the medium may be planned with at most."""


@dataclass(frozen=True)
class PolygonOptions:
    """Options of the polygon exchange; `THESIS_OPTIONS` are the thesis' plain rules.

    Attributes
    ----------
    medium_use : float
        Part u of the medium that the splitting frequency plans with (Eq. 5.5); it stands for a customised p of
        Eq. 5.6 as well, since only their product counts.
    bytes_per_split : float
        Mean bytes d that a split causes; 0: measured as the run goes.
    lazy : bool
        Log an edit script only once the teammates in range hold the one before, so that what changes twice
        is sent once. Splits of the steps between lapse: s of Eq. 5.5 is then a number per logged script. And
        while nobody is in range, what is told, and with it Eq. 6.1, stays as it was.
    mixed_first : bool
        Refine edges of mixed occupancy before all others: they send teammates to walls that are known.
    free_inside_edges : bool
        Draw inside edges that are labelled free. They claim cells free which nobody has seen.
    unknown_pairs : bool
        Tell of and draw outside objects that are approximated by two vertices and no occupied edge: unseen
        specks between beams, and small things whose walls are not told.
    wide_walls : bool
        Take what is unknown beside the wall of a teammate in range for wall: coarse walls run beside the true
        ones.
    close_slivers : bool
        Take unknown slivers between free cells that teammates have told of for free: there coarse areas meet.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    medium_use: float = 1.0
    bytes_per_split: float = 0.0
    lazy: bool = True
    mixed_first: bool = True
    free_inside_edges: bool = False
    unknown_pairs: bool = False
    wide_walls: bool = True
    close_slivers: bool = True

    def __post_init__(self) -> None:
        if not 0 < self.medium_use <= MAX_USE:
            raise ValueError(f"medium_use = {self.medium_use:g}: must be above 0 and at most {MAX_USE}")
        if self.bytes_per_split and not 1 <= self.bytes_per_split < math.inf:
            raise ValueError(
                f"bytes_per_split = {self.bytes_per_split:g}: must be 0 (measured), or 1 or more"
            )


THESIS_OPTIONS = PolygonOptions(
    medium_use=0.5,
    lazy=False,
    mixed_first=False,
    free_inside_edges=True,
    unknown_pairs=True,
    wide_walls=False,
    close_slivers=False,
)


class PolygonExchange(Exchange):
    """One robot's approximation of its own map, and what it holds of its teammates'."""

    name = "polygon"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        options = PolygonOptions(**settings.polygon)
        shape = settings.height, settings.width
        self._options = options
        self._value = mixed_first if options.mixed_first else by_distance
        self._drawing = Drawing(
            options.free_inside_edges, options.unknown_pairs, options.wide_walls, options.close_slivers
        )
        told = replace(self._drawing, wide_walls=False, close_slivers=False)
        self.guesses = settings.robots > 1 and (options.wide_walls or options.close_slivers)
        self._allowance = SplitAllowance(
            Splitting(
                settings.robots,
                settings.bandwidth,
                settings.reach_cells,
                settings.width,
                settings.height,
                options.medium_use,
                options.bytes_per_split or None,
            )
        )
        self._held = Receiver(shape)
        """One's own words, heard as teammates hear them."""
        self._outdated = True
        self._receivers = {
            robot: Receiver(shape) for robot in range(settings.robots) if robot != settings.robot
        }
        self._team = TeamMap(self._drawing)
        self._news: set[int] = set()
        """Teammates of whom a save point has come since the last merge."""
        self._error = ErrorCount(told)
        self._tracer = Tracer(shape)
        self._untraced, self._unmerged, self._uncounted = ChangedCells(), ChangedCells(), ChangedCells()

    @property
    def polygons(self) -> Mapping[int, Polygons]:
        """One's own approximation as far as it has been logged, and teammates' as far as they came."""
        held = {robot: receiver.held.polygons for robot, receiver in self._receivers.items()}
        held[self.settings.robot] = self._held.held.polygons
        return {robot: polygons for robot, polygons in held.items() if polygons.objects}

    def record(self, own: Grid, scan: Scan, change: Change, *, delivered: bool) -> list[bytes]:
        """Repair, refine, and log the edits (Algorithm 10, lines 6 to 13)."""
        self._outdated = self._outdated or change.cells > 0
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

    def take(self, about: int, units: list[bytes]) -> None:
        """Rebuild a teammate's approximation."""
        if self._receivers[about].feed(b"".join(units)):
            self._news.add(about)

    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Merge all approximations with the robot's own grid (Algorithm 9); draw those anew that have changed."""
        for about in sorted(self._news):
            receiver = self._receivers[about]
            self._team.update(about, receiver.held.polygons, receiver.changed())
        self._news.clear()
        return self._team.merged(own, peers, self._unmerged.take(own))

    def error(self, own: Grid) -> int:
        """Cells in which one's own grid and the drawing of its approximation differ: d(t) of Eq. 6.1.

        Without what receivers guess.
        """
        changed = self._held.changed()
        return self._error.count(own, self._held.held.polygons, self._uncounted.take(own), changed)
