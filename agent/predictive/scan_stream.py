"""Streams of maps of exact lasers: an update codes scans, and corrections of what they reveal.

On a narrow medium, an update has a limit of bytes. If a scan does not fit, the next update begins with its rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from agent.predictive import contexts
from agent.predictive.coder import AHEAD, DECODES, FAILED, PLACE, Coder, code_bit
from agent.predictive.contexts import REST_MOST
from agent.predictive.history import DecodedUpdate
from agent.predictive.mixer import MixingCoder, mixing_coder
from agent.predictive.pose_model import code_predicted_pose, start_factors
from agent.predictive.scan_updates import (
    MAX_SCANS,
    STATE,
    X,
    Y,
    code_corrections,
    code_scan,
    find_differences,
    find_new_cells,
)
from agent.predictive.stream import Stream
from agent.predictive.wall_model import no_model, start_model
from protocol.arrays import Uint8s
from protocol.boxes import NO_BOX, Box, bounding_box
from protocol.errors import ProtocolError
from protocol.grid import UNKNOWN, Cell, Grid, RayTable
from protocol.packets import Update

NO_LIMIT = 1 << 40
"""Bytes that no update reaches."""

LEAST_SCAN = 1
"""Bytes before the last one of an update that must be left when a further scan begins."""


@dataclass(frozen=True)
class NarrowBand:
    """What predictions of updates on a narrow medium depend on; author and receivers must have the same values."""

    speed: float
    """Cells that the author drives in a step."""
    update_bytes: int
    """The limit of an update. A scan that does not fit is cut off, and the next update begins with its rest."""

    @property
    def milli_speed(self) -> int:
        """The speed in 1/1000 cell per step, at least 1."""
        return max(round(1000 * self.speed), 1)


class ScanStream(Stream):
    """Encoder and decoder of scans from whole cells, with the beams of the map's author (`ray_table`).

    With `narrow`, walls, poses, and ends of updates are coded by better predictions, which take more time.
    """

    state: ClassVar[tuple[str, ...]] = (*Stream.state, "_unreported", "is_cut")

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
        self.model = start_model() if narrow else no_model()
        self._narrow = narrow
        self.is_narrow = narrow is not None
        self.is_cut = False
        """Whether the last update ended in the middle of a scan, with whose rest the next one begins."""
        self._last_byte = narrow.update_bytes - 1 if narrow else NO_LIMIT
        """Bytes of an update behind which its scan is cut off."""
        self.ray_table = ray_table
        self._beams = ray_table.cells, ray_table.start
        self._reach = int(np.abs(ray_table.cells).max()) + 1
        """Cells around a robot, in each direction, that a scan may change."""
        self._unreported = NO_BOX
        """Box in which the author's self-explored grid may differ from the reported one, after an incomplete update."""

    def encode(
        self, own: Grid, poses: Sequence[Cell], box: Box, *, most: float = math.inf
    ) -> tuple[bytes, DecodedUpdate, int] | None:
        """Encode an update of what has changed in a self-explored grid, up to a limit.

        `poses` are the cells (x, y) from which the robot has scanned since the last update, `box` is where the grid has
        changed since then. Behind `most` bytes, no further scan is encoded. An update has one scan at least, and at
        most `MAX_SCANS`. Streams of narrow media have a limit of their own.

        Returns message, update, and the number of `poses` that it covers. If it covers all of them, and is not cut, the
        decoded grid equals `own`; else it holds what these scans show, and the next update needs the other poses. None
        if nothing is left to report; the stream is unchanged then.
        """
        scans = 0

        def write(coder: Coder) -> DecodedUpdate | None:
            nonlocal scans
            update, scans = self._write(coder, own, poses, box, most)
            return update

        encoded = self._encode(write)
        return None if encoded is None else (*encoded, scans)

    def _write(
        self, coder: Coder, own: Grid, poses: Sequence[Cell], box: Box, most: float
    ) -> tuple[DecodedUpdate | None, int]:
        """Encode an update and apply it to the grid; return it, None if empty, and the number of covered poses."""
        motion, grid, scratch = self._motion, self.grid, self._scratch
        contradicted = self._choose_bases(coder, own, poses, bounding_box([box, self._unreported]))
        unreported = bounding_box(
            [self._unreported, *contradicted, *((x, y, x + 1, y + 1) for x, y in poses)]
        )
        box = bounding_box([box, unreported])
        mixing = mixing_coder(coder[0], coder[1], self.model)
        changed = scans = done = 0
        if self.is_cut:
            changed, scans = self._code_scan(coder, mixing, own, changed), 1
        for (x, y), found in zip(poses, self._find_new_cells(own, poses), strict=True):
            if self.is_cut:
                break
            shows_more = len(found) > 0
            if self._narrow:  # cells that an earlier scan of this update has revealed do not count
                shows_more = (grid.reshape(-1)[found] & STATE == UNKNOWN).any()
            if shows_more:
                if self._ends(coder, scans, changed) or (changed and coder[0][PLACE] >= most):
                    break
                self._code_more(coder, scans, 1)
                self._code_pose(coder, x, y)
                changed = self._code_scan(coder, mixing, own, changed)
                scans += 1
            done += not self.is_cut
        is_complete = done == len(poses) and not self.is_cut
        self._unreported = NO_BOX if is_complete else unreported
        by_scans = changed
        if not self.is_cut:
            if not self._ends(coder, scans, changed):
                self._code_more(coder, scans, 0)
            places = _places(grid, own, box) if is_complete else np.empty(0, np.int32)
            changed = code_corrections(coder, grid, own, places, motion, scratch, changed)
        return self._decoded(changed if changed >= 0 else -1 - changed, by_scans) if changed else None, done

    def _read_content(self, coder: Coder) -> DecodedUpdate:
        """Decode scans and corrections."""
        grid, scratch = self.grid, self._scratch
        mixing = mixing_coder(coder[0], coder[1], self.model)
        changed = scans = 0
        if self.is_cut:
            changed, scans = self._code_scan(coder, mixing, grid, changed), 1
        while not (self._ends(coder, scans, changed) or coder[0][FAILED]):
            if not self._code_more(coder, scans, 0):
                break
            try:
                self._read_pose(coder)
            except ProtocolError:
                self._decoded(changed, changed)
                raise
            changed = self._code_scan(coder, mixing, grid, changed)
            scans += 1
        by_scans = changed
        if not self.is_cut:
            no_places = np.empty(0, np.int32)
            changed = code_corrections(coder, grid, grid, no_places, self._motion, scratch, changed)
        update = self._decoded(changed if changed >= 0 else -1 - changed, by_scans)
        if changed < 0:
            height, width = grid.shape
            raise ProtocolError(Update.name, 0, f"a corrected cell is outside the {width} x {height} grid")
        return update

    def _code_scan(self, coder: Coder, mixing: MixingCoder, own: Grid, changed: int) -> int:
        """Encode or decode a scan from the current pose, and note whether it is cut off.

        Returns the number of cells that the update has changed, of which there were `changed` before.
        """
        x, y, last = int(self._motion[X]), int(self._motion[Y]), self._last_byte
        grids = self.grid, own
        changed = int(code_scan(coder, mixing, *grids, self._beams, x, y, self._scratch, changed, last))
        self.is_cut = changed > 0 and _place(coder) >= last
        return changed

    def _ends(self, coder: Coder, scans: int, changed: int) -> bool:
        """Whether the update has no room for another scan. Receivers see this too, so no bit says that it ends."""
        is_full = changed > 0 and _place(coder) >= self._last_byte - LEAST_SCAN
        return self.is_cut or is_full or scans == MAX_SCANS

    def _find_new_cells(self, own: Grid, poses: Sequence[Cell]) -> list[NDArray[np.int32]]:
        """Return the cells that each scan reveals and no later one, as indices of the flat grid."""
        grid = self.grid
        counted, found, end = np.zeros(grid.shape, np.bool_), np.empty(grid.size, np.int32), 0
        new_cells = []
        for x, y in reversed(poses):
            first, end = end, find_new_cells(grid, own, counted, self._beams, x, y, found, end)
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
        first = contexts.MORE_SCANS_NARROW if self.is_narrow else contexts.MORE_SCANS
        return int(code_bit(coder, first + min(scans, 3), more, REST_MOST))

    def _choose_bases(self, coder: Coder, own: Grid, poses: Sequence[Cell], box: Box) -> list[Box]:
        """Encode the dependencies; return boxes in which they contradict the self-explored grid."""
        reach = self._reach
        centers = [*poses, self.pose] if self.is_cut and self.pose else poses
        near = bounding_box(
            [box, *((x - reach, y - reach, x + reach + 1, y + reach + 1) for x, y in centers)]
        )
        return [
            update.box
            for update in self._write_bases(coder, own, near)
            if _contradicts(own.reshape(-1)[update.places], update.states)
        ]


def _place(coder: Coder) -> int:
    """Return the bytes that an encoder has written, or those that it had written where the decoder is."""
    return int(coder[0][PLACE] - AHEAD * coder[0][DECODES])


def _places(grid: Grid, own: Grid, box: Box) -> NDArray[np.int32]:
    """Flat indices of the cells in which `own` differs from the reported grid."""
    found = np.empty(256, np.int32)
    count = find_differences(grid, own, box, found)
    if count > len(found):
        found = np.empty(count, np.int32)
        find_differences(grid, own, box, found)
    return found[:count]


def _contradicts(truth: Uint8s, states: Uint8s) -> bool:
    """Whether cells are reported with other states than the self-explored grid has."""
    return bool(((truth != UNKNOWN) & (truth != states)).any())
