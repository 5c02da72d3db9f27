"""Collect the robots' maps at the end of a run: a few robots at a time, each part by part (`protocol.map_parts`).

Each robot sends a part only when the recorder has requested it. The number of parts on the way is therefore limited,
whatever the size of the team, and no link to the recorder is congested.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from protocol import map_parts
from protocol.errors import ProtocolError
from protocol.map_parts import FinalMaps
from protocol.messages import MapPart

IN_TURN = 4
"""Maximum number of robots that send their maps at the same time."""


class MapCollection:
    """The parts that have arrived of maps of `shape` (h, w)."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.parts_received = 0
        """Number of parts that have arrived, of all robots."""
        self._shape = shape
        self._cells = shape[0] * shape[1]
        self._parts: dict[int, list[NDArray[np.uint8]]] = {}
        """Parts of each robot whose turn it is."""

    @property
    def under_way(self) -> list[int]:
        """Robots that have been asked for a part which has not arrived."""
        return sorted(self._parts)

    def begin(self, due: Sequence[int]) -> list[tuple[int, int]]:
        """Begin with the next of the `due` robots; return the robots and parts to request. Others are given up."""
        for robot in self._parts.keys() - set(due):
            del self._parts[robot]
        waiting = [robot for robot in due if robot not in self._parts]
        begun = waiting[: IN_TURN - len(self._parts)]
        self._parts |= {robot: [] for robot in begun}
        return [(robot, 0) for robot in begun]

    def take(self, robot: int, part: MapPart) -> FinalMaps | None:
        """Take a requested part; after the last one, return the robot's maps.

        Raises ProtocolError if the part was not requested, or is malformed.
        """
        parts = self._parts.get(robot)
        if parts is None or part.part != len(parts):
            raise ProtocolError("MapPart", 0, f"part {part.part} of its maps was not requested")
        parts.append(map_parts.decode(part.cells, part.part, self._cells))
        self.parts_received += 1
        if len(parts) < map_parts.count(self._cells):
            return None
        del self._parts[robot]
        return map_parts.split(np.concatenate(parts), self._shape)
