"""Reject map updates outside the area that their author can have observed by now.

A robot appends at most one entry per step to its log: a save point, a scan, a patch or an update. When it appended
its k-th entry, in step k or later, it stood within sensor range of an area that it had reported before. Since then it
has driven no farther than its speed allows, and its sensor has its known range. This bound holds for late and for
forwarded entries, so the check never rejects an honest robot.

A robot's broadcast pose (`packets.Pose`) must lie near its map likewise. This second check applies only to frames
that the author itself sent: a robot that forwards a map cannot know the poses that the author sent to others.

Robots in the field do not check: they start at different times, and do not know the sensors of their teammates for
certain. The check would reject what honest robots report.
"""

from __future__ import annotations

from agent.settings import Settings
from protocol.boxes import Box
from protocol.errors import ProtocolError

SLACK = 8
"""Cells of tolerance: contours lie beside observed cells, and a robot may make up a step's remaining way later."""


class ReachabilityCheck:
    """The area that each map has reported so far, and how far it may grow by the team's speeds and sensor ranges."""

    def __init__(self, settings: Settings) -> None:
        self._is_on = settings.replication.checks_reach
        self._authors = [settings.author_of(map_id) for map_id in range(settings.maps)]
        self._speed = max(body.speed for body in settings.bodies)
        self._ranges = [body.range_cells for body in settings.bodies]
        self._is_lossless = not settings.replication.requires_acks
        self._reported: dict[int, Box] = {}
        self._entries: dict[int, int] = {}
        """`_reported`, `_entries`: the area that each map has reported, and the number of its entries, by map ID."""
        self._poses: dict[int, tuple[int, int, int]] = {}
        """The step and cell (x, y) of each robot's last broadcast pose."""

    def note_pose(self, robot: int, step: int, x: int, y: int) -> None:
        """Take the cell that a robot broadcast as its pose; the check needs a medium without loss or delay."""
        if self._is_lossless:
            self._poses[robot] = step, x, y

    def forget(self) -> None:
        """Forget what the maps have reported: they are decoded again."""
        self._reported.clear()
        self._entries.clear()

    def check(self, map_id: int, box: Box, entries: int = 1, *, step: int, sender: int) -> None:
        """Accept `entries` further entries of a map, which report cells in `box`, from robot `sender` in a step.

        ProtocolError: the author cannot have observed this area; nothing has changed.
        """
        if not self._is_on or box[0] >= box[2] or box[1] >= box[3]:
            return
        count, before = self._entries.get(map_id, 0), self._reported.get(map_id)
        author = self._authors[map_id]
        sight = 2 * self._ranges[author] + SLACK
        limit = sight + self._speed * max(0, step - count)
        if before is None:
            growth = max(box[2] - box[0], box[3] - box[1])
        else:
            (x0, y0, x1, y1), (left, top, right, bottom) = before, box
            growth, box = 0, before
            if left < x0 or top < y0 or right > x1 or bottom > y1:
                growth = max(x0 - left, y0 - top, right - x1, bottom - y1)
                box = min(x0, left), min(y0, top), max(x1, right), max(y1, bottom)
        if growth > limit:
            reason = f"map {map_id} grows by {growth} cells; its author can have observed {limit:.0f} at most"
            raise ProtocolError("map update", 0, reason)
        if sender == author:
            self._check_pose(author, box, count + entries, sight, step)
        self._reported[map_id], self._entries[map_id] = box, count + entries

    def _check_pose(self, author: int, box: Box, entries: int, sight: float, now: int) -> None:
        """Compare the reported area with the pose that its author has broadcast."""
        if author not in self._poses:
            return
        step, x, y = self._poses[author]
        distance = max(box[0] - x, x - box[2] + 1, box[1] - y, y - box[3] + 1)
        if distance > sight + self._speed * max(abs(step - entries), now - step):
            reason = f"the map lies {distance} cells from ({x}, {y}), the pose of its author in step {step}"
            raise ProtocolError("map update", 0, reason)
