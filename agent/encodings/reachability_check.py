"""What a teammate can have seen by now: what is claimed beyond it is refused as nonsense is.

A robot tells of its map in words, one a step at most: a save point, a scan, a patch, a unit. When it said its k-th
word, in step k or later, it stood within predictive of what it had told by then. Since then it has driven no farther than
its speed allows, and seen no farther than its sensor does. This holds however late a word comes, and whoever passes it
on; so nobody who is honest is ever refused.

Where a robot was heard from (`packets.Pose`) must lie within its map likewise. That is asked of its own words alone:
who passes on a map cannot know what its maker has said of itself to others.
"""

from __future__ import annotations

from agent.settings import Settings
from protocol.boxes import Box, bounding_box
from protocol.errors import ProtocolError

SLACK = 8
"""Cells: contours lie beside what was seen, and what is left of a step's way is driven in the next one."""


class ReachabilityCheck:
    """What has been claimed so far, by map, and how far a further claim may go."""

    def __init__(self, settings: Settings) -> None:
        self._robots = settings.robots
        self._speed = max(settings.fastest_cells, settings.speed_cells)
        self._ranges = settings.ranges_cells
        self._perfect = not settings.requires_acks
        self._step: int | None = None
        self._teller = -1
        self._claimed: dict[int, Box] = {}
        self._words: dict[int, int] = {}
        self._places: dict[int, tuple[int, int, int]] = {}

    def listen(self, step: int, teller: int) -> None:
        """What is claimed from now on is heard in this step, from `teller`."""
        self._step, self._teller = step, teller

    def place(self, robot: int, step: int, x: int, y: int) -> None:
        """A robot was heard from a cell in a step, by its own words."""
        if self._perfect:
            self._places[robot] = step, x, y

    def claim(self, map_id: int, box: Box, words: int = 1) -> None:
        """Take a claim: so many `words` more of map `map_id` tell of cells in `box`, and of none beyond.

        Raises
        ------
        ProtocolError
            That cannot be; nothing has changed.
        """
        if self._step is None or box[0] >= box[2] or box[1] >= box[3]:
            return
        told, before = self._words.get(map_id, 0), self._claimed.get(map_id)
        predictive = 2 * self._ranges[map_id % self._robots] + SLACK
        far = predictive + self._speed * max(0, self._step - told)
        if before is None:
            grown = max(box[2] - box[0], box[3] - box[1])
        else:
            grown = max(before[0] - box[0], before[1] - box[1], box[2] - before[2], box[3] - before[3])
            box = bounding_box((before, box))
        if grown > far:
            raise ProtocolError(
                "claim",
                0,
                f"map {map_id} grows by {grown} cells, where {far:.0f} can have been seen since its last word",
            )
        self._check_place(map_id, box, told + words, predictive)
        self._claimed[map_id], self._words[map_id] = box, told + words

    def _check_place(self, map_id: int, box: Box, words: int, predictive: float) -> None:
        """Compare what a robot tells of its own map with where it was heard from."""
        maker = map_id % self._robots
        if self._step is None or maker != self._teller or maker not in self._places:
            return
        step, x, y = self._places[maker]
        off = max(box[0] - x, x - box[2] + 1, box[1] - y, y - box[3] + 1)
        far = predictive + self._speed * max(abs(step - words), self._step - step)
        if off > far:
            reason = f"map {map_id} lies {off} cells from ({x}, {y}), where its maker was heard from"
            raise ProtocolError("claim", 0, reason)
