"""What a robot broadcasts of its own state: its pose and its target, each only when teammates need it.

Suppressed are a pose that all teammates in range received, or can infer from this robot's scan updates, and a target
close to the last one sent. A pose is repeated after `REPEAT_POSE` steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from agent.replication.policies import GOSSIP
from agent.settings import Settings
from protocol import packets
from protocol.grid import Cell

REPEAT_POSE = 10
"""Steps after which a robot that stands still repeats its pose."""

TARGET_SLACK = 10
"""If maps travel by gossip, suppress a target within ``range / TARGET_SLACK`` of the last one sent, where ``range`` is
the sensor range: utilities around it are almost the same."""

POSE_SLACK = 3
"""Suppress a pose within ``range / POSE_SLACK`` of the cell that scan updates contain."""


class Announcements:
    """One robot's pose and target, and which teammates know them."""

    def __init__(self, settings: Settings) -> None:
        gossip = settings.replication.dissemination == GOSSIP
        self._target_slack = settings.body.range_cells / TARGET_SLACK if gossip else 0.0
        self._pose_slack = settings.body.range_cells / POSE_SLACK
        self._pose: packets.Pose | None = None
        self._target: Cell | None = None
        """A target to be sent."""
        self._sent_target: Cell | None = None
        self._sent_pose: packets.Pose | None = None
        self._sent_to: frozenset[int] = frozenset()
        """Teammates in range when the pose was last sent."""
        self._sent_step = 0
        self._scanned: Cell | None = None
        """The last cell that teammates (`_scanned_to`) can infer from received scan updates."""
        self._scanned_to: frozenset[int] = frozenset()
        self._inferred = False
        """Whether the pose is suppressed in this step because teammates can infer it."""
        self._has_pose = True
        """Whether this step's broadcast has the pose, or teammates have it already."""

    def set_pose(self, x: int, y: int, *, leads: bool) -> None:
        """Set this robot's pose."""
        self._pose = packets.Pose(x, y, int(leads))

    def set_target(self, target: Cell) -> None:
        """Set a new target; suppress it near the last one sent."""
        near = self._sent_target is not None and math.dist(self._sent_target, target) < self._target_slack
        self._target = None if near else target

    def scans_received(self, cell: Cell | None, peers: tuple[int, ...]) -> None:
        """Note that teammates received all scan updates, the last one from `cell`."""
        self._scanned, self._scanned_to = cell, frozenset(peers)

    def next_packets(self, step: int, in_range: Sequence[int], *, relays: bool) -> list[packets.Packet]:
        """Return the packets to broadcast to the teammates in range; `relays`: relayed state will follow them."""
        announced: list[packets.Packet] = []
        if self._pose is not None:
            known = self._sent_pose == self._pose and self._sent_to.issuperset(in_range)
            self._inferred = not known and self._can_infer(self._pose, in_range)
            if not (known or self._inferred) or step >= self._sent_step + REPEAT_POSE:
                announced.append(self._pose)
        if relays:
            self._has_pose = bool(announced)
        if self._target is not None:
            announced.append(packets.Target(*self._target))
        return announced

    def sent(self, step: int, in_range: tuple[int, ...]) -> None:
        """Note that this step's broadcast was on the air."""
        self._sent_target, self._target = self._target or self._sent_target, None
        if self._has_pose and not self._inferred:
            self._sent_pose, self._sent_to, self._sent_step = self._pose, frozenset(in_range), step

    def _can_infer(self, pose: packets.Pose, in_range: Sequence[int]) -> bool:
        """Return whether teammates can infer the pose from scan updates, and nothing else about it is new."""
        scanned, sent = self._scanned, self._sent_pose
        if scanned is None or sent is None or pose.leads or not self._scanned_to.issuperset(in_range):
            return False
        return math.dist(scanned, (pose.x, pose.y)) < self._pose_slack
