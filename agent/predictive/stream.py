"""The update messages of one map, and the grid from which the next update is predicted.

The author of a map encodes its updates one after the other; every receiver decodes them in this order. Both keep the
same grid, of all cells that the author has reported.

With base `team`, the author need not report what teammates have reported. An update begins with its dependencies: the
number of further updates of each other map on which it depends. A receiver decodes it after it has decoded those. Their
cells are written to the grid, too, except where the author has reported a state itself.

The content follows: scans of exact lasers (`agent.predictive.scan_stream`), or tiles of a grid
(`agent.predictive.tile_stream`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence, Set
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from agent.predictive import contexts
from agent.predictive.coder import (
    FAILED,
    NUMBER,
    Coder,
    Counts,
    check_end,
    code_number,
    reader,
    writer,
    written,
)
from agent.predictive.contexts import BASES, REST_MOST
from agent.predictive.history import Base, DecodedUpdate, History, key_of
from agent.predictive.mixer import Model
from agent.predictive.scan_updates import REPORTED, SCANS, STATE, Motion, X, Y, code_pose
from protocol.arrays import Bools, Cells, Int32s, Int64s, Uint8s
from protocol.boxes import NO_BOX, Box
from protocol.errors import ProtocolError
from protocol.grid import UNKNOWN, Cell, Grid, check_cell
from protocol.kernels import kernel
from protocol.packets import Update

FIRST_BUFFER = 1 << 10
"""Bytes of the first output buffer of an update; it is doubled until the update fits."""


class Stream(ABC):
    """Encoder and decoder state of one map's log.

    `grid`, shape (h, w), has all reports, none at first (`agent.predictive.scan_updates`). `histories` are the decoded
    updates of each map, by map ID; `encode` and `decode` append to that of this map. `scratch`, int32 of shape
    (2 h w, 2), is a buffer for the cells that an update changes; streams may share it. With `team`, updates depend on
    other maps, but only on the first `base_maps`: those of later incarnations (`agent.identity`) would cost bits for
    dependencies that do not occur. `counts` are the initial ones of the contexts; default: the shipped table.
    """

    state: ClassVar[tuple[str, ...]] = ("counts", "_motion", "depends_on", "_bases_grew", "key", "model")
    """Attributes that an update changes, and that `rollback` restores; the grid is restored from `_overwritten`."""

    model: Model
    """The mixing model of the next update; empty if the stream does not mix predictions.

    Author and receivers must hold the same one, so only training replaces it.
    """

    is_narrow = False
    """Whether the medium is narrow. Then an update also depends on all that its bases depend on."""

    def __init__(
        self,
        map_id: int,
        grid: Grid,
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
        self._bases: list[Base] = []
        """Dependencies that the last update names, by ascending map ID."""
        self._scratch = scratch
        bases = range(len(histories) if base_maps is None else base_maps) if team else ()
        self._others = np.array([other for other in bases if other != map_id], np.int64)
        self._bases_grew = np.zeros(len(histories), np.bool_)
        self.counts = contexts.start() if counts is None else counts
        """How often 0 and 1 have occurred in each context: uint16 array, shape (CONTEXTS, 2)."""
        self._motion: Motion = np.zeros(SCANS + 1, np.int64)
        self._before: dict[str, Any] | None = None
        """The state before the last update."""
        self._overwritten: list[tuple[NDArray[np.int32], NDArray[np.uint8]]] = []
        """Cells written by the last update, as flat indices, and their previous values, in the order of writing."""

    @property
    def pose(self) -> Cell | None:
        """Cell (x, y) of the author's last scan; None before the first."""
        return (int(self._motion[X]), int(self._motion[Y])) if self._motion[SCANS] else None

    def decode(self, message: bytes) -> DecodedUpdate | None:
        """Decode an update; None if it depends on an update that has not been decoded (nothing has changed then).

        ProtocolError: the update is malformed; nothing has changed.
        """
        self._begin()
        coder = (*reader(message), self.counts)
        try:
            update = self._read_content(coder) if self._read_bases(coder) else None
            check_end(coder[0], Update.name) if update is not None else None
        except ProtocolError:
            self.rollback()
            raise
        if update is None:
            self.rollback()
            return None
        return self._add(update, message)

    @abstractmethod
    def _read_content(self, coder: Coder) -> DecodedUpdate:
        """Decode the content of an update into the grid; ProtocolError if a cell lies outside of it."""

    def commit(self) -> None:
        """Make the last update final, so that it cannot be rolled back."""
        self._before, self._overwritten = None, []

    def rollback(self) -> None:
        """Restore the state before the last update; the caller removes the update from the history."""
        assert self._before is not None
        vars(self).update(self._before)
        for places, states in reversed(self._overwritten):
            # of a cell that was written twice, the first value counts
            self.grid.reshape(-1)[places[::-1]] = states[::-1]
        self._before, self._overwritten = None, []

    def _begin(self) -> None:
        """Begin an update: save the state, and continue with copies."""
        now = vars(self)
        self._before = {name: now[name] for name in self.state}
        now |= {name: _copied(each) for name, each in self._before.items()}
        self._overwritten, self._bases = [], []

    def _encode(self, write: Callable[[Coder], DecodedUpdate | None]) -> tuple[bytes, DecodedUpdate] | None:
        """Encode an update: `write` codes it and applies it to the grid, again with more room until it fits.

        Returns the message and the update. None if `write` returns None: the stream is unchanged then.
        """
        size, last = FIRST_BUFFER, (self._before, self._overwritten)
        while True:
            self._begin()
            state, data = writer(size)
            update = write((state, data, self.counts))
            if not state[FAILED]:
                break
            self.rollback()
            size *= 2
        if update is None:
            self.rollback()
            self._before, self._overwritten = last
            return None
        message = written(state, data)
        return message, self._add(update, message)

    def _add(self, update: DecodedUpdate, message: bytes) -> DecodedUpdate:
        """Append an update to the history, with its message, dependencies, scan cell and key."""
        self.key = key_of(self.key, message, self._bases)
        ends = tuple(self.depends_on.tolist())
        update = DecodedUpdate(
            update.places, update.states, update.before, update.box,
            message, tuple(self._bases), ends, self.pose, self.key,
        )  # fmt: skip
        self.histories[self.map_id].append(update)
        return update

    def _read_bases(self, coder: Coder) -> bool:
        """Decode the dependencies and apply them to the grid; return whether all of them are there."""
        more = np.zeros(len(self.depends_on), np.int64)
        _code_bases(coder, self._others, more, self._bases_grew)
        for other in np.flatnonzero(more).tolist():
            end = int(self.depends_on[other] + more[other])
            if len(self.histories[other]) < end:
                return False
            self._depend_on(other, end)
        return True

    def _write_bases(self, coder: Coder, own: Grid, near: Box) -> list[DecodedUpdate]:
        """Choose, encode and apply the dependencies; return their updates.

        They are, of each other map, all updates up to the last one that reports a cell of the box `near` that the
        author would have to report itself.
        """
        more = np.zeros(len(self.depends_on), np.int64)
        applied: list[DecodedUpdate] = []
        lacking = lacking_box(self.grid, own, near)
        for other in self._others.tolist():
            first = int(self.depends_on[other])
            if len(self.histories[other]) > first and (end := self._find_base(other, own, lacking)):
                more[other] = end - first
                applied += self._depend_on(other, end)
                lacking = lacking_box(self.grid, own, near)
        _code_bases(coder, self._others, more, self._bases_grew)
        return applied

    def _find_base(self, other: int, own: Grid, near: Box) -> int:
        """Return on how many updates of map `other` the next update should depend; 0 for no more than the last one did.

        They end with the last update that reports a cell which the author would have to report itself.
        """
        history, first = self.histories[other], int(self.depends_on[other])
        end = len(history)
        while (number := history.last_near(first, end, near)) >= 0:
            update = history.between(number, number + 1)[0]
            is_avoided = other in self.avoided or (
                self.is_narrow and any(update.ends[each] > self.depends_on[each] for each in self.avoided)
            )
            if not is_avoided and _saves_cells(self.grid, own, update.places, near):
                return number + 1
            end = number
        return 0

    def _depend_on(self, other: int, end: int) -> list[DecodedUpdate]:
        """Depend on the updates of a map before number `end`, and apply them to the grid; return them.

        On a narrow medium, also on all updates on which the last of them depends.
        """
        last = self.histories[other].between(end - 1, end)[0]
        self._bases.append(Base(other, end, last.key))
        before = self.depends_on.copy()
        self.depends_on[other] = end
        if self.is_narrow:
            self.depends_on = np.maximum(self.depends_on, last.ends)
            self.depends_on[self.map_id] = 0
        updates = [
            update
            for each in np.flatnonzero(self.depends_on > before).tolist()
            for update in self.histories[each].between(int(before[each]), int(self.depends_on[each]))
        ]
        for update in updates:
            self._overlay(update)
        return updates

    def _read_pose(self, coder: Coder) -> Cell:
        """Decode the cell of a scan; ProtocolError if it lies outside the grid."""
        self._code_pose(coder, 0, 0)
        x, y = int(self._motion[X]), int(self._motion[Y])
        check_cell(Update.name, x, y, self.grid)
        return x, y

    def _code_pose(self, coder: Coder, x: int, y: int) -> None:
        """Encode or decode the cell of a scan, into the motion."""
        code_pose(coder, self._motion, x, y)

    def _overlay(self, update: DecodedUpdate) -> None:
        """Apply an update of another map to all cells that the author itself has not reported."""
        before = np.empty(len(update.places), np.uint8)
        _overlay(self.grid.reshape(-1), update.places, update.states, before)
        self._overwritten.append((update.places, before))

    def _decoded(self, changed: int, by_scans: int) -> DecodedUpdate:
        """Save the overwritten cells for `rollback`, and return their new states as an update.

        The first `by_scans` of the `changed` rows of the buffer have each cell once. Corrections may have written some
        of these cells again.
        """
        places, before = self._scratch[:changed, 0].copy(), self._scratch[:changed, 1].astype(np.uint8)
        self._overwritten.append((places, before))
        if 0 < by_scans < changed:
            first = np.sort(np.unique(places, return_index=True)[1])
            places, before = places[first], before[first]
        states, reported, box = _reports(self.grid, places, before)
        return DecodedUpdate(places, states, reported, box if changed else NO_BOX)


def _copied(value: Any) -> Any:
    """Return a value, with copies of all arrays."""
    if isinstance(value, tuple):
        return tuple(map(_copied, value))
    return value.copy() if isinstance(value, np.ndarray) else value


@kernel
def _code_bases(coder: Coder, maps: Int64s, more: Int64s, bases_grew: Bools) -> None:
    """Encode or decode the number of further updates of each map, `more`."""
    for other in maps:
        row = BASES + NUMBER * int(bases_grew[other])
        more[other] = code_number(coder, row, more[other], REST_MOST)
        bases_grew[other] = more[other] > 0


@kernel
def _reports(grid: Grid, places: Int32s, before: Uint8s) -> tuple[Uint8s, Uint8s, Box]:
    """Return the states of reported cells, those that the author reported `before`, and the cells' bounding box."""
    states, reported = np.empty(len(places), np.uint8), np.empty(len(places), np.uint8)
    x0, y0, x1, y1 = grid.shape[1], grid.shape[0], 0, 0
    for index in range(len(places)):
        y, x = divmod(places[index], grid.shape[1])
        states[index] = grid[y, x] & STATE
        reported[index] = before[index] & STATE if before[index] & REPORTED else UNKNOWN
        x0, y0, x1, y1 = min(x0, x), min(y0, y), max(x1, x + 1), max(y1, y + 1)
    return states, reported, (x0, y0, x1, y1)


@kernel
def lacking_box(grid: Grid, own: Grid, box: Box) -> Box:
    """Return the bounding box of the cells of a box that the robot knows and would have to report itself."""
    height, width = grid.shape
    x0, y0, x1, y1 = max(box[0], 0), max(box[1], 0), min(box[2], width), min(box[3], height)
    left, top, right, bottom = width, height, 0, 0
    for y in range(y0, y1):
        known, reported = own[y, x0:x1], grid[y, x0:x1]
        lacks = False
        for x in range(len(known)):  # without branches, so that compilers use vector instructions
            lacks |= (known[x] != UNKNOWN) & (reported[x] & STATE == UNKNOWN)
        for x in range(len(known) if lacks else 0):
            if known[x] != UNKNOWN and reported[x] & STATE == UNKNOWN:
                left, right = min(left, x0 + x), max(right, x0 + x + 1)
                top, bottom = min(top, y), y + 1
    return left, top, right, bottom


@kernel
def _saves_cells(grid: Grid, own: Grid, places: Int32s, box: Box) -> bool:
    """Whether an update reports a cell of the box that the robot knows and would have to report itself."""
    width, (x0, y0, x1, y1) = grid.shape[1], box
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
