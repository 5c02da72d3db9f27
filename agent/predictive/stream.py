"""All that one robot tells of its map, unit by unit, and what it is built on.

A stream belongs to a maker. Who follows it holds the grid that the next unit is built on: what the maker itself has
told by then, and with base `team` what others have told in those of their units that the maker says it builds on. A
unit says first how many more units of each teammate that are, and can be read by who has read those; then come looks
and exceptions (`agent.predictive.scan_updates`). What the maker has told itself counts more in its stream than what others told.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.predictive import contexts
from agent.predictive.coder import (
    BROKEN,
    NUMBER,
    PLACE,
    Counts,
    Data,
    State,
    check_end,
    code_bit,
    code_number,
    reader,
    writer,
    written,
)
from agent.predictive.contexts import BUILT_ON, REST_MOST
from agent.predictive.history import Base, DecodedUpdate, History, key_of
from agent.predictive.scan_updates import (
    MAX_LOOKS,
    PLACES,
    STATE,
    TOLD,
    Cells,
    Way,
    X,
    Y,
    claims,
    code_exceptions,
    code_look,
    code_pose,
    differing,
)
from protocol.boxes import NO_BOX, Box, bounding_box
from protocol.errors import ProtocolError
from protocol.grid import UNKNOWN, Grid, RayTable
from protocol.kernels import kernel
from protocol.packets import Update

_ROOM = 1 << 10
"""Bytes that a unit may take at first; twice as many if it needs more."""


@dataclass(frozen=True)
class _Moment:
    """A stream as it was, but for its grid: that is brought back by writing what cells were before."""

    counts: Counts
    way: Way
    built: NDArray[np.int64]
    grew: NDArray[np.bool_]
    owed: Box
    key: bytes


class Stream:
    """One maker's stream, as its maker and all who follow it hold it.

    Parameters
    ----------
    maker : int
        Whose it is.
    grid : uint8 array, shape (h, w)
        Where it is kept, a byte a cell (`agent.predictive.scan_updates`); all unknown.
    fan : Fan
        The maker's beams.
    histories : sequence of History
        One a robot: what has been read of each stream. `encode` and `decode` append to the maker's own.
    scratch : int32 array, shape (2 h w, 2)
        Room for the cells that a unit changes; streams may share it.
    team : bool
        Whether it is built on what others told as well.
    makers : int, optional
        The number of the first stream that nothing is built on, nor on those behind it: a team's streams of later
        lives (`agent.identity`). So one that has not begun yet costs the others nothing.
    counts : uint16 array, shape (CONTEXTS, 2), optional
        What its contexts begin with, if not with the shipped table.
    """

    def __init__(
        self,
        maker: int,
        grid: Grid,
        ray_table: RayTable,
        histories: Sequence[History],
        scratch: Cells,
        *,
        team: bool,
        makers: int | None = None,
        counts: Counts | None = None,
    ) -> None:
        self.maker = maker
        self.grid = grid
        self.histories = histories
        self.built = np.zeros(len(histories), np.int64)
        """How many units of each robot's stream the last unit is built on."""
        self.key = b""
        """The last unit's key."""
        self._ray_table = ray_table
        self._scratch = scratch
        bases = range(len(histories) if makers is None else makers) if team else ()
        self._others = np.array([robot for robot in bases if robot != maker], np.int64)
        self._grew = np.zeros(len(histories), np.bool_)
        self._counts = contexts.start() if counts is None else counts
        self._way: Way = np.zeros(PLACES + 1, np.int64)
        self._owed = NO_BOX
        """Where the maker's own grid may differ from what follows from its units, and none has told so yet."""
        self._before: _Moment | None = None
        self._overwritten: list[tuple[NDArray[np.int32], NDArray[np.uint8]]] = []
        """Cells that the last unit has written, and what they were before, in that order."""

    @property
    def counts(self) -> Counts:
        """What has come how often in each context."""
        return self._counts

    @property
    def pose(self) -> tuple[int, int] | None:
        """Where the maker looked from last, as (x, y)."""
        return (int(self._way[X]), int(self._way[Y])) if self._way[PLACES] else None

    def encode(
        self, own: Grid, poses: Sequence[tuple[int, int]], box: Box, *, most: float = math.inf
    ) -> tuple[bytes, DecodedUpdate, int] | None:
        """Write the unit that tells of what has changed in a self-explored grid, or of as much as it has room for.

        Parameters
        ----------
        own : uint8 array, shape (h, w)
            The maker's self-explored grid.
        poses : sequence of (x, y)
            From where it looked since the last unit.
        box : Box
            Where the grid has changed since the last unit.
        most : float, optional
            Bytes behind which no more looks are told, but one at least, and `MAX_LOOKS` at most.

        Returns
        -------
        (message, told, looks), or None if there is nothing to tell, and the stream is as it was. If `looks`, which
        is how many of `poses` have been told of, is all, then `own` follows from the stream in every cell once the
        unit is read; else only what these show.
        """
        room, last = _ROOM, (self._before, self._overwritten)
        while True:
            state, data = writer(room)
            self._begin()
            told, looks = self._write(state, data, own, poses, box, most)
            if state[BROKEN]:
                self.undo()
                room *= 2
                continue
            if told is None:
                self.undo()
                self._before, self._overwritten = last
                return None
            message = written(state, data)
            return message, self._add(told, message), looks

    def decode(self, message: bytes) -> DecodedUpdate | None:
        """Read a unit; None if it is built on units that have not been read yet, and nothing has changed.

        Raises
        ------
        ProtocolError
            It makes no sense; nothing has changed.
        """
        state, data = reader(message)
        self._begin()
        try:
            told = self._read(state, data)
        except ProtocolError:
            self.undo()
            raise
        if told is None:
            self.undo()
            return None
        return self._add(told, message)

    def settle(self) -> None:
        """The last unit stands: it is not going to be undone."""
        self._before, self._overwritten = None, []

    def builds_from(self) -> NDArray[np.int64]:
        """The first unit of each robot's stream that this one may still ask for; also after `undo`."""
        return self.built if self._before is None else self._before.built

    def undo(self) -> None:
        """Go back to where the stream was before the last unit; what is in its history is left to the caller."""
        before = self._before
        assert before is not None
        self._counts, self._way, self._owed = before.counts, before.way, before.owed
        self.built, self._grew, self.key = before.built, before.grew, before.key
        for places, states in reversed(self._overwritten):
            _restore(self.grid.reshape(-1), places, states)
        self._overwritten = []
        self._before = None

    def _begin(self) -> None:
        """Begin a unit: keep what there is, and go on with copies."""
        self._before = _Moment(self._counts, self._way, self.built, self._grew, self._owed, self.key)
        self._counts, self._way = self._counts.copy(), self._way.copy()
        self.built, self._grew = self.built.copy(), self._grew.copy()
        self._overwritten = []

    def _add(self, told: DecodedUpdate, message: bytes) -> DecodedUpdate:
        """Add a unit to its maker's history, with all that is to be known of it."""
        assert self._before is not None
        bases = []
        for robot in np.flatnonzero(self.built > self._before.built).tolist():
            end = int(self.built[robot])
            bases.append(Base(robot, end, self.histories[robot].between(end - 1, end)[0].key))
        self.key = key_of(self.key, message, bases)
        told = replace(told, message=message, bases=tuple(bases), pose=self.pose, key=self.key)
        self.histories[self.maker].append(told)
        return told

    def _write(
        self, state: State, data: Data, own: Grid, poses: Sequence[tuple[int, int]], box: Box, most: float
    ) -> tuple[DecodedUpdate | None, int]:
        """Write a unit, and what it says into the grid; None if that is nothing. Return how many poses it tells of."""
        counts, way, grid, scratch = self._counts, self._way, self.grid, self._scratch
        cells, start = self._ray_table.cells, self._ray_table.start
        contradicted = self._build(state, data, own, poses, box)
        owed = bounding_box([self._owed, *contradicted, *((x, y, x + 1, y + 1) for x, y in poses)])
        box = bounding_box([box, owed])
        changed = looks = done = 0
        claimed = np.zeros(grid.shape, np.bool_)
        needed = [claims(grid, own, claimed, cells, start, x, y) for x, y in reversed(poses)]
        for (x, y), alone in zip(poses, reversed(needed), strict=True):
            if alone and (looks == MAX_LOOKS or (looks and state[PLACE] >= most)):
                break
            done += 1
            if alone:
                code_bit(state, data, counts, contexts.MORE + min(looks, 3), 1, REST_MOST)
                code_pose(state, data, counts, way, x, y)
                changed = code_look(state, data, counts, grid, own, cells, start, x, y, scratch, changed)
                looks += 1
        if looks < MAX_LOOKS:
            code_bit(state, data, counts, contexts.MORE + min(looks, 3), 0, REST_MOST)
        self._owed = NO_BOX if done == len(poses) else owed
        places = _places(grid, own, box) if done == len(poses) else np.empty(0, np.int32)
        looked = changed
        changed = code_exceptions(state, data, counts, grid, own, places, len(places), way, scratch, changed)
        return self._keep(changed if changed >= 0 else -1 - changed, looked) if changed else None, done

    def _read(self, state: State, data: Data) -> DecodedUpdate | None:
        """Read a unit into the grid; None if what it is built on is not there yet."""
        counts, way, grid, scratch = self._counts, self._way, self.grid, self._scratch
        height, width = grid.shape
        first = self.built.copy()
        self._code_bases(state, data, np.zeros(len(self.built), np.int64))
        more = np.flatnonzero(self.built > first).tolist()
        if any(len(self.histories[robot]) < self.built[robot] for robot in more):
            return None
        for robot in more:
            for unit in self.histories[robot].between(int(first[robot]), int(self.built[robot])):
                self._lay(unit)
        changed = looks = 0
        while looks < MAX_LOOKS and not state[BROKEN]:
            if not code_bit(state, data, counts, contexts.MORE + min(looks, 3), 0, REST_MOST):
                break
            code_pose(state, data, counts, way, 0, 0)
            x, y = int(way[X]), int(way[Y])
            if not (0 <= x < width and 0 <= y < height):
                self._keep(changed, changed)
                raise ProtocolError(Update.name, 0, f"cell ({x}, {y}) is outside the {width} x {height} grid")
            changed = code_look(
                state,
                data,
                counts,
                grid,
                grid,
                self._ray_table.cells,
                self._ray_table.start,
                x,
                y,
                scratch,
                changed,
            )
            looks += 1
        looked = changed
        changed = code_exceptions(
            state, data, counts, grid, grid, np.empty(0, np.int32), 0, way, scratch, changed
        )
        told = self._keep(changed if changed >= 0 else -1 - changed, looked)
        if changed < 0:
            raise ProtocolError(Update.name, 0, f"an exception is outside the {width} x {height} grid")
        check_end(state, Update.name)
        return told

    def _build(
        self, state: State, data: Data, own: Grid, poses: Sequence[tuple[int, int]], box: Box
    ) -> list[Box]:
        """Choose what the unit is built on: of each teammate's stream all up to the last unit that lies near.

        Returns boxes in which others contradict the robot's own grid.
        """
        reach = int(np.abs(self._ray_table.cells).max()) + 1
        near = bounding_box([box, *((x - reach, y - reach, x + reach + 1, y + reach + 1) for x, y in poses)])
        contradicted = []
        more = np.zeros(len(self.built), np.int64)
        for robot in self._others.tolist():
            history, first = self.histories[robot], int(self.built[robot])
            end = len(history)
            while (number := history.last_near(first, end, near)) >= 0:
                if _spares(self.grid, own, history.between(number, number + 1)[0].places, *near):
                    more[robot] = number + 1 - first
                    break
                end = number
            for unit in history.between(first, first + int(more[robot])):
                self._lay(unit)
                if _contradicts(own.reshape(-1), unit.places, unit.states):
                    contradicted.append(unit.box)
        self._code_bases(state, data, more)
        return contradicted

    def _code_bases(self, state: State, data: Data, more: NDArray[np.int64]) -> None:
        """Tell, or read, how many more units of each teammate's stream the unit is built on."""
        _code_bases(state, data, self._counts, self._others, more, self._grew, self.built)

    def _lay(self, unit: DecodedUpdate) -> None:
        """Write what another stream's unit says wherever the maker itself has not told anything."""
        before = np.empty(len(unit.places), np.uint8)
        _lay(self.grid.reshape(-1), unit.places, unit.states, before)
        self._overwritten.append((unit.places, before))

    def _keep(self, changed: int, looked: int) -> DecodedUpdate:
        """Note which cells have been written, and return what they say now.

        `looked` of them by looks, each once; exceptions may have changed some of those again.
        """
        places, before = self._scratch[:changed, 0].copy(), self._scratch[:changed, 1].astype(np.uint8)
        self._overwritten.append((places, before))
        if 0 < looked < changed:
            first = np.sort(np.unique(places, return_index=True)[1])
            places, before = places[first], before[first]
        y, x = np.divmod(places, self.grid.shape[1])
        box = (int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1) if changed else NO_BOX
        told = np.where(before & TOLD, before & STATE, UNKNOWN).astype(np.uint8)
        return DecodedUpdate(places, self.grid.reshape(-1)[places] & np.uint8(STATE), told, box)


def _places(grid: Grid, own: Grid, box: Box) -> NDArray[np.int32]:
    """Places, in the flat grid, where `own` does not follow from the stream."""
    found = np.empty(256, np.int32)
    count = differing(grid, own, *box, found)
    if count > len(found):
        found = np.empty(count, np.int32)
        differing(grid, own, *box, found)
    return found[:count]


@kernel("void(int64[::1], uint8[::1], uint16[:,::1], int64[::1], int64[::1], boolean[::1], int64[::1])")
def _code_bases(
    state: State,
    data: Data,
    counts: Counts,
    robots: NDArray[np.int64],
    more: NDArray[np.int64],
    grew: NDArray[np.bool_],
    built: NDArray[np.int64],
) -> None:
    """Code how many `more` units of each robot's stream a unit is built on; add them to those of before."""
    for robot in robots:
        row = BUILT_ON + NUMBER * int(grew[robot])
        number = code_number(state, data, counts, row, more[robot], REST_MOST)
        grew[robot] = number > 0
        built[robot] += number


@kernel("boolean(uint8[:,::1], uint8[:,::1], int32[::1], int64, int64, int64, int64)")
def _spares(grid: Grid, own: Grid, places: NDArray[np.int32], x0: int, y0: int, x1: int, y1: int) -> bool:
    """Whether a unit tells of a cell of a box that a robot knows, and would have to tell itself otherwise."""
    width = grid.shape[1]
    for place in places:
        x, y = place % width, place // width
        inside = x0 <= x < x1 and y0 <= y < y1
        if inside and own[y, x] != UNKNOWN and grid[y, x] & STATE == UNKNOWN:
            return True
    return False


@kernel("void(uint8[::1], int32[::1], uint8[::1], uint8[::1])")
def _lay(grid: Grid, places: NDArray[np.int32], states: Grid, before: Grid) -> None:
    """Write states where the maker has not told anything; `before` gets what was there."""
    for index in range(len(places)):
        place = places[index]
        before[index] = grid[place]
        if not grid[place] & TOLD:
            grid[place] = states[index]


@kernel("void(uint8[::1], int32[::1], uint8[::1])")
def _restore(grid: Grid, places: NDArray[np.int32], states: Grid) -> None:
    """Write states, the last one first."""
    for index in range(len(places) - 1, -1, -1):
        grid[places[index]] = states[index]


@kernel("boolean(uint8[::1], int32[::1], uint8[::1])")
def _contradicts(own: Grid, places: NDArray[np.int32], states: Grid) -> bool:
    """Whether a unit says otherwise of a cell than the robot's own grid."""
    for index in range(len(places)):
        truth = own[places[index]]
        if truth != UNKNOWN and truth != states[index]:
            return True
    return False
