"""All that one robot tells of its map, unit by unit, and what it is built on.

A stream belongs to a maker. Who follows it holds the grid that the next unit is built on: what the maker itself has
told by then, and with base `team` what others have told in those of their units that the maker says it builds on. A
unit says first how many more units of each teammate that are, and can be read by who has read those; then come looks
and exceptions (`agent.sight.looks`). What the maker has told itself counts more in its stream than what others told.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.sight import contexts
from agent.sight.coder import (
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
from agent.sight.looks import (
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
from protocol.errors import ProtocolError
from protocol.grid import UNKNOWN, Fan, Grid
from protocol.kernels import kernel
from protocol.packets import Look

_ROOM = 1 << 10
"""Bytes that a unit may take at first; twice as many if it needs more."""

Box = tuple[int, int, int, int]
"""Columns x0 to x1 - 1 and rows y0 to y1 - 1, as (x0, y0, x1, y1)."""

NO_BOX: Box = (1 << 30, 1 << 30, 0, 0)


@dataclass(frozen=True)
class Told:
    """What a unit says: cells, as places in the flat grid (int32), their states (uint8), and the box around them."""

    places: NDArray[np.int32]
    states: NDArray[np.uint8]
    box: Box


class History:
    """The units of a stream that have been read, numbered from 0; the oldest are forgotten once they are built on."""

    def __init__(self) -> None:
        self._units: list[Told] = []
        self._forgotten = 0

    def __len__(self) -> int:
        """All units ever read."""
        return self._forgotten + len(self._units)

    def append(self, unit: Told) -> None:
        """Add a unit at the end."""
        self._units.append(unit)

    def pop(self) -> None:
        """Take the last unit back."""
        self._units.pop()

    def between(self, first: int, end: int) -> list[Told]:
        """Units `first` to `end` - 1."""
        return self._units[first - self._forgotten : end - self._forgotten]

    def forget(self, before: int) -> None:
        """Drop the units before number `before`."""
        if before > self._forgotten:
            del self._units[: before - self._forgotten]
            self._forgotten = before


@dataclass(frozen=True)
class _Moment:
    """A stream as it was, but for its grid: that is brought back by writing what cells were before."""

    counts: Counts
    way: Way
    built: list[int]
    grew: list[bool]
    owed: Box


class Stream:
    """One maker's stream, as its maker and all who follow it hold it.

    Parameters
    ----------
    maker : int
        Whose it is.
    grid : uint8 array, shape (h, w)
        Where it is kept, a byte a cell (`agent.sight.looks`); all unknown.
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
        fan: Fan,
        histories: Sequence[History],
        scratch: Cells,
        *,
        team: bool,
        makers: int | None = None,
        counts: Counts | None = None,
    ) -> None:
        self.maker = maker
        self.grid = grid
        self.built = [0] * len(histories)
        """How many units of each robot's stream the last unit is built on."""
        self._fan = fan
        self._histories = histories
        self._scratch = scratch
        bases = range(len(histories) if makers is None else makers) if team else ()
        self._others = [robot for robot in bases if robot != maker]
        self._grew = [False] * len(histories)
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
    ) -> tuple[bytes, Told, int] | None:
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
        room = _ROOM
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
                return None
            message = written(state, data)
            self._histories[self.maker].append(told)
            return message, told, looks

    def decode(self, message: bytes) -> Told | None:
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
        self._histories[self.maker].append(told)
        return told

    def builds_from(self, robot: int) -> int:
        """The first unit of a robot's stream that this one may still ask for; also after `undo`."""
        return self.built[robot] if self._before is None else self._before.built[robot]

    def newly_built(self) -> list[tuple[int, int]]:
        """On how many units of whose streams the last unit is built, where these are more than before it."""
        before = [0] * len(self.built) if self._before is None else self._before.built
        return [(robot, units) for robot, units in enumerate(self.built) if units > before[robot]]

    def undo(self) -> None:
        """Go back to where the stream was before the last unit; what is in its history is left to the caller."""
        before = self._before
        assert before is not None
        self._counts, self._way, self._owed = before.counts, before.way, before.owed
        self.built, self._grew = before.built, before.grew
        for places, states in reversed(self._overwritten):
            _restore(self.grid.reshape(-1), places, states)
        self._overwritten = []
        self._before = None

    def _begin(self) -> None:
        """Begin a unit: keep what there is, and go on with copies."""
        self._before = _Moment(self._counts, self._way, self.built, self._grew, self._owed)
        self._counts, self._way = self._counts.copy(), self._way.copy()
        self.built, self._grew = self.built.copy(), self._grew.copy()
        self._overwritten = []

    def _write(
        self, state: State, data: Data, own: Grid, poses: Sequence[tuple[int, int]], box: Box, most: float
    ) -> tuple[Told | None, int]:
        """Write a unit, and what it says into the grid; None if that is nothing. Return how many poses it tells of."""
        counts, way, grid, scratch = self._counts, self._way, self.grid, self._scratch
        cells, start = self._fan.cells, self._fan.start
        contradicted = self._build(state, data, own, poses, box)
        owed = around([self._owed, *contradicted, *((x, y, x + 1, y + 1) for x, y in poses)])
        box = around([box, owed])
        changed = looks = done = 0
        claimed = np.zeros(grid.shape, np.bool_)
        needed = [claims(grid, own, claimed, cells, start, x, y) for x, y in reversed(poses)]
        for (x, y), alone in zip(poses, reversed(needed), strict=True):
            if alone and (looks == MAX_LOOKS or (looks and state[PLACE] >= most)):
                break
            done += 1
            if alone:
                code_bit(state, data, counts, contexts.MORE + min(looks, 3), 1, contexts.REST_MOST)
                code_pose(state, data, counts, way, x, y)
                changed = code_look(state, data, counts, grid, own, cells, start, x, y, scratch, changed)
                looks += 1
        if looks < MAX_LOOKS:
            code_bit(state, data, counts, contexts.MORE + min(looks, 3), 0, contexts.REST_MOST)
        self._owed = NO_BOX if done == len(poses) else owed
        places = _places(grid, own, box) if done == len(poses) else np.empty(0, np.int32)
        changed = code_exceptions(state, data, counts, grid, own, places, len(places), way, scratch, changed)
        return self._keep(changed if changed >= 0 else -1 - changed) if changed else None, done

    def _read(self, state: State, data: Data) -> Told | None:
        """Read a unit into the grid; None if what it is built on is not there yet."""
        counts, way, grid, scratch = self._counts, self._way, self.grid, self._scratch
        height, width = grid.shape
        first = self.built.copy()
        for robot in self._others:
            self._code_more(state, data, robot, 0)
        if any(len(self._histories[robot]) < self.built[robot] for robot in self._others):
            return None
        for robot in self._others:
            for unit in self._histories[robot].between(first[robot], self.built[robot]):
                self._lay(unit)
        changed = looks = 0
        while looks < MAX_LOOKS and not state[BROKEN]:
            if not code_bit(state, data, counts, contexts.MORE + min(looks, 3), 0, contexts.REST_MOST):
                break
            code_pose(state, data, counts, way, 0, 0)
            x, y = int(way[X]), int(way[Y])
            if not (0 <= x < width and 0 <= y < height):
                self._keep(changed)
                raise ProtocolError(Look.name, 0, f"cell ({x}, {y}) is outside the {width} x {height} grid")
            changed = code_look(
                state, data, counts, grid, grid, self._fan.cells, self._fan.start, x, y, scratch, changed
            )
            looks += 1
        changed = code_exceptions(
            state, data, counts, grid, grid, np.empty(0, np.int32), 0, way, scratch, changed
        )
        told = self._keep(changed if changed >= 0 else -1 - changed)
        if changed < 0:
            raise ProtocolError(Look.name, 0, f"an exception is outside the {width} x {height} grid")
        check_end(state, Look.name)
        return told

    def _build(
        self, state: State, data: Data, own: Grid, poses: Sequence[tuple[int, int]], box: Box
    ) -> list[Box]:
        """Choose what the unit is built on: of each teammate's stream all up to the last unit that lies near.

        Returns boxes in which others contradict the robot's own grid.
        """
        reach = int(np.abs(self._fan.cells).max()) + 1
        near = around([box, *((x - reach, y - reach, x + reach + 1, y + reach + 1) for x, y in poses)])
        contradicted = []
        for robot in self._others:
            history = self._histories[robot]
            units = history.between(self.built[robot], len(history))
            more = 0
            for number, unit in enumerate(units, 1):
                if _meet(unit.box, near) and _spares(self.grid, own, unit.places, *near):
                    more = number
            self._code_more(state, data, robot, more)
            for unit in units[:more]:
                self._lay(unit)
                if _contradicts(own.reshape(-1), unit.places, unit.states):
                    contradicted.append(unit.box)
        return contradicted

    def _code_more(self, state: State, data: Data, robot: int, more: int) -> None:
        """Tell, or read, how many more units of a teammate's stream the unit is built on."""
        row = contexts.BUILT_ON + NUMBER * self._grew[robot]
        more = code_number(state, data, self._counts, row, more, contexts.REST_MOST)
        self._grew[robot] = more > 0
        self.built[robot] += more

    def _lay(self, unit: Told) -> None:
        """Write what another stream's unit says wherever the maker itself has not told anything."""
        before = np.empty(len(unit.places), np.uint8)
        _lay(self.grid.reshape(-1), unit.places, unit.states, before)
        self._overwritten.append((unit.places, before))

    def _keep(self, changed: int) -> Told:
        """Note which cells have been written, and return what they say now."""
        places, before = self._scratch[:changed, 0].copy(), self._scratch[:changed, 1].astype(np.uint8)
        self._overwritten.append((places, before))
        y, x = np.divmod(places, self.grid.shape[1])
        box = (int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1) if changed else NO_BOX
        return Told(places, self.grid.reshape(-1)[places] & np.uint8(STATE), box)


def around(boxes: Sequence[Box]) -> Box:
    """Return the smallest box around boxes."""
    x0, y0, x1, y1 = zip(NO_BOX, *boxes, strict=True)
    return min(x0), min(y0), max(x1), max(y1)


def _meet(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _places(grid: Grid, own: Grid, box: Box) -> NDArray[np.int32]:
    """Places, in the flat grid, where `own` does not follow from the stream."""
    found = np.empty(256, np.int32)
    count = differing(grid, own, *box, found)
    if count > len(found):
        found = np.empty(count, np.int32)
        differing(grid, own, *box, found)
    return found[:count]


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
