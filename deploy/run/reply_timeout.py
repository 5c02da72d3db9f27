"""A deadline for each robot and phase, in wall clock: who keeps the others waiting longer is given up, by name.

What comes meanwhile does not count, however much it is: only that the phase goes on does.
"""

from __future__ import annotations

import time
from typing import Protocol

REPLY_TIMEOUT_S = 60.0
"""How long a robot may take for a phase of the medium, or for its move, where nothing else is said."""
LOOK_S = 0.25


class Waiting(Protocol):
    """A relay or a world: it waits for robots, phase by phase."""

    @property
    def phase(self) -> object:
        """What is waited for; another one when that has come."""

    def waiting_for(self) -> list[int]:
        """Robots that have not done it yet."""

    def give_up_on(self, robot: int, cause: str) -> None:
        """Go on without a robot."""


class ReplyTimeout:
    """The deadline of what a relay or a world waits for; `look` is called again and again."""

    def __init__(self, node: Waiting, reply_timeout_s: float) -> None:
        self._node = node
        self._patience_s = reply_timeout_s
        self._phase = node.phase
        self._since = self._looked = time.monotonic()

    def look(self) -> float:
        """Give up on who is late; return for how long nothing has gone on, in seconds."""
        now = time.monotonic()
        if now - self._looked < LOOK_S:
            return 0.0
        self._looked = now
        if self._node.phase != self._phase:
            self._phase, self._since = self._node.phase, now
        idle = now - self._since
        for robot in self._node.waiting_for() if idle > self._patience_s else []:
            self._node.give_up_on(robot, f"kept the others waiting for more than {self._patience_s:g} s")
        return idle
