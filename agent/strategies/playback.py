"""The strategy of robots that replay a log: they neither plan nor broadcast targets, so only maps are sent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from agent.settings import Settings
from agent.strategies.base import Decision, Situation, Strategy

PATIENCE = 100
"""Steps without any delivery after which a robot gives up: entries are left, or no teammate is in range."""

LOSSY_PATIENCE = 300
"""The same on a medium that may lose frames, where the last acknowledgment may be lost. Until then, a robot of
eight asks silent teammates five times for a report at 50 B per step (`agent.replication.delivery`)."""


class Playback(Strategy):
    """A robot is done when teammates hold its whole log."""

    name = "playback"
    summary = "replays a log: no planning, and only maps are sent (murmur play)"
    source = "Murmur, recorded runs"
    explores: ClassVar[bool] = False
    publishes_target: ClassVar[bool] = False

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self._patience = LOSSY_PATIENCE if settings.replication.requires_acks else PATIENCE
        self._progress = (-1, -1)
        self._progress_step = 0

    def decide(self, situation: Situation) -> Decision:
        """Report whether all entries of the log have been delivered, or none for a long time."""
        progress = situation.log_entries, situation.backlog
        if progress != self._progress:
            self._progress, self._progress_step = progress, situation.step
        idle = situation.step - self._progress_step
        # encoders hold changes back while no teammate is in range, so that an empty backlog shows nothing then
        delivered = not situation.backlog and (bool(situation.peers) or self.settings.robots == 1)
        return Decision(
            heading=situation.heading,
            explored=delivered and idle > 0,
            stalled=not delivered and idle >= self._patience,
            status=f"{situation.backlog} entries to deliver" if situation.backlog else "all delivered",
        )
