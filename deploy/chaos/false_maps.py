"""Byzantine robots with false maps: their entries are well formed and plausible, but describe a false grid.

Everything else about such a robot is honest: its map encoding alone receives another grid than the explored one. Its
settings name this encoding as a class of this module, so that it also runs in a process of its own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection
from typing import Any

import numpy as np
from msgspec.structs import replace

from agent.encodings.base import MapEncoding
from agent.encodings.catalog import ENCODINGS
from deploy.scenario.plan import Plan
from protocol.boxes import box_of
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, ray_table
from protocol.scans import GridChange, Scan
from worldsim.laser import cast


def _walls(own: Grid) -> Grid:
    """Return walls instead of free cells on every fifth row and column."""
    rows, columns = np.indices(own.shape)
    return np.where((own == FREE) & ((rows % 5 == 0) | (columns % 5 == 0)), OCCUPIED, own)


LIES: dict[str, Callable[[Grid], Grid]] = {
    "walls": _walls,
    "free": lambda own: np.where(own == UNKNOWN, UNKNOWN, FREE),
    "inverted": lambda own: np.where(own == UNKNOWN, UNKNOWN, FREE + OCCUPIED - own),
}
"""False grids by name, from the self-explored one."""


def with_false_map(plan: Plan, robot: int, lie: str) -> Plan:
    """Return a plan in which one robot's map is false, in the same way in each step."""
    settings = plan.robot_settings[robot]
    encoding = replace(settings.encoding, name=f"{__name__}:{settings.encoding.name}_{lie}")
    false = replace(settings, encoding=encoding)
    return dataclasses.replace(plan, robot_settings=plan.robot_settings | {robot: false})


def _encoding_of(lie: str, encoding: Any) -> type[MapEncoding]:
    """Return an encoding that encodes a false grid, and decodes teammates' maps as `encoding` does."""

    class FalseEncoding(encoding):  # type: ignore[misc]
        name = f"false-{lie}-{encoding.name}"
        _false: Grid | None = None

        def encode_changes(
            self, own: Grid, scan: Scan, change: GridChange, *, delivered: bool
        ) -> list[bytes]:
            """Encode the changes of the false grid; the cells around the robot are true."""
            del change
            if self._false is None:
                self._false = np.full_like(own, UNKNOWN)
            x, y, false = scan.x, scan.y, LIES[lie](own).astype(np.uint8)
            around = slice(max(y - 1, 0), y + 2), slice(max(x - 1, 0), x + 2)
            false[around] = own[around]
            if lie == "free":  # also beyond walls, as far as the laser reaches
                reach = int(self.settings.body.range_cells)
                false[max(y - reach, 0) : y + reach, max(x - reach, 0) : x + reach] = FREE
                false[self._false == FREE] = FREE
            changed = false != self._false
            self._false[:] = false
            solid, no_robots = np.maximum(false, FREE), np.zeros(false.shape, np.bool_)
            beams = ray_table(self.settings.body.range_cells, self.settings.beams)
            seen = Scan(x, y, cast(solid, no_robots, beams, x, y))
            entries: list[bytes] = super().encode_changes(
                self._false,
                seen,
                GridChange(int(np.count_nonzero(changed)), box_of(changed)),
                delivered=delivered,
            )
            return entries

        def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
            """Merge as `encoding` does with a new grid each time, since it has not received the changes of `own`."""
            merged: Grid = super().merge(own.copy(), peers)
            return merged

    return FalseEncoding


globals().update(
    {f"{name}_{lie}": _encoding_of(lie, encoding) for name, encoding in ENCODINGS.items() for lie in LIES}
)
