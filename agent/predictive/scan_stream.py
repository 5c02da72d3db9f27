"""Streams of maps of exact lasers: an update codes scans, and corrections of what they reveal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from agent.predictive import contexts
from agent.predictive.coder import AHEAD, DECODES, FAILED, PLACE, Coder, code_bit, writer, written
from agent.predictive.contexts import REST_MOST
from agent.predictive.history import DecodedUpdate
from agent.predictive.mixer import Model, mixing_coder
from agent.predictive.pose_model import code_predicted_pose, start_factors
from agent.predictive.scan_updates import (
    MAX_SCANS,
    STATE,
    code_corrections,
    code_scan,
    find_differences,
    find_new_cells,
)
from agent.predictive.stream import FIRST_BUFFER, Stream
from agent.predictive.wall_model import no_model, start_model
from protocol.arrays import Int32s, Uint8s
from protocol.boxes import NO_BOX, Box, bounding_box
from protocol.errors import ProtocolError
from protocol.grid import UNKNOWN, Grid, RayTable
from protocol.kernels import kernel
from protocol.packets import Update


@dataclass(frozen=True)
class NarrowBand:
    """What predictions of updates on a narrow medium depend on; author and receivers must have the same values."""

    speed: float
    """Cells that the author drives in a step."""
    update_bytes: float
    """The usual limit of an update."""

    @property
    def milli_speed(self) -> int:
        """The speed in 1/1000 cell per step, at least 1."""
        return max(round(1000 * self.speed), 1)


class ScanStream(Stream):
    """Encoder and decoder of scans from whole cells, with the beams of the map's author (`ray_table`).

    With `narrow`, walls, poses, and ends of updates are coded by better predictions, which take more time.
    """

    state: ClassVar[tuple[str, ...]] = (
        *Stream.state, "_unreported", "_chances", "_ages", "_weights", "_was_full",
    )  # fmt: skip

    def __init__(
        self,
        map_id: int,
        grid: Grid,
        ray_table: RayTable,
        *args: Any,
        narrow: NarrowBand | None = None,
        **options: Any,
    ) -> None:
        options.setdefault("counts", contexts.start(narrow=narrow is not None))
        super().__init__(map_id, grid, *args, **options)
        self._chances, self._ages, self._weights = start_model() if narrow else no_model()
        self._narrow = narrow
        self._was_full = False
        """Whether the last update was at its limit, so that more scans wait."""
        self.ray_table = ray_table
        self._reach = int(np.abs(ray_table.cells).max()) + 1
        """Cells around a robot, in each direction, that a scan may change."""
        self._unreported = NO_BOX
        """Box in which the author's self-explored grid may differ from the reported one, after an incomplete update."""

    @property
    def model(self) -> Model:
        """The model of walls that codes the next update; empty if the stream does not mix predictions.

        Author and receivers must hold the same one, so only training replaces it.
        """
        return self._chances, self._ages, self._weights

    @model.setter
    def model(self, model: Model) -> None:
        self._chances, self._ages, self._weights = model

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
        size, last = FIRST_BUFFER, (self._before, self._overwritten)
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

    def _write(
        self, coder: Coder, own: Grid, poses: Sequence[tuple[int, int]], box: Box, most: float
    ) -> tuple[DecodedUpdate | None, int]:
        """Encode an update and apply it to the grid; return it, None if empty, and the number of covered poses."""
        motion, grid, scratch = self._motion, self.grid, self._scratch
        cells, start = self.ray_table.cells, self.ray_table.start
        contradicted = self._choose_bases(coder, own, poses, bounding_box([box, self._unreported]))
        unreported = bounding_box(
            [self._unreported, *contradicted, *((x, y, x + 1, y + 1) for x, y in poses)]
        )
        box = bounding_box([box, unreported])
        mixing = mixing_coder(coder[0], coder[1], self.model)
        changed = scans = done = 0
        for (x, y), found in zip(poses, self._find_new_cells(own, poses), strict=True):
            shows_more = len(found) > 0
            if self._narrow:  # cells that an earlier scan of this update has revealed do not count
                shows_more = (grid.reshape(-1)[found] & STATE == UNKNOWN).any()
            if shows_more and (scans == MAX_SCANS or (scans and coder[0][PLACE] >= most)):
                break
            done += 1
            if shows_more:
                self._code_more(coder, scans, 1)
                self._code_pose(coder, x, y)
                changed = code_scan(coder, mixing, grid, own, cells, start, x, y, scratch, changed)
                scans += 1
        if scans < MAX_SCANS:
            self._code_more(coder, scans, 0)
        self._unreported = NO_BOX if done == len(poses) else unreported
        places = _places(grid, own, box) if done == len(poses) else np.empty(0, np.int32)
        by_scans = changed
        changed = code_corrections(coder, grid, own, places, len(places), motion, scratch, changed)
        return self._decoded(changed if changed >= 0 else -1 - changed, by_scans) if changed else None, done

    def _read_content(self, coder: Coder) -> DecodedUpdate:
        """Decode scans and corrections."""
        grid, scratch = self.grid, self._scratch
        cells, start = self.ray_table.cells, self.ray_table.start
        mixing = mixing_coder(coder[0], coder[1], self.model)
        changed = scans = 0
        while scans < MAX_SCANS and not coder[0][FAILED]:
            if not self._code_more(coder, scans, 0):
                break
            try:
                x, y = self._read_pose(coder)
            except ProtocolError:
                self._decoded(changed, changed)
                raise
            changed = code_scan(coder, mixing, grid, grid, cells, start, x, y, scratch, changed)
            scans += 1
        by_scans = changed
        changed = code_corrections(
            coder, grid, grid, np.empty(0, np.int32), 0, self._motion, scratch, changed
        )
        update = self._decoded(changed if changed >= 0 else -1 - changed, by_scans)
        if changed < 0:
            height, width = grid.shape
            raise ProtocolError(Update.name, 0, f"a corrected cell is outside the {width} x {height} grid")
        return update

    def _find_new_cells(self, own: Grid, poses: Sequence[tuple[int, int]]) -> list[NDArray[np.int32]]:
        """Return the cells that each scan reveals and no later one, as indices of the flat grid."""
        grid, cells, start = self.grid, self.ray_table.cells, self.ray_table.start
        counted, found, end = np.zeros(grid.shape, np.bool_), np.empty(grid.size, np.int32), 0
        new_cells = []
        for x, y in reversed(poses):
            first, end = end, find_new_cells(grid, own, counted, cells, start, x, y, found, end)
            new_cells.append(found[first:end])
        return new_cells[::-1]

    def _code_pose(self, coder: Coder, x: int, y: int) -> None:
        if self._narrow is None:
            super()._code_pose(coder, x, y)
        else:
            code_predicted_pose(
                coder, self._motion, self.grid, start_factors(), self._narrow.milli_speed, x, y
            )

    def _code_more(self, coder: Coder, scans: int, more: int) -> int:
        """Encode or decode whether another scan follows the first `scans` ones; return it."""
        if self._narrow is None:
            return int(code_bit(coder, contexts.MORE_SCANS + min(scans, 3), more, REST_MOST))
        state = coder[0]
        is_full = state[PLACE] - AHEAD * state[DECODES] >= self._narrow.update_bytes
        context = contexts.MORE_SCANS_NARROW + 8 * self._was_full + 4 * is_full + min(scans, 3)
        more = int(code_bit(coder, context, more, REST_MOST))
        if not more:
            self._was_full = bool(is_full)
        return more

    def _choose_bases(self, coder: Coder, own: Grid, poses: Sequence[tuple[int, int]], box: Box) -> list[Box]:
        """Encode the dependencies; return boxes in which they contradict the self-explored grid."""
        reach = self._reach
        near = bounding_box([box, *((x - reach, y - reach, x + reach + 1, y + reach + 1) for x, y in poses)])
        return [
            update.box
            for update in self._write_bases(coder, own, near)
            if _contradicts(own.reshape(-1), update.places, update.states)
        ]


def _places(grid: Grid, own: Grid, box: Box) -> NDArray[np.int32]:
    """Flat indices of the cells in which `own` differs from the reported grid."""
    found = np.empty(256, np.int32)
    count = find_differences(grid, own, *box, found)
    if count > len(found):
        found = np.empty(count, np.int32)
        find_differences(grid, own, *box, found)
    return found[:count]


@kernel
def _contradicts(own: Uint8s, places: Int32s, states: Uint8s) -> bool:
    """Whether an update reports a cell with another state than the self-explored grid has."""
    for index in range(len(places)):
        truth = own[places[index]]
        if truth != UNKNOWN and truth != states[index]:
            return True
    return False
