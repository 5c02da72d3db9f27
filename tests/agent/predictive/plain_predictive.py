"""The coder and the updates in plain Python, as in docs/predictive.md: the reference for the kernels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from agent.predictive import contexts
from agent.predictive.coder import NUMBER, Counts
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, RayTable

Cell = tuple[int, int]


@dataclass
class Writer:
    """An arithmetic coder whose interval's lower end is one large number."""

    counts: Counts
    low: int = 0
    width: int = (1 << 32) - 1
    shifts: int = 0
    ideal: float = 0.0
    """Bits that the decisions would take without any rounding."""

    def bit(self, context: int, bit: int, most: int = contexts.REST_MOST) -> None:
        zeros, ones = map(int, self.counts[context])
        part = self.width * (2 * zeros + 1) // (2 * (zeros + ones) + 2)
        chance = (zeros + 0.5) / (zeros + ones + 1)
        self.ideal -= math.log2(1 - chance if bit else chance)
        if bit:
            self.low, self.width = self.low + part, self.width - part
        else:
            self.width = part
        while self.width < 1 << 24:
            self.low, self.width, self.shifts = self.low << 8, self.width << 8, self.shifts + 1
        self.counts[context, bit] += 1
        if zeros + ones + 1 >= most:
            self.counts[context] >>= 1

    def number(self, first: int, value: int) -> None:
        self.bit(first, int(value > 0))
        if not value:
            return
        length = value.bit_length() - 1
        for place in range(length):
            self.bit(first + 2 + place, 1)
        if length < 23:
            self.bit(first + 2 + length, 0)
        for place in range(length - 1, -1, -1):
            before = value >> place + 1
            row = 26 + (1 << length) - length - 1 + before - 1 if length <= 3 else 37 + place
            self.bit(first + row, value >> place & 1)

    def signed(self, first: int, value: int) -> None:
        self.number(first, abs(value))
        if value:
            self.bit(first + 1, int(value < 0))

    def message(self) -> bytes:
        for size in range(5):
            behind = (1 << 32 - 8 * size) - 1
            number = self.low + behind & ~behind
            if number <= self.low + self.width - 1:
                return (number >> 32 - 8 * size).to_bytes(self.shifts + size, "big")
        raise AssertionError("no number of 32 bits lies inside the interval")


@dataclass
class PlainStream:
    """The log of one map without dependencies: known cells, cells reported by the author, and the last scan."""

    shape: tuple[int, int]
    ray_table: RayTable
    counts: Counts = field(default_factory=contexts.start)
    last: Cell | None = None
    went: Cell = (0, 0)

    def __post_init__(self) -> None:
        self.known: Grid = np.zeros(self.shape, np.uint8)
        self.reported: NDArray[np.bool_] = np.zeros(self.shape, np.bool_)

    def update(self, own: Grid, poses: Sequence[Cell]) -> tuple[bytes, float]:
        """Encode an update that describes `own` without dependencies; return it and its entropy in bits."""
        writer = Writer(self.counts)
        scans = 0
        for pose in self._needed(own, poses):
            writer.bit(contexts.MORE_SCANS + min(scans, 3), 1)
            self._pose(writer, pose)
            self._look(writer, own, pose)
            scans += 1
        writer.bit(contexts.MORE_SCANS + min(scans, 3), 0)
        self._exceptions(writer, own)
        return writer.message(), writer.ideal

    def _beams(self, x: int, y: int) -> list[list[Cell]]:
        height, width = self.shape
        beams = []
        for beam in range(self.ray_table.beams):
            cells = []
            for dx, dy in self.ray_table.cells[
                self.ray_table.start[beam] : self.ray_table.start[beam + 1]
            ].tolist():
                if not (0 <= x + dx < width and 0 <= y + dy < height):
                    break
                cells.append((y + dy, x + dx))
            beams.append(cells)
        return beams

    def _needed(self, own: Grid, poses: Sequence[Cell]) -> list[Cell]:
        """The poses whose scans show something that no later one shows."""
        counted: set[Cell] = set()
        needed = []
        for x, y in reversed(poses):
            shown = {(y, x)} if self.known[y, x] == UNKNOWN and own[y, x] == FREE else set()
            for cells in self._beams(x, y):
                for cell in cells:
                    state = self.known[cell]
                    if state == UNKNOWN:
                        state = own[cell]
                        if state != UNKNOWN:
                            shown.add(cell)
                    if state != FREE:
                        break
            if shown - counted:
                needed.insert(0, (x, y))
            counted |= shown
        return needed

    def _pose(self, writer: Writer, pose: Cell) -> None:
        x, y = pose
        if self.last is None:
            for base, value in ((contexts.FIRST_POSE, x), (contexts.FIRST_POSE + 11, y)):
                for place in range(10, -1, -1):
                    writer.bit(base + place, value >> place & 1)
            self.last = pose
            return
        went = x - self.last[0], y - self.last[1]
        flip = [-1 if part < 0 else 1 for part in self.went]
        swap = abs(self.went[1]) > abs(self.went[0])
        before, now = (
            [part * sign for part, sign in zip(motion, flip, strict=True)] for motion in (self.went, went)
        )
        if swap:
            before, now = before[::-1], now[::-1]
        along, across = before
        kind = 0 if not along else 1 if not across else 3 if along == across else 2
        writer.bit(contexts.SAME_MOTION + kind, int(now == before))
        if now != before:
            farther = now[0] - along
            writer.signed(contexts.ALONG + kind * NUMBER, farther)
            row = contexts.ACROSS + (7 * kind + 3 + max(-3, min(3, farther))) * NUMBER
            writer.signed(row, now[1] - across)
        self.last, self.went = pose, went

    def _look(self, writer: Writer, own: Grid, pose: Cell) -> None:
        x, y = pose
        if self.known[y, x] == UNKNOWN:
            self._set((y, x), FREE)
        unseen_before = 0
        for cells in self._beams(x, y):
            asked = unseen = 0
            for cell in cells:
                if self.known[cell] == OCCUPIED:
                    break
                if self.known[cell] == FREE:
                    continue
                writer.bit(contexts.OBSERVED + 2 * unseen_before + asked, int(own[cell] != UNKNOWN))
                asked = 1
                if own[cell] == UNKNOWN:
                    unseen = 1
                    break
                wall = int(own[cell] == OCCUPIED)
                writer.bit(contexts.CELLS + self._around(cell), wall, contexts.CELLS_MOST)
                self._set(cell, OCCUPIED if wall else FREE)
                if wall:
                    break
            if asked:
                unseen_before = unseen

    def _around(self, cell: Cell) -> int:
        padded = np.pad(self.known, 1)
        block = padded[cell[0] : cell[0] + 3, cell[1] : cell[1] + 3].ravel().tolist()
        return int("".join(str(state) for state in block[:4] + block[5:]), 3)

    def _exceptions(self, writer: Writer, own: Grid) -> None:
        differs = np.where(own == UNKNOWN, self.reported, self.known != own)
        cells = np.argwhere(differs).tolist()
        writer.number(contexts.CORRECTIONS, len(cells))
        x, y = self.last or (0, 0)
        for index, (row, column) in enumerate(cells):
            if index == 0:
                writer.signed(contexts.FIRST_X, column - x)
                writer.signed(contexts.FIRST_Y, row - y)
            else:
                writer.number(contexts.NEXT_ROW, row - y)
                if row == y:
                    writer.number(contexts.SAME_ROW, column - x - 1)
                else:
                    writer.signed(contexts.OTHER_ROW, column - x)
            x, y = column, row
            before = int(self.known[row, column])
            writer.bit(contexts.CHANGED + before, int(own[row, column] == (before + 2) % 3))
            self._set((row, column), int(own[row, column]))

    def _set(self, cell: Cell, state: int) -> None:
        self.known[cell], self.reported[cell] = state, state != UNKNOWN
