"""The update messages of one map, and the grid from which the next update is predicted.

The author of a map encodes its updates one after the other; every receiver decodes them in this order. Both keep the
same grid: all cells that the author has reported and, with base `team`, cells reported by those updates of other maps
on which the author's updates depend. An update begins with these dependencies: the number of further updates of each
other map. A receiver decodes it after it has decoded those. Scans and corrections follow
(`agent.predictive.scan_updates`). In the grid of a map the reports of its author take precedence over those of others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence, Set
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.predictive import contexts
from agent.predictive.coder import (
    FAILED,
    NUMBER,
    PLACE,
    Coder,
    Counts,
    check_end,
    code_bit,
    code_number,
    reader,
    writer,
    written,
)
from agent.predictive.contexts import BASES, REST_MOST
from agent.predictive.history import Base, DecodedUpdate, History, key_of
from agent.predictive.scan_updates import (
    MAX_SCANS,
    REPORTED,
    SCANS,
    STATE,
    Motion,
    X,
    Y,
    code_corrections,
    code_pose,
    code_scan,
    count_new_cells,
    find_differences,
)
from protocol.arrays import Bools, Cells, Int32s, Int64s, Uint8s
from protocol.boxes import NO_BOX, Box, bounding_box
from protocol.errors import ProtocolError
from protocol.grid import UNKNOWN, Grid, RayTable
from protocol.kernels import kernel
from protocol.packets import Update

_BUFFER = 1 << 10
"""Bytes of the first output buffer of an update; it is doubled until the update fits."""


@dataclass(frozen=True)
class _Saved:
    """State of a stream before an update; its grid is restored from `_overwritten` instead."""

    counts: Counts
    motion: Motion
    depends_on: NDArray[np.int64]
    bases_grew: NDArray[np.bool_]
    unreported: Box
    key: bytes


class Stream:
    """Encoder and decoder state of one map's log.

    Parameters
    ----------
    map_id : int
        The map.
    grid : uint8 array, shape (h, w)
        The grid of all reports, all unknown at first (encoding: `agent.predictive.scan_updates`).
    ray_table : RayTable
        The beams of the map's author.
    histories : sequence of History
        The decoded updates of each map, by map ID. `encode` and `decode` append to the history of this map.
    scratch : int32 array, shape (2 h w, 2)
        Buffer for the cells that an update changes; streams may share it.
    team : bool
        Whether updates depend on other maps.
    base_maps : int, optional
        Number of maps on which updates may depend; those of later incarnations (`agent.identity`) follow them, and
        would cost bits for dependencies that do not occur. Default: all.
    counts : uint16 array, shape (CONTEXTS, 2), optional
        Initial counts of the contexts; default: the shipped table.
    """

    def __init__(
        self,
        map_id: int,
        grid: Grid,
        ray_table: RayTable,
        histories: Sequence[History],
        scratch: Cells,
        *,
        team: bool,
        base_maps: int | None = None,
        counts: Counts | None = None,
    ) -> None:
        self.map_id = map_id
        self.grid = grid
        self.histories = histories
        self.depends_on = np.zeros(len(histories), np.int64)
        """Number of updates of each map on which the last update depends."""
        self.key = b""
        """Key of the last update (`agent.predictive.history.key_of`)."""
        self.avoided: Set[int] = frozenset()
        """Maps on which no further updates shall depend."""
        self._ray_table = ray_table
        self._scratch = scratch
        bases = range(len(histories) if base_maps is None else base_maps) if team else ()
        self._others = np.array([other for other in bases if other != map_id], np.int64)
        self._bases_grew = np.zeros(len(histories), np.bool_)
        self._counts = contexts.start() if counts is None else counts
        self._motion: Motion = np.zeros(SCANS + 1, np.int64)
        self._unreported = NO_BOX
        """Box in which the author's self-explored grid may differ from the reported one, after an incomplete update."""
        self._before: _Saved | None = None
        self._overwritten: list[tuple[NDArray[np.int32], NDArray[np.uint8]]] = []
        """Cells written by the last update, as flat indices, and their previous values, in the order of writing."""

    @property
    def counts(self) -> Counts:
        """How often 0 and 1 have occurred in each context: uint16 array, shape (CONTEXTS, 2)."""
        return self._counts

    @property
    def pose(self) -> tuple[int, int] | None:
        """Cell (x, y) of the author's last scan; None before the first."""
        return (int(self._motion[X]), int(self._motion[Y])) if self._motion[SCANS] else None

    def encode(
        self, own: Grid, poses: Sequence[tuple[int, int]], box: Box, *, most: float = math.inf
    ) -> tuple[bytes, DecodedUpdate, int] | None:
        """Encode an update of what has changed in a self-explored grid, up to a limit.

        Parameters
        ----------
        poses : sequence of (x, y)
            Cells from which the robot has scanned since the last update.
        box : Box
            Where the grid has changed since the last update.
        most : float, optional
            Bytes after which no further scan is encoded. An update has one scan at least, and at most `MAX_SCANS`.

        Returns
        -------
        (message, update, scans)
            `scans` is the number of `poses` that the update covers. If it covers all of them, the decoded grid
            equals `own`; else it holds what these scans show. None if nothing is left to report; the stream is
            unchanged then.
        """
        size, last = _BUFFER, (self._before, self._overwritten)
        while True:
            self._begin()
            state, data = writer(size)
            update, scans = self._write((state, data, self._counts), own, poses, box, most)
            if state[FAILED]:
                self.rollback()
                size *= 2
                continue
            if update is None:
                self.rollback()
                self._before, self._overwritten = last
                return None
            message = written(state, data)
            return message, self._add(update, message), scans

    def decode(self, message: bytes) -> DecodedUpdate | None:
        """Decode an update; None if it depends on an update that has not been decoded (nothing has changed then).

        Raises
        ------
        ProtocolError
            The update is malformed; nothing has changed.
        """
        self._begin()
        coder = (*reader(message), self._counts)
        try:
            update = self._read(coder)
        except ProtocolError:
            self.rollback()
            raise
        if update is None:
            self.rollback()
            return None
        return self._add(update, message)

    def commit(self) -> None:
        """Make the last update final, so that it cannot be rolled back."""
        self._before, self._overwritten = None, []

    def first_needed(self) -> NDArray[np.int64]:
        """Return for each map its first update that a later update of this map may depend on, even after `rollback`."""
        return self.depends_on if self._before is None else self._before.depends_on

    def rollback(self) -> None:
        """Restore the state before the last update; the caller removes the update from the history."""
        before = self._before
        assert before is not None
        self._counts, self._motion, self._unreported = before.counts, before.motion, before.unreported
        self.depends_on, self._bases_grew, self.key = before.depends_on, before.bases_grew, before.key
        for places, states in reversed(self._overwritten):
            _restore(self.grid.reshape(-1), places, states)
        self._overwritten = []
        self._before = None

    def _begin(self) -> None:
        """Begin an update: save the state, and continue with copies."""
        self._before = _Saved(
            self._counts, self._motion, self.depends_on, self._bases_grew, self._unreported, self.key
        )
        self._counts, self._motion = self._counts.copy(), self._motion.copy()
        self.depends_on, self._bases_grew = self.depends_on.copy(), self._bases_grew.copy()
        self._overwritten = []

    def _add(self, update: DecodedUpdate, message: bytes) -> DecodedUpdate:
        """Append an update to the history, with its message, dependencies, scan cell and key."""
        assert self._before is not None
        bases = []
        for other in np.flatnonzero(self.depends_on > self._before.depends_on).tolist():
            end = int(self.depends_on[other])
            bases.append(Base(other, end, self.histories[other].between(end - 1, end)[0].key))
        self.key = key_of(self.key, message, bases)
        update = replace(update, message=message, bases=tuple(bases), pose=self.pose, key=self.key)
        self.histories[self.map_id].append(update)
        return update

    def _write(
        self, coder: Coder, own: Grid, poses: Sequence[tuple[int, int]], box: Box, most: float
    ) -> tuple[DecodedUpdate | None, int]:
        """Encode an update and apply it to the grid; return it, None if empty, and the number of covered poses."""
        motion, grid, scratch = self._motion, self.grid, self._scratch
        cells, start = self._ray_table.cells, self._ray_table.start
        contradicted = self._choose_bases(coder, own, poses, box)
        unreported = bounding_box(
            [self._unreported, *contradicted, *((x, y, x + 1, y + 1) for x, y in poses)]
        )
        box = bounding_box([box, unreported])
        changed = scans = done = 0
        counted = np.zeros(grid.shape, np.bool_)
        new_cells = [count_new_cells(grid, own, counted, cells, start, x, y) for x, y in reversed(poses)]
        for (x, y), shows_more in zip(poses, reversed(new_cells), strict=True):
            if shows_more and (scans == MAX_SCANS or (scans and coder[0][PLACE] >= most)):
                break
            done += 1
            if shows_more:
                code_bit(coder, contexts.MORE_SCANS + min(scans, 3), 1, REST_MOST)
                code_pose(coder, motion, x, y)
                changed = code_scan(coder, grid, own, cells, start, x, y, scratch, changed)
                scans += 1
        if scans < MAX_SCANS:
            code_bit(coder, contexts.MORE_SCANS + min(scans, 3), 0, REST_MOST)
        self._unreported = NO_BOX if done == len(poses) else unreported
        places = _places(grid, own, box) if done == len(poses) else np.empty(0, np.int32)
        by_scans = changed
        changed = code_corrections(coder, grid, own, places, len(places), motion, scratch, changed)
        return self._decoded(changed if changed >= 0 else -1 - changed, by_scans) if changed else None, done

    def _read(self, coder: Coder) -> DecodedUpdate | None:
        """Decode an update into the grid; None if a dependency is missing."""
        motion, grid, scratch = self._motion, self.grid, self._scratch
        height, width = grid.shape
        first = self.depends_on.copy()
        none = np.zeros(len(self.depends_on), np.int64)
        _code_bases(coder, self._others, none, self._bases_grew, self.depends_on)
        more = np.flatnonzero(self.depends_on > first).tolist()
        if any(len(self.histories[other]) < self.depends_on[other] for other in more):
            return None
        for other in more:
            for update in self.histories[other].between(int(first[other]), int(self.depends_on[other])):
                self._overlay(update)
        changed = scans = 0
        while scans < MAX_SCANS and not coder[0][FAILED]:
            if not code_bit(coder, contexts.MORE_SCANS + min(scans, 3), 0, REST_MOST):
                break
            code_pose(coder, motion, 0, 0)
            x, y = int(motion[X]), int(motion[Y])
            if not (0 <= x < width and 0 <= y < height):
                self._decoded(changed, changed)
                raise ProtocolError(Update.name, 0, f"cell ({x}, {y}) is outside the {width} x {height} grid")
            changed = code_scan(
                coder, grid, grid, self._ray_table.cells, self._ray_table.start, x, y, scratch, changed
            )
            scans += 1
        by_scans = changed
        changed = code_corrections(coder, grid, grid, np.empty(0, np.int32), 0, motion, scratch, changed)
        update = self._decoded(changed if changed >= 0 else -1 - changed, by_scans)
        if changed < 0:
            raise ProtocolError(Update.name, 0, f"a corrected cell is outside the {width} x {height} grid")
        check_end(coder[0], Update.name)
        return update

    def _choose_bases(self, coder: Coder, own: Grid, poses: Sequence[tuple[int, int]], box: Box) -> list[Box]:
        """Choose the dependencies: of each other map all updates up to the last one that saves cells near by.

        Returns boxes in which the chosen updates contradict the self-explored grid.
        """
        reach = int(np.abs(self._ray_table.cells).max()) + 1
        near = bounding_box([box, *((x - reach, y - reach, x + reach + 1, y + reach + 1) for x, y in poses)])
        contradicted = []
        more = np.zeros(len(self.depends_on), np.int64)
        for other in self._others.tolist():
            if other in self.avoided:
                continue
            history, first = self.histories[other], int(self.depends_on[other])
            end = len(history)
            while (number := history.last_near(first, end, near)) >= 0:
                if _saves_cells(self.grid, own, history.between(number, number + 1)[0].places, *near):
                    more[other] = number + 1 - first
                    break
                end = number
            for update in history.between(first, first + int(more[other])):
                self._overlay(update)
                if _contradicts(own.reshape(-1), update.places, update.states):
                    contradicted.append(update.box)
        _code_bases(coder, self._others, more, self._bases_grew, self.depends_on)
        return contradicted

    def _overlay(self, update: DecodedUpdate) -> None:
        """Apply an update of another map to all cells that the author itself has not reported."""
        before = np.empty(len(update.places), np.uint8)
        _overlay(self.grid.reshape(-1), update.places, update.states, before)
        self._overwritten.append((update.places, before))

    def _decoded(self, changed: int, by_scans: int) -> DecodedUpdate:
        """Save the overwritten cells for `rollback`, and return their new states as an update.

        Scans have written the first `by_scans` of the `changed` rows of the buffer, each cell once. Corrections may
        have written some of these cells again.
        """
        places, before = self._scratch[:changed, 0].copy(), self._scratch[:changed, 1].astype(np.uint8)
        self._overwritten.append((places, before))
        if 0 < by_scans < changed:
            first = np.sort(np.unique(places, return_index=True)[1])
            places, before = places[first], before[first]
        y, x = np.divmod(places, self.grid.shape[1])
        box = (int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1) if changed else NO_BOX
        reported = np.where(before & REPORTED, before & STATE, UNKNOWN).astype(np.uint8)
        return DecodedUpdate(places, self.grid.reshape(-1)[places] & np.uint8(STATE), reported, box)


def _places(grid: Grid, own: Grid, box: Box) -> NDArray[np.int32]:
    """Flat indices of the cells in which `own` differs from the reported grid."""
    found = np.empty(256, np.int32)
    count = find_differences(grid, own, *box, found)
    if count > len(found):
        found = np.empty(count, np.int32)
        find_differences(grid, own, *box, found)
    return found[:count]


@kernel
def _code_bases(coder: Coder, maps: Int64s, more: Int64s, bases_grew: Bools, depends_on: Int64s) -> None:
    """Code the number of further updates of each map, `more`, and add it to `depends_on`."""
    for other in maps:
        row = BASES + NUMBER * int(bases_grew[other])
        number = code_number(coder, row, more[other], REST_MOST)
        bases_grew[other] = number > 0
        depends_on[other] += number


@kernel
def _saves_cells(grid: Grid, own: Grid, places: Int32s, x0: int, y0: int, x1: int, y1: int) -> bool:
    """Whether an update reports a cell of the box that the robot knows and would have to report itself."""
    width = grid.shape[1]
    for place in places:
        x, y = place % width, place // width
        inside = x0 <= x < x1 and y0 <= y < y1
        if inside and own[y, x] != UNKNOWN and grid[y, x] & STATE == UNKNOWN:
            return True
    return False


@kernel
def _overlay(grid: Uint8s, places: Int32s, states: Uint8s, before: Uint8s) -> None:
    """Write states to the cells that the author has not reported; save the previous values in `before`."""
    for index in range(len(places)):
        place = places[index]
        before[index] = grid[place]
        if not grid[place] & REPORTED:
            grid[place] = states[index]


@kernel
def _restore(grid: Uint8s, places: Int32s, states: Uint8s) -> None:
    """Write states to cells, the last one first."""
    for index in range(len(places) - 1, -1, -1):
        grid[places[index]] = states[index]


@kernel
def _contradicts(own: Uint8s, places: Int32s, states: Uint8s) -> bool:
    """Whether an update reports a cell with another state than the self-explored grid has."""
    for index in range(len(places)):
        truth = own[places[index]]
        if truth != UNKNOWN and truth != states[index]:
            return True
    return False
