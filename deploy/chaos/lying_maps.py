"""Robots that lie about their own maps: their entries are well formed and plausible, but describe a false grid.

The control logic, the radio and the movements of such a robot are those of any other. Only its map encoding receives
another grid than the one that the robot has explored (`LIES`). The settings of a liar name its encoding as a class of
this module, so that it also runs in a process of its own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection
from typing import Any

import numpy as np
from msgspec.structs import replace

from agent.encodings.base import MapEncoding
from agent.encodings.catalog import ENCODINGS
from agent.settings import Settings
from deploy.scenario.plan import Plan
from protocol.boxes import NO_BOX
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, ray_table
from protocol.scans import Change, Scan
from worldsim.laser import cast

LATTICE = 5
"""Distance of the false walls, in cells."""


def _walls(own: Grid, near: Grid) -> Grid:
    """Return walls on every fifth row and column of the free cells."""
    del near
    rows, columns = np.indices(own.shape)
    lattice = (rows % LATTICE == 0) | (columns % LATTICE == 0)
    return np.where((own == FREE) & lattice, OCCUPIED, own).astype(np.uint8)


def _free(own: Grid, near: Grid) -> Grid:
    """Return free cells instead of walls, and beyond them as far as the laser reaches."""
    return np.where((own != UNKNOWN) | (near != UNKNOWN), FREE, UNKNOWN).astype(np.uint8)


def _inverted(own: Grid, near: Grid) -> Grid:
    """Return walls for free cells, and free cells for walls."""
    del near
    return np.where(own == UNKNOWN, UNKNOWN, FREE + OCCUPIED - own).astype(np.uint8)


LIES: dict[str, Callable[[Grid, Grid], Grid]] = {"walls": _walls, "free": _free, "inverted": _inverted}
"""False grids by name, from the self-explored grid and the cells within the laser's range of any scan so far."""


def lying(plan: Plan, robot: int, lie: str) -> Plan:
    """Return a plan in which one robot tells this lie about its map in each step."""
    settings = plan.robot_settings[robot]
    name = f"{__name__}:{settings.map_encoding}_{lie}"
    lying = replace(settings, map_encoding=name)
    return dataclasses.replace(plan, robot_settings=plan.robot_settings | {robot: lying})


def _make(encoding: Any, lie: Callable[[Grid, Grid], Grid]) -> type[MapEncoding]:
    """Return an encoding that encodes a false grid; what it decodes of teammates' maps is as in `encoding`."""

    class Lying(encoding):  # type: ignore[misc]
        name = encoding.name

        def __init__(self, settings: Settings) -> None:
            super().__init__(settings)
            self._told: Grid = np.full((settings.height, settings.width), UNKNOWN, np.uint8)
            self._near = self._told.copy()
            self._ray_table = ray_table(settings.range_cells, settings.beams)

        def encode_changes(self, own: Grid, scan: Scan, change: Change, *, delivered: bool) -> list[bytes]:
            """Encode the changes of the false grid."""
            del change
            x, y, reach = scan.x, scan.y, int(self.settings.range_cells)
            self._near[max(y - reach, 0) : y + reach, max(x - reach, 0) : x + reach] = FREE
            told = lie(own, self._near)
            around = slice(max(y - 1, 0), y + 2), slice(max(x - 1, 0), x + 2)
            told[around] = own[around]
            rows, columns = np.nonzero(told != self._told)
            box = NO_BOX
            if len(rows):
                box = int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1
            self._told[:] = told
            solid, nobody = np.where(told == OCCUPIED, OCCUPIED, FREE), np.zeros(told.shape, np.bool_)
            seen = cast(solid.astype(np.uint8), nobody, self._ray_table, x, y)
            false = Scan(x, y, seen), Change(len(rows), box)
            entries: list[bytes] = super().encode_changes(self._told, *false, delivered=delivered)
            return entries

        def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
            """Merge as `encoding` does with a new grid each time, since it has not received the changes of `own`."""
            merged: Grid = super().merge(own.copy(), peers)
            return merged

    return Lying


globals().update(
    {
        f"{name}_{lie}": _make(encoding, false)
        for name, encoding in ENCODINGS.items()
        for lie, false in LIES.items()
    }
)
