"""What a teammate can have seen by now: what is claimed beyond it is refused as nonsense is.

A robot tells of its map in words, one a step at most: a save point, a scan, a patch, a unit. When it said its k-th
word, in step k or later, it stood within predictive of what it had told by then. Since then it has driven no farther than
its speed allows, and seen no farther than its sensor does. This holds however late a word comes, and whoever passes it
on; so nobody who is honest is ever refused.

Where a robot was heard from (`packets.Pose`) must lie within its map likewise. That is asked of its own words alone:
who passes on a map cannot know what its maker has said of itself to others.
"""

from __future__ import annotations

from typing import NamedTuple

from agent.replication.map_ids import MapId
from agent.settings import Settings
from protocol.boxes import Box, bounding_box
from protocol.errors import ProtocolError

SLACK = 8
"""Cells: contours lie beside what was seen, and what is left of a step's way is driven in the next one."""


class Reception(NamedTuple):
    """The circumstances in which a robot received entries."""

    step: int
    sender: int
    shared: int
    """Offset in the receiver's own log before which other robots may hold entries."""


class ReachabilityCheck:
    """The area that each map covers so far, and how far another update may extend it."""

    def __init__(self, settings: Settings) -> None:
        self._speed = max(settings.fastest_cells, settings.speed_cells)
        self._ranges = settings.ranges_cells
        self._perfect = not settings.requires_acks
        self._covered: dict[MapId, Box] = {}
        self._updates: dict[MapId, int] = {}
        self._places: dict[int, tuple[int, int, int]] = {}

    def place(self, robot: int, step: int, x: int, y: int) -> None:
        """Note the cell that a robot broadcast as its own in a step."""
        if self._perfect:
            self._places[robot] = step, x, y

    def claim(self, map_id: MapId, box: Box, reception: Reception, updates: int = 1) -> None:
        """Note that so many more updates of a map describe cells in `box`, and none beyond.

        Raises
        ------
        ProtocolError
            The author cannot have observed that; nothing has changed.
        """
        if box[0] >= box[2] or box[1] >= box[3]:
            return
        before, covered = self._updates.get(map_id, 0), self._covered.get(map_id)
        reach = 2 * self._ranges[map_id.robot] + SLACK
        far = reach + self._speed * max(0, reception.step - before)
        if covered is None:
            grown = max(box[2] - box[0], box[3] - box[1])
        else:
            grown = max(covered[0] - box[0], covered[1] - box[1], box[2] - covered[2], box[3] - covered[3])
            box = bounding_box((covered, box))
        if grown > far:
            reason = (
                f"map {map_id.number} grows by {grown} cells; since its last update {far:.0f} are possible"
            )
            raise ProtocolError("claim", 0, reason)
        self._check_place(map_id, box, before + updates, reach, reception)
        self._covered[map_id], self._updates[map_id] = box, before + updates

    def _check_place(self, map_id: MapId, box: Box, updates: int, reach: float, reception: Reception) -> None:
        """Compare what a robot describes of its own map with the cell that it broadcast."""
        author = map_id.robot
        if author != reception.sender or author not in self._places:
            return
        step, x, y = self._places[author]
        off = max(box[0] - x, x - box[2] + 1, box[1] - y, y - box[3] + 1)
        if off > reach + self._speed * max(abs(step - updates), reception.step - step):
            reason = (
                f"map {map_id.number} lies {off} cells from ({x}, {y}), the pose that its author broadcast"
            )
            raise ProtocolError("claim", 0, reason)
