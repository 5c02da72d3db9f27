"""The interface of all map encodings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from typing import Any, ClassVar, NamedTuple

import numpy as np

from agent.encodings.reachability_check import ReachabilityCheck
from agent.mapping.estimator import Int8Grid
from agent.outline.polygons import Polygons
from agent.settings import Settings
from protocol.errors import ProtocolError
from protocol.grid import Cell, Grid
from protocol.range_scans import RangeScan
from protocol.scans import GridChange, Scan

NO_SENDER = -2
"""The sender of entries that this robot decodes again."""


class Dependency(NamedTuple):
    """Packets `first` to `end` - 1 of a log can be decoded only after packets of other logs."""

    first: int
    end: int
    requires: tuple[tuple[int, int], ...]
    """Pairs (map_id, count): the first `count` packets of that log must have been decoded."""


class MapEncoding(ABC):
    """Encoder of this robot's map and decoder of its teammates' maps.

    A map travels as a log of packets. `encode_changes` appends to this robot's log; `apply` decodes packets of the
    logs of others.
    """

    name: ClassVar[str]
    needs_range_scans: ClassVar[bool] = False
    """Whether robots must have lasers or poses with errors: it encodes ranges in meters."""
    retractable: int = 0
    """Packets at the end of this robot's log that `retract_last` may still remove; 0: the log is final."""
    is_settled: bool = False
    """Whether retracting these packets would be in vain: packets encoded instead of them would hardly differ."""
    urgency: float | None = None
    """How much the packets added last change the plans of teammates, per byte; None: packets have no ranks."""
    update_steps: int = 1
    """Steps of which the longest update takes the budget."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.log_odds: Int8Grid = np.empty((0, 0), np.int8)
        self._reachability = ReachabilityCheck(settings)

    @classmethod
    def infers_cells(cls, settings: Settings) -> bool:
        """Whether planning grids hold cells that no robot reported, so that the frontier may open again."""
        return False

    @property
    def polygons(self) -> Mapping[int, Polygons]:
        """The polygons of each map, by map ID, this robot's included; a new object after each change."""
        return {}

    @property
    def doubted(self) -> Mapping[int, str]:
        """Why each robot is doubted whose map others contradict, by its number: its map does not count any more."""
        return {}

    def use_shared_cache(self, cache: dict[str, Any]) -> None:
        """Share decoded state with the other robots of this process; results do not change.

        The caller passes the same `cache` to all robots, before the first step.
        """

    def use_log_odds(self, log_odds: Int8Grid) -> None:
        """Read the certainty of the self-explored grid's cells in this array, int8 of shape (h, w), before each step.

        It holds log odds of noisy lasers (`agent.mapping.estimator`), else 0 for unknown cells.
        """
        self.log_odds = log_odds

    @abstractmethod
    def encode_changes(
        self, own: Grid, scan: Scan | RangeScan, change: GridChange, *, delivered: bool
    ) -> list[bytes]:
        """Return the packets to append to this robot's log for this step; none if nothing is to be sent.

        `own` is the self-explored grid, uint8 of shape (h, w), on which this step's `scan` is drawn; `change` is where
        the scan has changed it. `delivered`: teammates are in range, and all of them hold the whole log.
        """

    def has_news(self, own: Grid, *, delivered: bool) -> bool:
        """Return whether teammates lack parts of this robot's map that would change their plans.

        `own` and `delivered` are those of `encode_changes`. Only encodings that rank their packets know this.
        """
        return False

    def retract_last(self) -> None:
        """Remove the last `retractable` packets from the log; the caller vouches that no teammate received them."""
        self.retractable = 0

    @abstractmethod
    def apply(self, map_id: int, frame: bytes, *, step: int, sender: int) -> None:
        """Decode the next packets of the log of a map, in the order of the log.

        `frame` consists of whole packets. It arrived in step `step` from robot `sender`: the map's author, or a robot
        that forwards the map. ProtocolError: the packets are malformed, or report more than the author can have
        observed (`agent.encodings.reachability_check`); nothing has changed.
        """

    def rebuild(self, logs: Sequence[bytes], step: int) -> None:
        """Decode the logs of all maps again, by map ID, after entries at the end of some were dropped.

        A log that others depend on may lack entries, so a log may be decoded in part only.
        """
        self._reachability.forget()
        self.forget_received()
        for map_id, log in enumerate(logs):
            if map_id != self.settings.own_map and log:
                with suppress(ProtocolError):
                    self.apply(map_id, log, step=step, sender=NO_SENDER)

    @abstractmethod
    def forget_received(self) -> None:
        """Forget everything decoded from the logs of others."""

    def note_pose(self, robot: int, step: int, x: int, y: int) -> None:
        """Take a pose that a robot itself broadcast: its map must lie around it."""
        self._reachability.note_pose(robot, step, x, y)

    @abstractmethod
    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Return the planning grid: all decoded maps, overlaid by the self-explored grid.

        The next call overwrites it. The caller has passed all changes of `own` to `encode_changes`.
        `peers` are the teammates in range: their reports can still be corrected by them.
        """

    def shared_map(self, own: Grid, planning: Grid) -> Grid:
        """Return the team's map as this robot holds it: what all robots have reported to each other.

        On the planning grid, this robot's sight replaces reports; here, it only completes them. Default: the planning
        grid, for encodings whose reports do not form a grid.
        """
        return planning

    def scan_cell(self, map_id: int) -> Cell | None:
        """Cell (x, y) of the last scan that a map's log reports; None if logs do not report where scans were taken."""
        return None

    def dependencies(self, map_id: int) -> Sequence[Dependency]:
        """Dependencies of the decoded packets of a log on other logs, in the order of the log."""
        return ()

    def approximation_error(self, own: Grid) -> int:
        """Count the cells in which `own` differs from its logged approximation: d(t) of Eq. 6.1 in the thesis."""
        return 0

    def exact_error(self, own: Grid) -> int | None:
        """Count what `approximation_error` would be for exact contours; None if that is not measured."""
        return None
